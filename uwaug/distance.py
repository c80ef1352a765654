"""Metres along the ray, from what people have: metric depth, disparity, relative or inverse depth, a depth network.

Convention: maps are (..., H, W) tensors, float32 or float64 (half precision is taken up to float32). NaN stands for an
unknown distance and stays NaN until `check_distance` or `fill_unknown`; +inf stands for open water. A pixel's index
(i, j) has its centre at (i + 0.5, j + 0.5).
"""

import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import interpolate

__all__ = [
    "DepthNetwork",
    "along_ray",
    "check_distance",
    "fill_unknown",
    "from_disparity",
    "from_inverse",
    "from_relative",
]


def from_relative(t: Tensor, near: float | Tensor, far: float | Tensor, gamma: float | Tensor = 1.0) -> Tensor:
    """Scale normalised relative distance to metres: z = near + (far − near)·t^gamma.

    Args:
        t: (..., H, W), relative distance in [0, 1], 0 = near; NaN = unknown. Networks give *inverse* depth instead:
            see `from_inverse`.
        near: metres at t = 0, ≥ 0; a number, or a tensor that broadcasts against `t`, such as (B, 1, 1, 1).
        far: metres at t = 1, ≥ `near` and finite; likewise.
        gamma: > 0; above 1 moves the middle distance nearer; likewise.

    Returns:
        Distance in metres, shape of `t` (broadcast). t^gamma is continued as a straight line below t = 1e-6, so that
        the gradient is finite at 0 for gamma < 1 too.

    Raises:
        ValueError: `t` leaves [0, 1], or `near`, `far`, `gamma` are out of range.
        TypeError: `t` is no floating-point tensor.

    Examples:
        >>> from_relative(torch.tensor([[0.0, 0.5, 1.0]]), near=1.0, far=5.0, gamma=2.0)
        tensor([[1., 2., 5.]])
    """
    t = _metric(t, "t")
    if bool(((t < 0) | (t > 1)).any()):
        raise ValueError(f"t must lie in [0, 1], got {_span(t)}: normalise first, (t - t.min()) / (t.max() - t.min())")
    _check_range(near, far, inverse=False)
    power = torch.as_tensor(gamma)
    if not bool(((power > 0) & power.isfinite()).all()):
        raise ValueError(f"gamma must be positive and finite, got {gamma}")
    safe = t.clamp(min=1e-6)
    return near + (far - near) * (t / safe * safe**gamma)


def from_inverse(inverse: Tensor, near: float | Tensor, far: float | Tensor) -> Tensor:
    """Scale inverse relative depth, as monocular networks give it (near = large), to metres.

    MiDaS, DPT and Depth Anything predict 1/z up to an unknown scale *and* shift, so neither 1/value nor 1 − value is a
    distance. Each map is therefore normalised by its own least and largest value to s in [0, 1], and s is mapped
    affinely in 1/z, where it is affine: 1/z = 1/far + (1/near − 1/far)·s.

    Args:
        inverse: (..., H, W), any scale and shift; NaN or infinite = unknown.
        near: metres at the map's largest value, > 0; a number, or a tensor that broadcasts against `inverse`.
        far: metres at its least value, ≥ `near`; inf for open water or sky; likewise.

    Returns:
        Distance in metres, shape of `inverse` (broadcast), NaN where unknown.

    Raises:
        ValueError: a map is constant or has no finite value, or `near`, `far` are out of range.
        TypeError: `inverse` is no floating-point tensor.

    Source: Ranftl et al. 2022, Towards robust monocular depth estimation: scale- and shift-invariant losses.

    Examples:
        >>> from_inverse(torch.tensor([[0.0, 30.0, 90.0]]), near=1.0, far=4.0)
        tensor([[4., 2., 1.]])
    """
    inverse = _metric(inverse, "inverse")
    _check_range(near, far, inverse=True)
    known = inverse.isfinite()
    least = torch.where(known, inverse, torch.inf).amin((-2, -1), keepdim=True)
    largest = torch.where(known, inverse, -torch.inf).amax((-2, -1), keepdim=True)
    if not bool((largest > least).all()):
        raise ValueError("inverse must vary within each map, got a map that is constant or has no finite value")
    s = (torch.where(known, inverse, least) - least) / (largest - least)
    return torch.where(known, 1 / (1 / far + (1 / near - 1 / far) * s), torch.nan)


def from_disparity(disparity: Tensor, focal_px: float, baseline_m: float, offset_px: float = 0.0) -> Tensor:
    """Turn the disparity of a rectified stereo pair into planar metric depth: focal·baseline / (disparity + offset).

    The result is depth along the optical axis; pass it through `along_ray` for distance.

    Args:
        disparity: (..., H, W), pixels. NaN or infinite = unknown. If your files mark unknown pixels with 0 and
            `offset_px` is not 0, set them to NaN first.
        focal_px: focal length, pixels.
        baseline_m: distance between the cameras, metres.
        offset_px: difference of the principal points' columns ("doffs" of the Middlebury data sets), pixels.

    Returns:
        Depth in metres, shape of `disparity`; NaN where the disparity is unknown or disparity + offset ≤ 0.

    Raises:
        ValueError: `focal_px` or `baseline_m` is not positive, or `offset_px` not finite.
        TypeError: `disparity` is no floating-point tensor.

    Examples:
        >>> from_disparity(torch.tensor([[10.0, 20.0, 0.0]]), focal_px=1000.0, baseline_m=0.1)
        tensor([[10.,  5., nan]])
    """
    disparity = _metric(disparity, "disparity")
    _check_positive(focal_px, "focal_px")
    _check_positive(baseline_m, "baseline_m")
    if not math.isfinite(offset_px):
        raise ValueError(f"offset_px must be finite, got {offset_px}")
    shifted = disparity + offset_px
    known = shifted.isfinite() & (shifted > 0)
    return torch.where(known, focal_px * baseline_m / torch.where(known, shifted, 1.0), torch.nan)


def along_ray(
    depth: Tensor, focal_px: float | tuple[float, float], centre: tuple[float, float] | None = None
) -> Tensor:
    """Turn planar depth (along the optical axis, as depth maps hold it) into distance along each pixel's ray.

    Pixel (i, j) looks along ((j + 0.5 − cx)/fx, (i + 0.5 − cy)/fy, 1), so z = depth·√(1 + x² + y²). OpenCV counts from
    the centre of the first pixel: add 0.5 to its principal point.

    Args:
        depth: (..., H, W), metres.
        focal_px: focal length in pixels of this image, or (fx, fy).
        centre: principal point (cx, cy) in pixels from the image's top left corner; (W/2, H/2) if None.

    Returns:
        Distance along the ray in metres, shape of `depth`.

    Raises:
        ValueError: a focal length is not positive, or `centre` not finite.
        TypeError: `depth` is no floating-point tensor.

    Examples:
        >>> along_ray(torch.full((1, 3), 2.0), focal_px=1.0)
        tensor([[2.8284, 2.0000, 2.8284]])
    """
    depth = _metric(depth, "depth")
    fx, fy = focal_px if isinstance(focal_px, tuple) else (focal_px, focal_px)
    _check_positive(fx, "focal_px")
    _check_positive(fy, "focal_px")
    height, width = depth.shape[-2:]
    cx, cy = (width / 2, height / 2) if centre is None else centre
    if not (math.isfinite(cx) and math.isfinite(cy)):
        raise ValueError(f"centre must be finite (cx, cy) in pixels, got {centre}")
    x = (torch.arange(width, dtype=depth.dtype, device=depth.device) + (0.5 - cx)) / fx
    y = (torch.arange(height, dtype=depth.dtype, device=depth.device) + (0.5 - cy)) / fy
    return depth * (1 + x**2 + y[:, None] ** 2).sqrt()


def check_distance(distance: Tensor, strict: bool = True) -> Tensor:
    """Make sure that every pixel is known: above 0 m, or +inf for open water.

    Args:
        distance: (..., H, W), metres.
        strict: raise if a pixel is unknown; otherwise `fill_unknown`.

    Returns:
        `distance`, filled if need be.

    Raises:
        ValueError: pixels are NaN, negative or zero (says how many of each); or not `strict`, and a map has no known
            pixel.
        TypeError: `distance` is no floating-point tensor.
    """
    distance = _metric(distance, "distance")
    if not strict:
        return fill_unknown(distance)
    if not bool((distance > 0).all()):
        nan, negative, zero = (int(bad.sum()) for bad in (distance.isnan(), distance < 0, distance == 0))
        raise ValueError(
            f"distance must be above 0 m (inf = open water), got {nan} NaN, {negative} negative and {zero} zero "
            f"of {distance.numel()} pixels: mask them, or fill them with uwaug.distance.fill_unknown"
        )
    return distance


def fill_unknown(distance: Tensor) -> Tensor:
    """Give each unknown pixel (NaN, negative or zero) the distance of the nearest known pixel of its map.

    Holes of real maps are mostly thin: occlusions beside edges, reflections, the rim that rectification leaves. There
    the nearest value keeps edges sharp and invents no distance in between, which smooth inpainting does.

    Args:
        distance: (..., H, W), metres. +inf is known: open water.

    Returns:
        Shape of `distance`, every pixel above 0; differentiable in the known pixels. `distance` itself if none is
        unknown.

    Raises:
        ValueError: a map has no known pixel.
        TypeError: `distance` is no floating-point tensor.

    Examples:
        >>> fill_unknown(torch.tensor([[2.0, 0.0, float("nan"), 3.0]]))
        tensor([[2., 2., 3., 3.]])
    """
    distance = _metric(distance, "distance")
    unknown = ~(distance > 0)
    if not bool(unknown.any()):
        return distance
    if bool(unknown.flatten(-2).all(-1).any()):
        raise ValueError("distance must have at least one known pixel (above 0 m) in each map, got a map without any")
    height, width = distance.shape[-2:]
    nearest = [_nearest_known(holes) for holes in unknown.reshape(-1, height, width)]
    index = torch.stack(nearest).view(distance.shape).flatten(-2)
    return distance.flatten(-2).gather(-1, index.to(distance.device)).view(distance.shape)


def _nearest_known(unknown: Tensor) -> Tensor:
    from scipy.ndimage import distance_transform_edt

    rows, columns = distance_transform_edt(unknown.cpu().numpy(), return_distances=False, return_indices=True)
    return torch.from_numpy(rows).long() * unknown.shape[-1] + torch.from_numpy(columns)


class DepthNetwork:
    """A monocular depth network in an ONNX file, run by onnxruntime: image in, inverse relative depth out.

    The file must take one (1, 3, h, w) float32 input and give (1, h', w') or (1, 1, h', w') first, as exports of MiDaS,
    DPT and Depth Anything do. A fixed h and w is used as it is, otherwise the image's short side becomes `short_side`.
    The session is made at the first call and not pickled, so that DataLoader workers each make their own; it uses as
    many threads as torch does there.

    Args:
        path: the ONNX file.
        short_side: of the network's input, pixels, where the file leaves it free.
        multiple: what the input's sides are rounded to: the patch size, 14 for Depth Anything, 32 for MiDaS.
        mean: of each channel, taken from the image in [0, 1] before the network sees it.
        std: of each channel, that the difference is divided by. Both default to ImageNet's.
        providers: onnxruntime's execution providers.

    Raises:
        FileNotFoundError: there is no file at `path`.
        ValueError: `short_side` or `multiple` is not positive.

    Examples:
        >>> network = DepthNetwork("depth_anything_v2_vits.onnx")  # doctest: +SKIP
        >>> distance = from_inverse(network(image), near=0.5, far=10.0)  # doctest: +SKIP
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        *,
        short_side: int = 518,
        multiple: int = 14,
        mean: Sequence[float] = (0.485, 0.456, 0.406),
        std: Sequence[float] = (0.229, 0.224, 0.225),
        providers: Sequence[str] = ("CPUExecutionProvider",),
    ) -> None:
        self.path = Path(path)
        if not self.path.is_file():
            raise FileNotFoundError(f"path must be an ONNX file, got {self.path}: no such file")
        if short_side < 1 or multiple < 1:
            raise ValueError(f"short_side and multiple must be at least 1, got {short_side} and {multiple}")
        self.short_side, self.multiple = short_side, multiple
        self.mean, self.std = tuple(mean), tuple(std)
        self.providers = tuple(providers)
        self._session: Any = None

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_session": None}

    @torch.no_grad()
    def __call__(self, image: Tensor) -> Tensor:
        """Predict inverse relative depth.

        Args:
            image: (B, 3, H, W) or (3, H, W), sRGB in [0, 1].

        Returns:
            (B, 1, H, W) or (1, H, W), near = large, arbitrary scale and shift: for `from_inverse`. Device of `image`.

        Raises:
            ImportError: onnxruntime is not installed.
            TypeError: `image` is no floating-point tensor.
            ValueError: `image` has another shape or leaves [0, 1], or the network gives something else than a map.
        """
        image = _metric(image, "image")
        if image.ndim not in (3, 4) or image.shape[-3] != 3:
            raise ValueError(f"image must have shape (B, 3, H, W) or (3, H, W), got {tuple(image.shape)}")
        if not bool(((image >= 0) & (image <= 1)).all()):
            raise ValueError(f"image must lie in [0, 1], got {_span(image)}: divide by 255?")
        maps = [self._predict(one) for one in image.reshape(-1, 1, *image.shape[-3:])]
        depth = torch.cat(maps) if maps else image.new_empty(0, 1, *image.shape[-2:])
        return depth.view(*image.shape[:-3], 1, *image.shape[-2:])

    def _predict(self, image: Tensor) -> Tensor:
        session = self._open()
        entry = session.get_inputs()[0]
        shape = entry.shape
        if len(shape) != 4 or not (shape[1] == 3 or (not isinstance(shape[1], int) and shape[3] != 3)):
            raise ValueError(f"{self.path} must take (1, 3, h, w), got {shape}: channels last?")
        size = self._input_size(shape, *image.shape[-2:])
        x = interpolate(image.float().cpu(), size, mode="bicubic", align_corners=False, antialias=True).clamp(0, 1)
        x = (x - x.new_tensor(self.mean).view(3, 1, 1)) / x.new_tensor(self.std).view(3, 1, 1)
        depth = torch.from_numpy(session.run(None, {entry.name: x.numpy()})[0])
        if depth.ndim not in (3, 4) or depth.shape[:-2].numel() != 1:
            raise ValueError(f"{self.path} must give (1, h, w) or (1, 1, h, w), got {tuple(depth.shape)}")
        depth = depth.reshape(1, 1, *depth.shape[-2:]).float()
        return interpolate(depth, image.shape[-2:], mode="bilinear", align_corners=False).to(image)

    def _input_size(self, declared: Sequence[int | str | None], height: int, width: int) -> tuple[int, int]:
        scale = self.short_side / min(height, width)
        free = [max(1, round(side * scale / self.multiple)) * self.multiple for side in (height, width)]
        h, w = (have if isinstance(have, int) else want for have, want in zip(declared[-2:], free, strict=True))
        return h, w

    def _open(self) -> Any:
        if self._session is None:
            try:
                import onnxruntime
            except ImportError as error:
                raise ImportError('a depth network needs onnxruntime: pip install "uwaug[onnx]"') from error
            options = onnxruntime.SessionOptions()
            options.intra_op_num_threads = torch.get_num_threads()
            self._session = onnxruntime.InferenceSession(str(self.path), options, providers=list(self.providers))
        return self._session


def _metric(x: Tensor, name: str) -> Tensor:
    if not isinstance(x, Tensor) or not x.is_floating_point():
        got = x.dtype if isinstance(x, Tensor) else type(x).__name__
        raise TypeError(
            f"{name} must be a floating-point tensor, got {got}: 8-bit values need / 255, millimetres / 1000"
        )
    if x.ndim < 2:
        raise ValueError(f"{name} must have shape (..., H, W), got {tuple(x.shape)}")
    return x.float() if x.dtype.itemsize < 4 else x


def _check_range(near: float | Tensor, far: float | Tensor, *, inverse: bool) -> None:
    n, f = torch.as_tensor(near), torch.as_tensor(far)
    if inverse and not bool(((n > 0) & (f >= n) & n.isfinite()).all()):
        raise ValueError(f"near and far must satisfy 0 < near <= far, near finite, got near={near}, far={far}")
    if not inverse and not bool(((n >= 0) & (f >= n) & f.isfinite()).all()):
        raise ValueError(f"near and far must satisfy 0 <= near <= far < inf, got near={near}, far={far}")


def _check_positive(value: float, name: str) -> None:
    if not 0 < value < math.inf:
        raise ValueError(f"{name} must be positive and finite, got {value}")


def _span(x: Tensor) -> str:
    known = x[~x.isnan()]
    return f"{known.min():.4g} to {known.max():.4g}" if known.numel() else "NaN only"
