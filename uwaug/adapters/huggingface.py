"""`RandomUnderwater` for Hugging Face `datasets`."""

from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass
from typing import Any

from uwaug.adapters.samples import SampleAdapter, first_of
from uwaug.transforms.samples import naming


@dataclass(eq=False)
class HuggingFaceUnderwater(SampleAdapter):
    """Degrade the pictures of a data set as they are read: `dataset.with_transform(…)`.

    Also for `set_transform`, and for `map(…, batched=True)` of data sets that stream.

    Args:
        augment: a `RandomUnderwater`.
        image_key: the column of pictures: Pillow's (modes RGB and RGBA; palettes become RGB, grey
            and CMYK are refused), arrays (HxWx3) or tensors (3xHxW).
        distance_key: the column of maps: Pillow's (modes F, I;16 and I), arrays, or nested lists.
            Not needed where `augment` has a `distance`.
        output_key: the column that new pictures are put in; None for `image_key`. With a column of
            its own, pictures stay beside what the water makes of them: pairs for restoration.
        id_key: the column of names, such as paths, or of numbers; for `seed`.
        unit, seed: as for `SampleAdapter`.

    A call takes a batch as a dict of columns and returns it with new pictures of the same kind in
    `output_key`; all other columns are returned as they are.

    Raises:
        TypeError, ValueError: if an option, a picture or a map does not suit, or a column is
            missing; names what came and what was expected.

    Examples:
        >>> import numpy as np, uwaug
        >>> from PIL import Image
        >>> water = HuggingFaceUnderwater(uwaug.RandomUnderwater(["II", "7C"]), unit="mm")
        >>> picture = Image.new("RGB", (48, 32), "white")
        >>> depth = np.full((32, 48), 3000, np.uint16)
        >>> batch = water({"image": [picture], "depth_map": [depth], "label": [7]})
        >>> batch["image"][0].size, batch["label"]
        ((48, 32), [7])
    """

    _: KW_ONLY
    image_key: str = "image"
    distance_key: str = "depth_map"
    output_key: str | None = None
    id_key: str | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if (self.seed is None) != (self.id_key is None):
            got = f"seed={self.seed!r} and id_key={self.id_key!r}"
            raise ValueError(f"seed and id_key go together, got {got}")

    def __call__(self, examples: Mapping[str, Any]) -> dict[str, Any]:
        """A batch with water."""
        cure = "see image_key; a column read alone has no other"
        images = examples[first_of(examples, self.image_key, "the batch", cure)]
        key = self._key_of_map(examples, self.distance_key, "the batch")
        maps = [None] * len(images) if key is None else examples[key]
        names = [None] * len(images)
        if self.id_key is not None:
            names = examples[first_of(examples, self.id_key, "the batch", "see id_key")]
        results = []
        for i, row in enumerate(zip(images, maps, names, strict=True)):
            with naming(i, len(images)):
                results.append(self._degraded(*row))
        return {**examples, self.output_key or self.image_key: results}
