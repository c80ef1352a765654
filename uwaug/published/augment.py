"""Published systems as transforms of samples."""

import inspect
from typing import Any

import torch
from torch import nn

from uwaug.published.equation import system


class _Augment(nn.Module):
    def __init__(self, name: str, keys: tuple[str, str], options: dict[str, Any]) -> None:
        super().__init__()
        self.keys, self.options = keys, options
        self._degrade = system(name)
        _, _, *names = inspect.signature(self._degrade).parameters
        for option in options.keys() - {*names}:
            raise TypeError(f"{name} has no {option!r}, only {', '.join(names)}")
        self._draws = "generator" in names

    def forward(self, *inputs: Any) -> Any:
        from uwaug.transforms.samples import take_apart

        image, distance, restore = take_apart(inputs, self.keys, True)
        random = {"generator": torch.default_generator} if self._draws else {}
        return restore(self._degrade(image, distance, **random, **self.options))


def augment(
    name: str, *, keys: tuple[str, str] = ("image", "distance"), **options: Any
) -> nn.Module:
    """Make a transform of a published system, called like `uwaug.RandomUnderwater`. It draws from
    torch's global generator.

    Args:
        name: see `system`.
        keys: keys of image and distance (metres) in a dict.
        options: arguments of the system, such as `water`.

    Examples:
        >>> import torch, uwaug
        >>> transform = uwaug.published.augment("li-2020", water="7C")
        >>> transform({"image": torch.rand(3, 32, 48), "distance": torch.ones(1, 32, 48)}).keys()
        dict_keys(['image', 'distance'])
    """
    return _Augment(name, keys, options)
