"""Labels that are masks: a file for each picture."""

import io
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from uwaug.files.labels import Key, PerPicture, require_size

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from uwaug._support.pixels import Pixels, Size
    from uwaug.files.table import Row

_MAX_COLOURS = 256  # of a mask; a photograph has more
_SMALL_VALUE = 20  # masks that count classes or objects begin below
_IGNORED_COLOUR = 0xE0E0C0  # Pascal VOC's, of pixels to ignore


@dataclass(frozen=True, eq=False)
class Masks(PerPicture):
    """Masks of 8 or 16 bits, or in colour, with a value for each object or class.

    The value of a colour is red·65536 + green·256 + blue, but for greys. 0 is background. 255
    beside small values marks pixels to ignore.
    """

    ignored: frozenset[Key] = frozenset({0, _IGNORED_COLOUR})  # values that stay as they are

    reads = "masks"
    endings = (".png", ".bmp", ".gif", ".tif", ".tiff")
    end = ".png"

    @classmethod
    def opened(cls, rows: Sequence["Row"], classes: Path | None = None) -> Self:
        import numpy as np

        labels = cls.of_rows(rows)
        samples = labels.sampled(lambda file: np.unique(_read(file)[1]).tolist())
        values = {value for sample in samples for value in sample}
        # masks that are not among the samples may have 255, too
        return replace(labels, ignored=labels.ignored | {255}) if _counts(values) else labels

    def objects(self, name: str, size: "Size") -> Iterator["tuple[Key, Pixels]"]:
        import numpy as np

        _, values, _ = _read(self.of[name])
        require_size(self.of[name], values.shape, size)
        present = np.unique(values).tolist()
        ignored = self.ignored | ({255} if _counts(present) else set())
        for value in present:
            if value not in ignored:
                yield value, values == value

    def without(self, dropped: Collection[Key], source: Path) -> bytes:
        import numpy as np
        from PIL import Image

        if not dropped and source.suffix.lower() == self.end:
            return source.read_bytes()
        pixels, values, palette = _read(source)
        pixels[np.isin(values, list(dropped))] = 0
        image, file = Image.fromarray(pixels), io.BytesIO()
        if palette:
            image.putpalette(palette)
        image.save(file, "PNG")
        return file.getvalue()


def _counts(values: Collection[int]) -> bool:
    """True if values count classes or objects so that 255 is none of them."""
    return any(0 < value < _SMALL_VALUE for value in values) and max(values) <= 255


def _read(file: Path) -> "tuple[NDArray[Any], NDArray[Any], list[int] | None]":
    """Pixels of a mask (HxW, or HxWx3 in colour), its values (HxW), and its palette."""
    import numpy as np
    from PIL import Image

    with Image.open(file) as image:
        if image.mode not in ("L", "P", "1", "I;16", "RGB"):
            raise ValueError(f"{file}: expected a mask of one channel, or RGB, got {image.mode}")
        if (count := getattr(image, "n_frames", 1)) > 1:
            raise ValueError(f"{file}: expected one mask, got {count}: give each a file of its own")
        levels = image.convert("L") if image.mode == "1" else image  # 0 and 255, as others read it
        pixels, palette = np.array(levels), image.getpalette()
    if palette and any(palette[:3]):
        colours = np.reshape(palette, (-1, 3))[1 : int(pixels.max()) + 1]
        if not colours.any(1).all():
            raise ValueError(f"{file}: black is not number 0 of its palette: save it as RGB")
    if pixels.ndim == 2:
        return pixels, pixels, palette
    if (pixels == pixels[..., :1]).all():
        return pixels, pixels[..., 0], None
    values = pixels.astype(np.int32) @ [65536, 256, 1]
    if (count := len(np.unique(values))) > _MAX_COLOURS:
        raise ValueError(f"{file}: {count} colours are those of a picture, not of a mask")
    return pixels, values, None
