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

# address on the hub and commit of networks, whose options are the defaults of `Network`
NAMED = {
    "depth-anything-v2-small": (
        "onnx-community/depth-anything-v2-small:onnx/model.onnx",  # Apache-2.0, 99 MB
        "4472b7362082ad9968fee890ca0f1e5aca36b93d",
    )
}
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
        providers: ONNX Runtime's execution providers.
        revision: commit, branch or tag of the hub; None: one that was tried, or the newest.

    Raises:
        FileNotFoundError: there is no such file, or the hub does not give it.

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
    providers: Sequence[str] = ("CPUExecutionProvider",)
    revision: str | None = None
    _session: Session | None = field(init=False, repr=False, compare=False, default=None)

    def __post_init__(self) -> None:
        checks.instance("holds", self.holds, Source)
        is_named = not callable(self.model) and not Path(self.model).is_file()
        if self.revision is not None and not is_named:
            raise ValueError(f"revision is of files on the hub, got model {self.model}")
        if callable(self.model):
            return
        checks.within("short_side", self.short_side, 1)
        checks.within("multiple", self.multiple, 1)
        if is_named:
            _address_of(str(self.model))

    @property
    def _opened(self) -> Session:
        # the hub is asked here: a preset of a stranger fetches nothing
        if self._session is None:
            path = Path(cast(str, self.model))
            path = path if path.is_file() else _fetched(str(self.model), self.revision)
            session = Session(path, threads=None, providers=self.providers)
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
        """Run the network on pictures, without gradients.

        Args:
            image: (B, 3, H, W) or (3, H, W), sRGB in [0, 1].

        Returns:
            (B, 1, H, W) or (1, H, W), on the device of `image`; what `holds` says.

        Raises:
            ValueError: `image` leaves [0, 1], or the file gives no map.
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
        are_colours = channels in (3, None) or isinstance(channels, str)
        if not are_colours or entry.type not in _TYPES:
            got = f"got {entry.shape}, {entry.type}"
            raise ValueError(f"{self.model} must take (1, 3, h, w) of floating point, {got}")
        short, long = sorted(image.shape[-2:])
        scale = self.short_side / max(short, long / _LONGEST)
        size = []
        for fixed, side in zip(sides, image.shape[-2:], strict=True):
            free = max(1, round(side * scale / self.multiple)) * self.multiple
            size.append(fixed if isinstance(fixed, int) else free)
        x = interpolate(
            image.float().cpu(), size, mode="bicubic", align_corners=False, antialias=True
        ).clamp(0, 1)
        x = (x - x.new_tensor(self.mean).view(3, 1, 1)) / x.new_tensor(self.std).view(3, 1, 1)
        depth = session({entry.name: x.to(_TYPES[entry.type])}).float()
        if depth.ndim not in (3, 4) or depth.shape[:-2].numel() != 1:
            got = f"got {tuple(depth.shape)}"
            raise ValueError(f"{self.model} must give (1, h, w) or (1, 1, h, w), {got}")
        depth = depth.reshape(1, 1, *depth.shape[-2:])
        return interpolate(depth, image.shape[-2:], mode="bilinear", align_corners=False).to(image)


def _address_of(model: str) -> tuple[str, str, str | None]:
    address, tried = NAMED.get(model, (model, None))
    repository, _, file = address.partition(":")
    if repository.count("/") != 1 or not file:
        expected = f"an ONNX file, {', '.join(NAMED)}, or owner/name:file of the hub"
        raise FileNotFoundError(f"model must be {expected}, got {model}: no such file")
    return repository, file, tried


def _fetched(model: str, revision: str | None) -> Path:
    repository, file, tried = _address_of(model)
    (hub,) = require("hub", "huggingface_hub")
    try:
        return Path(hub.hf_hub_download(repository, file, revision=revision or tried))
    except Exception as error:  # of several libraries, without a common base
        reason = " ".join(str(error).split()) or type(error).__name__
        raise FileNotFoundError(f"{repository}:{file} could not be fetched: {reason}") from error
