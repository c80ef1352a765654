"""Maps of another size than their pictures, such as those of telephones and networks."""

from collections.abc import Sequence

import torch
from torch import Tensor
from torch.nn.functional import interpolate, max_pool2d, pad

from uwaug._support.once import Once

_STEP_TIMES = 1.25  # ratio of neighbours from which on there is an edge: CHOICES.md, "Sizes"
_ASPECT_TOLERANCE = 0.01  # relative: sizes are rounded to whole pixels or blocks

_size_warning = Once()


def same_aspect(size: Sequence[int], other: Sequence[int]) -> bool:
    """True if two sizes (height, width) differ in scale alone, up to rounding."""
    (height, width), (h, w) = size, other
    return abs(h * width - w * height) <= max(_ASPECT_TOLERANCE * h * width, min(h, w) - 1)


def require_aspect(name: str, distance: Tensor, image: Tensor) -> None:
    """Refuse a map (…xhxw) of another aspect than its picture (…xHxW)."""
    size, other = tuple(distance.shape[-2:]), tuple(image.shape[-2:])
    if size != other and (0 in size or not same_aspect(size, other)):
        got = f"{name} is {size} but image is {other}"
        is_turned = 0 not in size and same_aspect(size[::-1], other)
        cure = "turn it, too, as EXIF has turned the picture" if is_turned else "crop both alike"
        raise ValueError(f"{got}: height and width must agree, or their ratio: {cure}")


def brought_to(size: Sequence[int], z: Tensor) -> Tensor:
    """Bring distances (1xhxw, m) to another (height, width), and warn once in a process. Between
    four like distances they are linear; at edges, holes and open water those of the nearest pixel.
    """
    if z.shape[-2:] == tuple(size):
        return z
    (h, w), (height, width) = z.shape[-2:], size
    got = f"a map is {w}×{h} px and its picture {width}×{height} px"
    _size_warning.warn(f"{got}: it is brought to the picture's size", stacklevel=5)
    nearest = interpolate(z[None], list(size), mode="nearest-exact")[0]
    linear = interpolate(z[None], list(size), mode="bilinear")[0]
    # the four pixels around each corner
    beside = pad(z[None], (1, 1, 1, 1), mode="replicate")
    farthest, nearer = max_pool2d(beside, 2, 1), -max_pool2d(-beside, 2, 1)
    smooth = ((farthest <= _STEP_TIMES * nearer) & (farthest < torch.inf))[0]
    for dim, (old, new) in enumerate(zip(z.shape[-2:], size, strict=True), 1):
        places = (torch.arange(new, device=z.device) + 0.5) * (old / new) + 0.5
        smooth = smooth.index_select(dim, places.long())
    return torch.where(smooth, linear, nearest)
