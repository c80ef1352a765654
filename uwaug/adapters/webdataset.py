"""`RandomUnderwater` for WebDataset."""

from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass
from typing import Any

from uwaug.adapters.samples import SampleAdapter, first_of


@dataclass(eq=False)
class WebDatasetUnderwater(SampleAdapter):
    """Degrade the pictures of a stream of samples: `dataset.decode("pil").map(…)`.

    Args:
        augment: a `RandomUnderwater`.
        image_key: the keys under which a picture may be, the first that a sample has; decoded by
            `decode("pil")`, "rgb8", "rgb", "torchrgb8" or "torch".
        distance_key: those of the map: an array, such as `decode` makes of .npy, or the bytes of a
            16-bit PNG or a TIFF. `decode` would turn a PNG into 8 bits of colour, so tell it what
            to decode: `decode("pil", only=["jpg"])`. Not needed where `augment` has a `distance`.
        unit: as for `SampleAdapter`.
        seed: as there; the name of a picture is its sample's "__key__". The draws then depend
            neither on shards and their order, nor on shuffles and workers. Call `set_epoch` before
            every pass.

    A call returns a copy of the sample with a new picture of the same kind; all else is returned as
    it is.

    Raises:
        TypeError, ValueError: if an option, a picture or a map does not suit, or a key is missing;
            names what came and what was expected.

    Examples:
        >>> import numpy as np, uwaug
        >>> water = WebDatasetUnderwater(uwaug.RandomUnderwater(["II", "7C"]), seed=0)
        >>> image, depth = np.full((32, 48, 3), 200, np.uint8), np.full((32, 48), 3.0)
        >>> sample = {"__key__": "reef/0001", "jpg": image, "depth.npy": depth, "cls": 7}
        >>> first, again = water(sample), water(sample)
        >>> bool((first["jpg"] == again["jpg"]).all()), first["cls"]
        (True, 7)
    """

    _: KW_ONLY
    image_key: str = "jpg;jpeg;png;webp;image"
    distance_key: str = "depth.npy;distance.npy;npy;depth.png;depth.tiff;depth;distance"

    def __call__(self, sample: Mapping[str, Any]) -> dict[str, Any]:
        """A sample with water."""
        what = f"sample {sample.get('__key__')!r}"
        at = first_of(sample, self.image_key, what, "see image_key")
        key = self._key_of_map(sample, self.distance_key, what)
        distance = None if key is None else sample[key]
        try:
            return {**sample, at: self._degraded(sample[at], distance, sample.get("__key__"))}
        except ValueError as error:
            raise ValueError(f"{what}: {error}") from None
