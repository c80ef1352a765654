"""A light as plain numbers, for files and records, and back."""

from collections.abc import Mapping, Sequence
from typing import Any

import torch
from torch import Tensor

from uwaug._support import checks
from uwaug.light.source import Lamp
from uwaug.light.value import Light

__all__ = ["light_from", "light_of_tables", "plain_numbers"]

_OF_LAMP = ("position", "direction", "power", "cone", "falloff", "radius", "asymmetry")
_OF_DAYLIGHT = ("gain", "gradient", "diffuse")


def plain_numbers(light: Light) -> list[dict[str, Any]]:
    """Each source as a dict of lists of numbers, which JSON can hold."""
    found = []
    for source in light.sources:
        names = _OF_LAMP if isinstance(source, Lamp) else _OF_DAYLIGHT
        one: dict[str, Any] = {"kind": "lamp" if isinstance(source, Lamp) else "daylight"}
        for name in names:
            one[name] = _plain(getattr(source, "axis" if name == "direction" else name))
        if isinstance(source, Lamp):
            if source.spectrum is None:
                one["rgb"] = _plain(source.colour)
            else:
                pair = (source.spectrum.wavelengths, source.spectrum.values)
                one["spectrum"] = [array.tolist() for array in pair]
        elif source.elevation is not None and source.azimuth is not None:
            one |= {"elevation": _plain(source.elevation), "azimuth": _plain(source.azimuth)}
        found.append(one)
    return found


def _plain(value: Tensor) -> Any:
    return value.detach().double().tolist()


def light_from(numbers: Sequence[Mapping[str, Any]]) -> Light:
    """The inverse of `plain_numbers`.

    Raises:
        KeyError, TypeError, ValueError: if a number is missing, or no light has it.
    """
    light = Light.none()
    for one in numbers:
        light = light + _source_from(one)
    return light


def _source_from(one: Mapping[str, Any]) -> Light:
    def tensor(name: str) -> Any:
        return torch.tensor(one[name], dtype=torch.float64)

    if one["kind"] == "lamp":
        rest: dict[str, Any] = {"spectrum": one["spectrum"]} if "spectrum" in one else {}
        if "rgb" in one:
            rest["rgb"] = tensor("rgb")
        return Light.lamp(**{name: tensor(name) for name in _OF_LAMP}, **rest)
    if one["kind"] != "daylight":
        raise ValueError(f"kind must be 'lamp' or 'daylight', got {one['kind']!r:.40}")
    gain, gradient = tensor("gain"), tensor("gradient")
    if "elevation" not in one:
        return Light.ambient(gain, gradient)
    rest = {"diffuse": tensor("diffuse"), "gain": gain, "gradient": gradient}
    return Light.parallel(tensor("elevation"), tensor("azimuth"), **rest)


def light_of_tables(tables: Any) -> Light:
    """The sum of lights that a TOML file gives as tables: a kind, "ambient", "parallel" or "lamp",
    and the arguments of that constructor of `Light`.

    Raises:
        ValueError: naming the key, if it is no such table.
    """
    wanted = 'tables, each with kind = "ambient", "parallel" or "lamp" and its arguments'
    if not isinstance(tables, list) or not all(isinstance(one, Mapping) for one in tables):
        raise ValueError(f"light: expected {wanted}, got {tables!r:.80}")
    light = Light.none()
    for table in tables:
        rest = dict(table)
        kind = rest.pop("kind", None)
        checks.one_of("light.kind", kind, ("ambient", "parallel", "lamp"))
        try:
            light = light + getattr(Light, kind)(**rest)
        except (TypeError, ValueError) as error:
            raise ValueError(f"light of kind {kind!r}: {error}") from None
    return light
