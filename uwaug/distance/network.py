"""Depth networks."""

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import cast

import torch
from torch import Tensor
from torch.nn.functional import interpolate

from uwaug._support import checks, codec
from uwaug._support.onnx_session import Session
from uwaug._support.ranges import Range
from uwaug.distance.sources import Inverse, Numbers, Source


@codec.plain
@dataclass(frozen=True)
class Network(Source):
    """A monocular depth network: for pictures without maps, or to call by oneself.

    Its errors become wrong colours, and it takes its own time for every picture: where pictures
    come again, keep its maps in files.

    A file must take one (1, 3, h, w) float32 input and give (1, h', w') or (1, 1, h', w') first, as
    exports of MiDaS, DPT and Depth Anything do. A fixed h and w is used as it is, otherwise the
    image's short side becomes `short_side`. ONNX Runtime opens it at the first call and with as
    many threads as torch has there; a session is not pickled, so that DataLoader workers each make
    their own.

    Attributes:
        model: path of an ONNX file, or a function of a picture (3xHxW, 0…1) that gives a map
            (1xHxW).
        holds: what its maps hold: `Inverse`, `Relative` or `Metres`.
        short_side: of the file's input, px, where the file leaves it free.
        multiple: what the input's sides are rounded to: the patch size, 14 for Depth Anything, 32
            for MiDaS.
        mean, std: of each channel: mean is taken from the image in 0…1 before the file sees it, and
            the difference divided by std. By default ImageNet's.
        providers: ONNX Runtime's execution providers.

    Raises:
        FileNotFoundError: there is no file at that path.
        ValueError: `short_side` or `multiple` is not positive.

    Examples:
        >>> network = Network("depth_anything_v2_vits.onnx")  # doctest: +SKIP
        >>> distance = from_inverse(network(image), near=0.5, far=10.0)  # doctest: +SKIP
    """

    reads_maps = False

    model: str | os.PathLike[str] | Callable[[Tensor], Tensor]
    holds: Source = field(default_factory=Inverse)
    short_side: int = 518
    multiple: int = 14
    mean: Sequence[float] = (0.485, 0.456, 0.406)
    std: Sequence[float] = (0.229, 0.224, 0.225)
    providers: Sequence[str] = ("CPUExecutionProvider",)
    _session: Session | None = field(init=False, repr=False, compare=False, default=None)

    def __post_init__(self) -> None:
        checks.instance("holds", self.holds, Source)
        if callable(self.model):
            return
        if not Path(self.model).is_file():
            raise FileNotFoundError(f"model must be an ONNX file, got {self.model}: no such file")
        if self.short_side < 1 or self.multiple < 1:
            got = f"got {self.short_side} and {self.multiple}"
            raise ValueError(f"short_side and multiple must be at least 1, {got}")
        session = Session(self.model, threads=None, providers=self.providers)
        object.__setattr__(self, "_session", session)

    def ranges(self) -> dict[str, Range]:
        """See `Source.ranges`."""
        return self.holds.ranges()

    def metres(self, distance: Tensor | None, image: Tensor, numbers: Numbers) -> Tensor:
        """See `Source.metres`."""
        guess = self(image / 255 if image.dtype == torch.uint8 else image)
        checks.floating("the network's map", guess)
        wanted = (1, *image.shape[1:])
        if guess.shape != wanted:
            raise ValueError(f"the network's map must be {wanted}, got {tuple(guess.shape)}")
        return self.holds.metres(guess, image, numbers)

    @torch.no_grad()
    def __call__(self, image: Tensor) -> Tensor:
        """What the network says of pictures, without gradients.

        Args:
            image: (B, 3, H, W) or (3, H, W), sRGB in [0, 1].

        Returns:
            (B, 1, H, W) or (1, H, W). The files named above give inverse depth: near = large, of
            any scale and shift, for `from_inverse`. Device of `image`.

        Raises:
            ImportError: onnxruntime is not installed.
            TypeError: `image` is no floating-point tensor.
            ValueError: `image` has another shape or leaves [0, 1], the file is no model, or the
                network gives something else than a map.
        """
        if callable(self.model):
            return self.model(image)
        checks.floating("image", image)
        checks.picture("image", image, 3)
        if image.numel() and not (image.amin() >= 0 and image.amax() <= 1):
            raise ValueError(f"image must lie in [0, 1], got {checks.span(image)}: divide by 255?")
        # one by one, as exports take them
        maps = [self._predict(picture) for picture in image.reshape(-1, 1, *image.shape[-3:])]
        depth = torch.cat(maps) if maps else image.new_empty(0, 1, *image.shape[-2:])
        return depth.view(*image.shape[:-3], 1, *image.shape[-2:])

    def _predict(self, image: Tensor) -> Tensor:
        session = cast(Session, self._session)
        entry = session.opened.get_inputs()[0]
        shape = entry.shape
        # channels that are free are taken for colours, unless colours come last
        last = len(shape) == 4 and shape[3] == 3 and not isinstance(shape[1], int)
        if len(shape) != 4 or last or (isinstance(shape[1], int) and shape[1] != 3):
            raise ValueError(f"{self.model} must take (1, 3, h, w), got {shape}: channels last?")
        scale = self.short_side / min(image.shape[-2:])
        size = []
        for fixed, side in zip(shape[-2:], image.shape[-2:], strict=True):
            free = max(1, round(side * scale / self.multiple)) * self.multiple
            size.append(fixed if isinstance(fixed, int) else free)
        x = interpolate(
            image.float().cpu(), size, mode="bicubic", align_corners=False, antialias=True
        ).clamp(0, 1)
        x = (x - x.new_tensor(self.mean).view(3, 1, 1)) / x.new_tensor(self.std).view(3, 1, 1)
        depth = session({entry.name: x})
        if depth.ndim not in (3, 4) or depth.shape[:-2].numel() != 1:
            got = tuple(depth.shape)
            raise ValueError(f"{self.model} must give (1, h, w) or (1, 1, h, w), got {got}")
        depth = depth.reshape(1, 1, *depth.shape[-2:]).float()
        return interpolate(depth, image.shape[-2:], mode="bilinear", align_corners=False).to(image)
