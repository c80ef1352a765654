"""Depth networks in ONNX files."""

import os
from collections.abc import Sequence
from pathlib import Path

import torch
from torch import Tensor
from torch.nn.functional import interpolate

from uwaug._support import checks
from uwaug._support.onnx_session import Session


class DepthNetwork:
    """A monocular depth network in an ONNX file, run by onnxruntime: image in, inverse relative
    depth out.

    The file must take one (1, 3, h, w) float32 input and give (1, h', w') or (1, 1, h', w') first,
    as exports of MiDaS, DPT and Depth Anything do. A fixed h and w is used as it is, otherwise the
    image's short side becomes `short_side`. The session is made at the first call and not pickled,
    so that DataLoader workers each make their own; it uses as many threads as torch does there.

    Args:
        path: the ONNX file.
        short_side: of the network's input, pixels, where the file leaves it free.
        multiple: what the input's sides are rounded to: the patch size, 14 for Depth Anything, 32
            for MiDaS.
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
            raise ValueError(
                f"short_side and multiple must be at least 1, got {short_side} and {multiple}"
            )
        self.short_side, self.multiple = short_side, multiple
        self.mean, self.std = tuple(mean), tuple(std)
        self.providers = tuple(providers)
        self.session = Session(self.path, threads=None, providers=self.providers)

    @torch.no_grad()
    def __call__(self, image: Tensor) -> Tensor:
        """Predict inverse relative depth.

        Args:
            image: (B, 3, H, W) or (3, H, W), sRGB in [0, 1].

        Returns:
            (B, 1, H, W) or (1, H, W), near = large, arbitrary scale and shift: for `from_inverse`.
            Device of `image`.

        Raises:
            ImportError: onnxruntime is not installed.
            TypeError: `image` is no floating-point tensor.
            ValueError: `image` has another shape or leaves [0, 1], the file is no model, or the
                network gives something else than a map.
        """
        checks.floating("image", image)
        checks.picture("image", image, 3)
        if image.numel() and not (image.amin() >= 0 and image.amax() <= 1):
            raise ValueError(f"image must lie in [0, 1], got {checks.span(image)}: divide by 255?")
        maps = [self._predict(picture) for picture in image.reshape(-1, 1, *image.shape[-3:])]
        depth = torch.cat(maps) if maps else image.new_empty(0, 1, *image.shape[-2:])
        return depth.view(*image.shape[:-3], 1, *image.shape[-2:])

    def _predict(self, image: Tensor) -> Tensor:
        entry = self.session.opened.get_inputs()[0]
        shape = entry.shape
        last = len(shape) == 4 and shape[3] == 3 and not isinstance(shape[1], int)
        if len(shape) != 4 or last or (isinstance(shape[1], int) and shape[1] != 3):
            raise ValueError(f"{self.path} must take (1, 3, h, w), got {shape}: channels last?")
        size = self._input_size(shape, *image.shape[-2:])
        x = interpolate(
            image.float().cpu(), size, mode="bicubic", align_corners=False, antialias=True
        ).clamp(0, 1)
        x = (x - x.new_tensor(self.mean).view(3, 1, 1)) / x.new_tensor(self.std).view(3, 1, 1)
        depth = self.session({entry.name: x})
        if depth.ndim not in (3, 4) or depth.shape[:-2].numel() != 1:
            raise ValueError(
                f"{self.path} must give (1, h, w) or (1, 1, h, w), got {tuple(depth.shape)}"
            )
        depth = depth.reshape(1, 1, *depth.shape[-2:]).float()
        return interpolate(depth, image.shape[-2:], mode="bilinear", align_corners=False).to(image)

    def _input_size(
        self, declared: Sequence[int | str | None], height: int, width: int
    ) -> tuple[int, int]:
        """What the file fixes; else the image's size, scaled and rounded."""
        scale = self.short_side / min(height, width)
        size = []
        for fixed, side in zip(declared[-2:], (height, width), strict=True):
            free = max(1, round(side * scale / self.multiple)) * self.multiple
            size.append(fixed if isinstance(fixed, int) else free)
        return size[0], size[1]
