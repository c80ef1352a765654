"""`degrade` as one opaque operator, for compiled code."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from torch import Tensor

from uwaug.distance.sample import skipped
from uwaug.optics.camera import Camera
from uwaug.optics.water import Water
from uwaug.transforms.prepare import Choice, Draw, Settings, degrade

__all__ = ["Opaque", "degrade_opaque"]


@torch.library.custom_op(
    "uwaug::random_underwater",
    mutates_args=(),
    schema="(Tensor image, Tensor? distance, Tensor[] waters, Tensor camera, Tensor draw, "
    "str settings) -> Tensor",
)
def degrade_opaque(
    image: Tensor,
    distance: Tensor | None,
    waters: list[Tensor],
    camera: Tensor,
    draw: Tensor,
    settings: str,
) -> Tensor:
    """`degrade` for compiled code. The draw comes as a tensor; as Python numbers it would be
    baked into the graph. Waters and camera come as tables, see `_table`.
    """
    spectra = [Water(*rows.numpy()) for rows in waters]
    wavelengths, *response = camera.numpy()
    lens = Camera(wavelengths, np.array(response).T)
    drawn = Draw(*draw.tolist())
    options = Settings.from_json(settings)
    if skipped(distance, options.distance_kind, options.unknown):
        return image.clone()  # an operator must not return what it was given
    return degrade(image, distance, Choice(spectra, lens, drawn, options))


@degrade_opaque.register_fake
def _(image: Tensor, *_: Any) -> Tensor:
    return torch.empty_like(image, memory_format=torch.contiguous_format)


class Opaque:
    """`degrade` as one opaque operator, for compiled code, which takes no objects.

    Args:
        spectra, cameras: by the names that samples have for them.
        settings: what is set.
    """

    def __init__(
        self, spectra: Mapping[str, Water], cameras: Mapping[str, Camera], settings: Settings
    ) -> None:
        self._text = settings.to_json()
        self._waters = {name: _table(water) for name, water in spectra.items()}
        self._cameras = {name: _table(camera) for name, camera in cameras.items()}

    def __call__(self, image: Tensor, distance: Tensor | None, sample: Mapping[str, Any]) -> Tensor:
        """A picture (3xHxW) as a sample of a record says."""
        waters = [self._waters[name] for name in sample["waters"]]
        camera, draw = self._cameras[sample["camera"]], Draw.of(sample).to_tensor()
        result: Tensor = degrade_opaque(image, distance, waters, camera, draw, self._text)
        return result


def _table(spectra: Water | Camera) -> Tensor:
    """Wavelengths, and below them the values at each."""
    if isinstance(spectra, Camera):
        return torch.from_numpy(np.array([spectra.wavelengths, *spectra.response.T]))
    return torch.from_numpy(np.array([spectra.wavelengths, spectra.a, spectra.b, spectra.kd]))
