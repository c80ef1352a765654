"""Refusals that several rooms share, and the domains of quantities."""

import math
from collections.abc import Iterable, Mapping
from contextlib import AbstractContextManager, nullcontext
from operator import attrgetter
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

if TYPE_CHECKING:  # what needs no tensors, such as a table of waters, is shown without PyTorch
    from torch import Tensor

DOMAIN = {
    "mixing": (0.0, 1.0),
    "vertical_depth": (0.0, math.inf),
    "g": (0.0, 1.0),
    "mu": (0.0, 1.0),
    "color_matrix": (0.0, 1.0),
    "scale": (0.0, math.inf),
    "exponent": (1e-3, math.inf),
    "distance": (0.0, math.inf),
}
"""Least and largest value of quantities that several rooms read. Infinity is never allowed."""

T = TypeVar("T")
OPEN = 1e7  # m, from which on is open water: some write 1e9; no map in mm holds so many
_FARTHEST_MEDIAN_M = 1000.0  # of a map in metres: no water lets one see farther than 100 m
_LINES_SAMPLED = 16  # rows and columns, about, that `too_far` looks at first
_CONVERT = "; see torchvision's pil_to_tensor, torch.from_numpy and .permute(2, 0, 1)"


def one_of(name: str, value: object, allowed: Iterable[str]) -> None:
    if value not in (choices := tuple(allowed)):
        raise ValueError(f"{name} must be one of {', '.join(choices)}, got {value!r}")


def bounds(low: float, high: float) -> str:
    if high < math.inf:
        return f"in [{low:g}, {high:g}]"
    return "finite" if low == -math.inf else f"finite and ≥ {low:g}"


def within(name: str, value: Any, low: float = -math.inf, high: float = math.inf) -> None:
    """Refuse a number outside [low, high], an infinite one, and anything that is no number."""
    if hasattr(value, "requires_grad"):  # it would get no gradient
        cure = "to learn what water does, use Underwater(…, learnable=True)"
        raise TypeError(f"{name} must be a number, got a tensor; {cure}")
    number = isinstance(value, (int, float, np.number))
    # compilers have symbols for numbers, of which isfinite knows nothing
    if not number or not (low <= value <= high and abs(value) < math.inf):
        raise ValueError(f"{name} must be {bounds(low, high)}, got {value!r}")


def pair(name: str, value: Any, wanted: str) -> tuple[float, float]:
    try:
        low, high = map(float, value)
    except (TypeError, ValueError):
        raise TypeError(f"{name} must be {wanted}, got {value!r}") from None
    return low, high


def vector(
    name: str, value: Any, low: float = -math.inf, high: float = math.inf
) -> tuple[float, float, float]:
    """Return three numbers; refuse anything else, and numbers outside [low, high]."""
    if not isinstance(value, (tuple, list)) or len(value) != 3:
        raise TypeError(f"{name} must be three numbers, got {value!r:.80}")
    for number in value:
        within(name, number, low, high)
    x, y, z = map(float, value)
    return x, y, z


def unchecked(kind: type[T], **values: Any) -> T:
    """An object of a frozen dataclass, of values that were drawn or read within their domains."""
    made = object.__new__(kind)
    vars(made).update(values)
    return made


def truth(name: str, value: object) -> None:
    if not isinstance(value, bool):
        raise TypeError(f"{name} must be True or False, got {value!r:.80}")


def positive(name: str, value: float, unit: str = "") -> None:
    number = isinstance(value, (int, float, np.number)) and not isinstance(value, bool)
    if not number or not 0 < value < math.inf:
        raise ValueError(f"{name} must be finite and > 0{unit and f' {unit}'}, got {value!r}")


def tolerance(value: float) -> None:
    if not isinstance(value, (int, float, np.number)) or not 0 < value < 1:
        raise ValueError(f"tolerance must lie in (0, 1) (image scale 0…1), got {value!r}")


def instance(name: str, value: object, kind: type, hint: str = "") -> None:
    if not isinstance(value, kind):
        raise TypeError(f"{name} must be a uwaug.{kind.__name__}, got {type(value).__name__}{hint}")


def floating(name: str, value: object, hint: str = "") -> None:
    """Refuse anything but a floating-point tensor; `hint` names the cure."""
    import torch

    if not isinstance(value, torch.Tensor) or not value.is_floating_point():
        got = value.dtype if isinstance(value, torch.Tensor) else type(value).__name__
        if hasattr(value, "__array_interface__"):  # NumPy's arrays and PIL's images
            hint = _CONVERT
        elif got == torch.uint8:
            hint = hint or "; scale 0…255 to 0…1 first"
        raise TypeError(f"{name} must be a floating-point tensor, got {got}{hint}")


def finite(name: str, value: "Tensor") -> tuple[float, float]:
    """Return the least and the largest value; refuse NaN and infinity, which a blur spreads."""
    low, high = extent(value)
    if not (math.isfinite(low) and math.isfinite(high)):
        counts = counted(value, "NaN", "infinite", of="values")
        raise ValueError(f"{name} is {counts}: expected finite values, see torch.nan_to_num")
    return low, high


def metres(name: str, value: "Tensor") -> None:
    """Refuse a map whose median lies beyond 1000 m, as it holds millimetres."""
    if (median := too_far(value)) is not None:
        raise ValueError(f"{name} must be in metres, got a median of {median:.4g}: divide by 1000")


def too_far(value: "Tensor") -> float | None:
    """Return the median (m) of a map if it lies beyond 1000 m, else None. Unknown pixels and open
    water do not count, nor does the largest distance, which may stand for open water.
    """
    # all pixels are read only if one of a few hundred is so far away
    rows, columns = (max(1, side // _LINES_SAMPLED) for side in value.shape[-2:])
    sample = value.detach()[..., ::rows, ::columns]
    if not bool(((sample > _FARTHEST_MEDIAN_M) & (sample < OPEN)).any()):
        return None
    distances = value.detach()[(value > 0) & (value < OPEN)]
    nearer = distances[distances < distances.max()]
    median = float((nearer if nearer.numel() else distances).median())
    return median if median > _FARTHEST_MEDIAN_M else None


def distances(name: str, value: "Tensor") -> tuple[float, float]:
    """Return the least and the largest distance; refuse NaN, negative ones and millimetres."""
    if not value.numel():
        return 0.0, 0.0
    # the ends are NaN if any value is
    low, high = extent(value)
    if not low >= 0:
        counts = counted(value, "NaN", "negative")
        cure = "fill unknown pixels first, see uwaug.distance.fill_unknown"
        raise ValueError(f"{name} is {counts}: expected metres ≥ 0 (+inf for open water); {cure}")
    if high > _FARTHEST_MEDIAN_M:
        metres(name, value)
    return low, high


def picture(name: str, value: "Tensor", channels: int) -> None:
    """Refuse a tensor that is neither (B, channels, H, W) nor (channels, H, W)."""
    if value.ndim not in (3, 4) or value.shape[-3] != channels:
        shapes = f"({channels}, H, W) or (B, {channels}, H, W)"
        raise ValueError(f"{name} must have shape {shapes}, got {tuple(value.shape)}")


def same_size(name: str, value: "Tensor", image: "Tensor", of: str = "image") -> None:
    size, other = tuple(value.shape[-2:]), tuple(image.shape[-2:])
    if size != other:
        raise ValueError(f"{name} is {size} but {of} is {other}: height and width must agree")


def same_device(name: str, value: "Tensor", image: "Tensor") -> None:
    if value.device != image.device:
        raise ValueError(f"{name} is on {value.device} but image is on {image.device}: use .to(…)")


def batches(sizes: Mapping[str, int]) -> None:
    if len({size for size in sizes.values() if size != 1}) > 1:
        raise ValueError(f"batch sizes must agree or be 1, got {dict(sizes)}")


def counted(x: "Tensor", *kinds: str, of: str = "pixels") -> str:
    masks = {"NaN": x.isnan(), "negative": x < 0, "zero": x == 0, "infinite": x.isinf()}
    *first, last = (f"{kind} at {int(masks[kind].sum())}" for kind in kinds)
    return f"{', '.join(first)} and {last} of {x.numel()} {of}"


def full_precision(x: "Tensor") -> AbstractContextManager[object]:
    import torch

    kind = x.device.type
    # to enter autocast takes 10 µs, also where there is nothing to switch off
    if not torch.compiler.is_compiling() and not torch.is_autocast_enabled(kind):
        return nullcontext()
    return torch.autocast(kind, enabled=False)


def records(*values: "Tensor") -> bool:
    return any(map(attrgetter("requires_grad"), values))


def on_host(x: "Tensor") -> bool:
    """True if values can be read without waiting: on the processor, and not while compiling."""
    import torch

    return x.is_cpu and not torch.compiler.is_compiling()


def extent(x: "Tensor") -> tuple[float, float]:
    """Return the least and the largest value of a tensor; NaN if it holds any."""
    low, high = x.detach().aminmax()
    return float(low), float(high)


def span(x: "Tensor") -> str:
    numbers = x[~x.isnan()]
    if not numbers.numel():
        return "NaN only"
    return f"{float(numbers.min()):.4g} to {float(numbers.max()):.4g}"
