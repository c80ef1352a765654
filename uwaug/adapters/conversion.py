"""Pictures and maps as other libraries hold them: as tensors, and back."""

import io
from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image
from torch import Tensor

from uwaug.io.distances import Unit, metres_of, require_in_sight
from uwaug.io.read import colours_of

Values = NDArray[Any]


def picture_of(image: Any) -> tuple[Tensor, Callable[[Tensor], Any]]:
    """A picture as a tensor (3xHxW), and what makes of another tensor what the picture was.

    Args:
        image: an array (HxWx3), a tensor (3xHxW), both uint8 (0…255) or floating point (0…1); or a
            Pillow picture, by the rules of `uwaug.io.read_picture`: palettes become RGB,
            and alpha stays as it is.

    Raises:
        TypeError: if it is something else.
        ValueError: if it has no three colours.
    """
    if isinstance(image, Tensor):
        return image, lambda result: result
    if isinstance(image, np.ndarray):
        if image.ndim != 3 or image.shape[2] != 3:
            cure = "the model needs colours, without alpha: see PIL.Image.convert('RGB')"
            raise ValueError(f"image must be an array (H, W, 3), got {image.shape}: {cure}")
        return _channels_first(image), _as_array
    if isinstance(image, Image.Image):
        values, alpha = colours_of(image)
        return _channels_first(values), lambda result: _as_pillow(result, alpha, image.info)
    got = "bytes, so decode it first" if isinstance(image, bytes) else type(image).__name__
    raise TypeError(f"image must be an array, a tensor or a Pillow picture, got {got}")


def map_of(distance: Any, unit: Unit = "m", *, metric: bool = True) -> Tensor:
    """A map of distances as a tensor.

    Args:
        distance: an array, a tensor, a Pillow picture or nested lists, of HxW, HxWx1 or 1xHxW
            numbers; or the bytes of a PNG or TIFF file.
        unit: of its numbers.
        metric: whether they are distances, and no relative or inverse ones.

    Returns:
        1xHxW, float32.

    Raises:
        TypeError: if it holds no numbers.
        ValueError: if it has another shape; if it has 8 bits, which hold no distances, and `unit`
            does not say as a number what a step is; or if the median of its distances lies beyond
            1000 m.
    """
    if isinstance(distance, bytes):
        try:
            distance = Image.open(io.BytesIO(distance))
        except OSError:
            got = f"distance has {len(distance)} bytes that Pillow cannot read"
            cure = "decode it first, or give the bytes of a PNG or TIFF file"
            raise ValueError(f"{got}: {cure}") from None
    values = np.asarray(distance)
    if values.dtype.kind not in "iuf":
        got = f"{type(distance).__name__} of {values.dtype}"
        raise TypeError(f"distance must be a map of numbers, got {got}")
    if values.dtype.itemsize == 1 and isinstance(unit, str):
        cure = "if it does hold distances, say what a step is: unit=0.04, in metres"
        raise ValueError(f"distance must have more than 8 bits, got {values.dtype}: {cure}")
    if values.ndim == 3 and 1 in (values.shape[0], values.shape[2]):
        values = values[0] if values.shape[0] == 1 else values[..., 0]
    if values.ndim != 2:
        cure = "was it decoded as a picture in colour?"
        raise ValueError(f"distance must be a map (H, W), got {values.shape}: {cure}")
    scale = metres_of(unit)
    z = values if scale == 1.0 else values.astype(np.float64) * scale
    result = torch.from_numpy(z.astype(np.float32))[None]
    if metric:
        require_in_sight("distance", result, unit)
    return result


def _channels_first(values: Values) -> Tensor:
    # a copy, as the array may not be writable, run backwards, or be of another byte order
    native = values.dtype.newbyteorder("=")
    return torch.from_numpy(values.transpose(2, 0, 1).astype(native))


def _as_array(result: Tensor) -> Values:
    values: Values = result.permute(1, 2, 0).contiguous().numpy()
    return values


def _as_pillow(result: Tensor, alpha: Values | None, info: dict[Any, Any]) -> Image.Image:
    values = _as_array(result)
    if alpha is not None:
        values = np.concatenate([values, alpha[..., None]], 2)
    image = Image.fromarray(values)
    # EXIF and the profile of its colours; a transparent colour is in alpha by now
    image.info = {key: value for key, value in info.items() if key != "transparency"}
    return image
