"""Labels that are masks: a PNG file for each picture."""

import io
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from uwaug.files.labels import Folder, Key, require_size, write_other

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from uwaug.files.pixels import Pixels, Size
    from uwaug.files.summary import Result

_COLOURS = 256
"""Of a mask at most; a photograph has more."""

_COLOURED = 2**24
"""From here on numbers stand for colours."""

_SMALL = 20
"""Values of masks that count classes or objects begin below."""


@dataclass(frozen=True, eq=False)
class Masks(Folder):
    """Masks of 8 or 16 bits, or in colour, with a value for each object or class; 0, or black, is
    background. The largest of 8 bits, beside small ones, marks pixels to ignore.

    Attributes:
        ignored: values, and Pascal VOC's colour, of such pixels, which stay as they are.
    """

    ignored: frozenset[Key] = frozenset({"224,224,192"})

    reads = "a folder of .png masks"
    end = ".png"
    folders = ("labels", "masks", "SegmentationClass")

    @staticmethod
    def require(file: Path) -> None:
        _values(_read(file)[0], file)

    def described(self, samples: Sequence[Path]) -> Self:
        import numpy as np

        values = {v for file in samples for v in np.unique(_values(_read(file)[0], file)).tolist()}
        small = any(0 < value < _SMALL for value in values)
        return replace(self, ignored=self.ignored | ({255} & values)) if small else self

    def objects(self, name: str, size: "Size") -> Iterator["tuple[Key, Pixels]"]:
        import numpy as np

        pixels, _ = _read(self.of[name])
        require_size(self.of[name], pixels.shape[:2], size)
        values = _values(pixels, self.of[name])
        for value in np.unique(values[values > 0]).tolist():
            if _key(value) not in self.ignored:
                yield _key(value), values == value

    def without(self, dropped: Collection[Key], source: Path, place: str) -> bytes:
        import numpy as np
        from PIL import Image

        if not dropped:
            return source.read_bytes()
        pixels, palette = _read(source)
        values = _values(pixels, source)
        numbers = [value for value in np.unique(values).tolist() if _key(value) in dropped]
        pixels[np.isin(values, numbers)] = 0
        image, file = Image.fromarray(pixels), io.BytesIO()
        if palette:
            image.putpalette(palette)
        image.save(file, "PNG")
        return file.getvalue()

    def finish(self, pictures: Sequence["Result"], out: Path) -> list[str]:
        """Copy what says which colour is which class, as CVAT has it."""
        for source in (self.path.parent / "labelmap.txt", self.path / "labelmap.txt"):
            if source.is_file():
                write_other(out / source.name, source.read_bytes(), source)
        return ["255 in masks says nothing (ignore), and stays"] * (255 in self.ignored)


def _read(file: Path) -> "tuple[NDArray[Any], list[int] | None]":
    """The pixels of a mask (HxW, or HxWx3 in colour), and its palette, if it has one."""
    import numpy as np
    from PIL import Image

    with Image.open(file) as image:
        if image.mode not in ("L", "P", "1", "I;16", "RGB"):
            raise ValueError(f"{file}: expected a mask of one channel, or RGB, got {image.mode}")
        pixels = np.array(image)
        return pixels.astype("uint8") if image.mode == "1" else pixels, image.getpalette()


def _values(pixels: "NDArray[Any]", file: Path) -> "NDArray[Any]":
    """A number (HxW) for each value or colour; see `_key`."""
    import numpy as np

    if pixels.ndim == 2 or (pixels == pixels[..., :1]).all():
        return pixels.reshape(*pixels.shape[:2], -1)[..., 0]
    values = pixels.astype(np.int32) @ [65536, 256, 1]
    values[values > 0] += _COLOURED
    count = len(np.unique(values))
    if count > _COLOURS:
        raise ValueError(f"{file}: {count} colours are those of a picture, not of a mask")
    return values


def _key(value: int) -> Key:
    """A value of a mask; of a colour that is no grey, "red,green,blue"."""
    red, green, blue = value >> 16 & 255, value >> 8 & 255, value & 255
    return value if value < _COLOURED else f"{red},{green},{blue}"
