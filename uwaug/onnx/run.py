"""Runner and metadata of an exported file."""

import json
import os
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import pad

from uwaug import __version__
from uwaug._support.codec import from_plain
from uwaug._support.onnx_session import Session
from uwaug._support.types import Array
from uwaug.formation.inputs import validate
from uwaug.formation.setting import Setting
from uwaug.formation.underwater import Underwater
from uwaug.light import Light
from uwaug.optics.medium import Medium
from uwaug.optics.surfaces import as_matrices

# Inputs of files: shape, meaning and unit. B pictures, K, L, M and N rates.
INPUTS = {
    "image": "Bx3xHxW, linear light or sRGB, see uwaug_module; 0…1, red, green, blue",
    "distance": "Bx1xHxW, metres along the ray, ≥ 0; +inf is open water",
    "noise": "Bx3xHxW, standard normals, new for each picture: of these the sensor's noise is made",
    "beta": "BxK, rates of the direct light, 1/m, ≥ 0",
    "direct_weights": "Bx3xK, weights of T_β for each channel (spectra: channel, scene's channel)",
    "G": "BxL, rates of signal and veil, 1/m, ≥ 0",
    "signal_weights": "Bx3xL, weights of T_G, as direct_weights",
    "veil_weights": "Bx3xL, weights of V for each channel",
    "b_mean": "B, scattering coefficient of the width law, 1/m",
    "scale": "B, width of the blur at one scattering length, in units of the law",
    "exponent": "B, of the width law",
    "lamp_beta": "BxM, rates of the direct light of lamps, 1/m, ≥ 0",
    "lamp_direct_weights": "Bx3xM, its weights, as direct_weights",
    "lamp_G": "BxN, rates of the signal and fog of lamps, 1/m, ≥ 0",
    "lamp_signal_weights": "Bx3xN, weights of the signal, as direct_weights",
    "lamp_veil_weights": "Bx3xN, weights of the fog, 1/m",
    "lamp_light": "BxPx3, power times color of each of the P lamps; 0 puts one out",
    "pitch": "B, angle of the camera's axis above the horizon, degrees, -90…90",
    "output": "Bx3xHxW, the picture under water, as image",
}


def described(name: str) -> str:
    if name in INPUTS:
        return INPUTS[name]
    return f"{'x'.join(Medium.TENSORS[name]).replace('C', '3')}, uwaug.Medium.{name}"


Picture = TypeVar("Picture", Tensor, Array)


def read_metadata(path: str | os.PathLike[str]) -> dict[str, str]:
    """Read the metadata of a file: `uwaug_version`, `uwaug_water`, `uwaug_plan`,
    `uwaug_coefficients` ("constants" or "inputs") and, as JSON, `uwaug_module`. A ValueError says
    that it is not from `export_onnx`.
    """
    session = Session(path, 1, optimise=False).opened
    metadata: dict[str, str] = session.get_modelmeta().custom_metadata_map
    if not {"uwaug_module", "uwaug_coefficients"} <= set(metadata):
        raise ValueError(f"{path}: has no metadata of uwaug.onnx.export_onnx")
    return metadata


def arguments_of(module: Underwater) -> dict[str, Any]:
    names = ("setting", "distance_range", "tolerance", "sides")
    return {name: getattr(module, name) for name in names}


def module_of(path: str | os.PathLike[str], metadata: dict[str, str]) -> Underwater:
    """Make the module of the file at `path` from its metadata."""
    try:
        arguments = json.loads(metadata["uwaug_module"])
        # metadata of a stranger's file make nothing but a setting
        return Underwater.of(**{key: from_plain(x, Setting) for key, x in arguments.items()})
    except (AttributeError, KeyError, TypeError, ValueError, RecursionError) as error:
        raise ValueError(f"{path}: its metadata are damaged ({error!r:.200})") from error


def coefficients_of(medium: Medium, light: Light | None = None) -> dict[str, Tensor]:
    """Numbers of a medium, and of a light in it, by name, for a file exported with
    `coefficients=True`: float32, a row for each medium.
    """
    light = Light() if light is None else light
    named = (medium.lamplit() if light.lamps else medium.without_lamps()).named_tensors()
    rows = {name: tensor for name, tensor in named.items() if 0 not in tensor.shape}
    if light.lamps:
        sent = torch.tensor([[lamp.power * part for part in lamp.color] for lamp in light.lamps])
        rows["lamp_light"] = sent.expand(len(medium), -1, -1)
    if light.pitch is not None:
        pitch = torch.as_tensor(light.pitch).reshape(-1)
        rows["pitch"] = pitch if len(pitch) > 1 else pitch.expand(len(medium))
    return {name: row.detach().to("cpu", torch.float32).contiguous() for name, row in rows.items()}


def input_rows(media: Mapping[str, Medium], light: Light | None = None) -> dict[str, Any]:
    """`coefficients_of` named media (`waters`) for JSON, with meanings and units (`inputs`). Zeros
    bring all to as many rates, so that rows of several make a batch.
    """
    rows = {name: coefficients_of(medium, light) for name, medium in media.items()}
    names = {key: described(key) for row in rows.values() for key in row}
    most = {key: max(row[key].shape[-1] for row in rows.values()) for key in names}
    waters = {
        name: {key: pad(x, (0, most[key] - x.shape[-1])).tolist() for key, x in row.items()}
        for name, row in rows.items()
    }
    return {"uwaug_version": __version__, "inputs": names, "waters": waters}


class OnnxUnderwater:
    """Exported file that is called like its module; it can live in DataLoader workers.

    Args:
        path: of the file.
        threads: of ONNX Runtime; 0 lets it choose. In DataLoader workers, 1.

    Attributes:
        metadata: see `read_metadata`.
    """

    def __init__(self, path: str | os.PathLike[str], threads: int = 0) -> None:
        self.metadata = read_metadata(path)
        self.module = module_of(path, self.metadata)
        self.session = Session(path, threads)

    def __repr__(self) -> str:
        return f"OnnxUnderwater({str(self.session.path)!r}: {self.module.medium})"

    def __call__(
        self,
        image: Picture,
        distance: Any,
        medium: Medium | None = None,
        light: Light | None = None,
    ) -> Picture:
        """Degrade an image: a tensor or an array, as `uwaug.Underwater`, in float32 or uint8.

        Args:
            image, distance: as of the module.
            medium: one, or one for each image; only for a file with coefficients as inputs.
            light: another pitch, and other powers and colors of the file's lamps; likewise.
        """
        pictures, maps = (
            torch.from_numpy(x) if isinstance(x, np.ndarray) else x for x in (image, distance)
        )
        setting = self.module.setting
        validate(pictures, maps, medium or setting.medium[0], color_space=setting.color_space)
        of_bytes = pictures.dtype == torch.uint8
        rows = {"image": pictures / 255 if of_bytes else pictures, "distance": maps}
        rows = {name: x.float() if x.ndim == 4 else x[None].float() for name, x in rows.items()}
        rows |= self._coefficients(medium, light)
        # batches are 1 or of one common size; if that is 0, the result is empty
        sizes = {len(row) for row in rows.values()}
        batch = 0 if 0 in sizes else max(sizes)
        if batch == 0 or not pictures.numel():
            result = torch.zeros(batch, 3, *pictures.shape[-2:])
        else:
            if (sensor := setting.development.noise) is not None:
                size = (pictures.shape[-2], pictures.shape[-1])
                rows["noise"] = sensor.normals(batch, size, rows["image"])
            result = self.session({n: x.expand(batch, *x.shape[1:]) for n, x in rows.items()})
        if of_bytes:
            result = (result * 255).round().clamp(0, 255).byte()
        if pictures.ndim == 3 and batch == 1:
            result = result[0]
        return result if isinstance(image, Tensor) else result.numpy()

    def _coefficients(self, medium: Medium | None, light: Light | None) -> dict[str, Tensor]:
        """Check medium and light, and return their numbers as the file takes them."""
        if self.metadata["uwaug_coefficients"] != "inputs":
            if medium is not None or light is not None:
                raise ValueError("medium, light: the file takes none: export with coefficients")
            return {}
        if medium is None:
            raise ValueError("medium: the file needs one")
        own = self.module.setting
        if light is not None and _geometry(light) != _geometry(own.light):
            expected = f"{own.light} with other powers, colors and pitch"
            raise ValueError(f"light: the file takes {expected}; got {light}")
        if medium.snow:
            raise ValueError("medium has marine snow, which no file can draw: with_snow(None)")
        if medium.law != own.medium.law:
            raise ValueError(f"medium: its law must be {own.medium.law}, got {medium.law}")
        if not self.module.plans_for(medium):
            raise ValueError("medium: its widths lie beyond the plan of the file: export it, too")
        rows = coefficients_of(medium, light or own.light)
        of_file = coefficients_of(own.medium, own.light)
        if any(rows[name].ndim > of_file[name].ndim for name in rows):
            raise ValueError("medium must be of grey surfaces, as the file, got some with spectra")
        mixing = [name for name in rows if rows[name].ndim < of_file[name].ndim]
        return rows | {name: as_matrices(rows[name]) for name in mixing}


def _geometry(light: Light | None) -> Any:
    if light is None:
        return None
    lamps = tuple(replace(lamp, power=1.0, color=(1.0, 1.0, 1.0)) for lamp in light.lamps)
    return lamps, light.daylight, light.pitch is None
