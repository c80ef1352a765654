"""Distances from a monocular depth network."""

import math
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

import torch
from torch import Tensor
from torch.nn.functional import interpolate

from uwaug._support import checks, codec
from uwaug._support.extras import require
from uwaug._support.nouns import Drawn
from uwaug._support.onnx_session import Session
from uwaug.distance.sizes import require_aspect
from uwaug.distance.sources import Inverse, Source

# its options are the defaults of `Network`; Apache-2.0, 99 MB
_NAMED = "depth-anything-v2-small"
_ADDRESS = "onnx-community/depth-anything-v2-small:onnx/model.onnx"
_TRIED = "4472b7362082ad9968fee890ca0f1e5aca36b93d"  # commit
_TYPES = {"tensor(float)": torch.float32, "tensor(float16)": torch.float16}
_LONGEST = 4  # short sides that a side of the input measures at most


@codec.plain
@dataclass(frozen=True)
class Network(Source):
    """Monocular depth network, for pictures without maps, or to call.

    An ONNX file takes one picture, (1, 3, h, w), of floating point, and gives (1, h', w') or
    (1, 1, h', w') first. It opens, or is fetched from the Hugging Face hub, at the first call, with
    as many threads as torch has there. Where pictures come again, keep its maps (`uwaug depth`).

    Attributes:
        model: path of an ONNX file; "depth-anything-v2-small" or "owner/name:file" of the hub; or a
            function of a picture (3xHxW, sRGB in 0…1) that gives a map (1xHxW).
        holds: meaning of its maps: `Inverse`, `Relative` or `Metres`.
        short_side: short side of the input, px, where the file leaves it free; the long side has
            four times as much at most.
        multiple: patch size, by which sides are divisible: 14 for Depth Anything, 32 for MiDaS.
        mean, std: the file gets (image − mean)/std of each channel, image in 0…1.

    Examples:
        >>> network = Network("depth-anything-v2-small")  # doctest: +SKIP
        >>> distance = from_inverse(network(image), near=0.5, far=10.0)  # doctest: +SKIP
    """

    reads_maps = False
    reads_pictures = True

    model: str | os.PathLike[str] | Callable[[Tensor], Tensor]
    holds: Source = field(default_factory=Inverse)
    short_side: int = 518
    multiple: int = 14
    mean: Sequence[float] = (0.485, 0.456, 0.406)
    std: Sequence[float] = (0.229, 0.224, 0.225)
    _session: Session | None = field(init=False, repr=False, compare=False, default=None)

    def __post_init__(self) -> None:
        checks.instance("holds", self.holds, Source)
        checks.within("short_side", self.short_side, 1)
        checks.within("multiple", self.multiple, 1)
        if not callable(self.model) and not Path(self.model).is_file():
            _address_of(str(self.model))

    @property
    def _opened(self) -> Session:
        # the hub is asked here: a preset of a stranger fetches nothing
        if self._session is None:
            path, model = Path(str(self.model)), str(self.model)
            session = Session(path if path.is_file() else _fetched(model), threads=None)
            object.__setattr__(self, "_session", session)
        return cast(Session, self._session)

    @property
    def file(self) -> Path | None:
        """Path of the ONNX file, which is fetched if it is of the hub; None for a function."""
        return None if callable(self.model) else self._opened.path

    def reach(self) -> tuple[float, float] | None:
        return self.holds.reach()

    @property
    def has_size(self) -> bool:  # type: ignore[override]
        return self.holds.has_size

    def placed(
        self, drawn: Drawn, metres_for: Callable[[float], float], farthest: float = math.inf
    ) -> dict[str, Any]:
        return {**drawn, "holds": self.holds.placed(drawn["holds"], metres_for, farthest)}

    def metres(self, distance: Tensor | None, image: Tensor, drawn: Drawn, **view: Any) -> Tensor:
        guess = self(image / 255 if image.dtype == torch.uint8 else image)
        checks.floating("the network's map", guess)
        checks.picture("the network's map", guess, 1)
        require_aspect("the network's map", guess, image)
        return self.holds.metres(guess, image, drawn["holds"], **view)

    @torch.no_grad()
    def __call__(self, image: Tensor) -> Tensor:
        """Run the network without gradients, on pictures (Bx3xHxW or 3xHxW, sRGB in 0…1): maps
        (Bx1xHxW or 1xHxW) of what `holds` says, on the device of `image`.
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
        session = self._opened
        entry = session.opened.get_inputs()[0]
        channels, *sides = entry.shape[1:] if len(entry.shape) == 4 else [0, 0, 0]
        if not (channels in (3, None) or isinstance(channels, str)) or entry.type not in _TYPES:
            got = f"{entry.shape}, {entry.type}"
            raise ValueError(f"{self.model} must take (1, 3, h, w) of floating point, got {got}")
        short, long = sorted(image.shape[-2:])
        scale = self.short_side / max(short, long / _LONGEST) / self.multiple
        free = [max(1, round(side * scale)) * self.multiple for side in image.shape[-2:]]
        size = [n if isinstance(n, int) else m for n, m in zip(sides, free, strict=True)]
        x = image.float().cpu()
        x = interpolate(x, size, mode="bicubic", align_corners=False, antialias=True).clamp(0, 1)
        x = (x - x.new_tensor(self.mean).view(3, 1, 1)) / x.new_tensor(self.std).view(3, 1, 1)
        depth = session({entry.name: x.to(_TYPES[entry.type])}).float()
        if depth.ndim not in (3, 4) or depth.shape[:-2].numel() != 1:
            shape = tuple(depth.shape)
            raise ValueError(f"{self.model} must give (1, h, w) or (1, 1, h, w), got {shape}")
        depth = depth.reshape(1, 1, *depth.shape[-2:])
        return interpolate(depth, image.shape[-2:], mode="bilinear", align_corners=False).to(image)


def _address_of(model: str) -> tuple[str, str]:
    repository, _, file = (_ADDRESS if model == _NAMED else model).partition(":")
    if repository.count("/") != 1 or not file:
        expected = f"an ONNX file, {_NAMED}, or owner/name:file of the hub"
        raise FileNotFoundError(f"model must be {expected}, got {model}: no such file")
    return repository, file


def _fetched(model: str) -> Path:
    (hub,) = require("hub", "huggingface_hub")
    address, revision = _address_of(model), _TRIED if model == _NAMED else None
    try:
        return Path(hub.hf_hub_download(*address, revision=revision))
    except Exception as error:  # of several libraries, without a common base
        reason = " ".join(str(error).split()) or type(error).__name__
        raise FileNotFoundError(f"{':'.join(address)} could not be fetched: {reason}") from error
