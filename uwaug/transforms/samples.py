"""Samples as loaders give them: an image and a map inside a tuple, a list or a dict; and what
applies a transform to them.
"""

import copy
import hashlib
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial, wraps
from operator import index as whole
from typing import Any, NamedTuple, ParamSpec, TypeVar

import torch
from torch import Tensor, nn

from uwaug._support import checks

__all__ = [
    "Parts",
    "SampleTransform",
    "maps_for",
    "naming",
    "plain_image",
    "take_apart",
    "typed",
    "uncompiled",
]


class Parts(NamedTuple):
    """Image, map if there is one, and what puts a new image in the image's place."""

    image: Tensor
    distance: Any
    rebuild: Callable[[Tensor], Any]


def take_apart(inputs: tuple[Any, ...], image_key: str, distance_key: str, mapped: bool) -> Parts:
    """Find image and map in what a transform was called with.

    Args:
        inputs: (image, distance, …), or one tuple, list or dict that holds them, or an image. In
            second place of a tuple, a dict may hold the map.
        image_key, distance_key: of a dict.
        mapped: whether there has to be a map; if not, a tuple holds none.
    """
    sample = inputs[0] if len(inputs) == 1 else inputs
    if isinstance(sample, Mapping):
        image = _leaf(sample, image_key, "sample")
        distance = _leaf(sample, distance_key, "sample") if mapped else sample.get(distance_key)
        rebuild: Callable[[Tensor], Any] = partial(_with_image, sample, image_key)
        return Parts(image, distance, rebuild)
    if not isinstance(sample, (tuple, list)):
        return Parts(sample, None, _alone)
    if not sample:
        raise ValueError("sample is empty: expected (image, distance, …)")
    distance = sample[1] if len(sample) > 1 and mapped else None
    if isinstance(distance, Mapping):
        # torchvision's (image, target)
        distance = _leaf(distance, distance_key, "the dict in second place")
    return Parts(sample[0], distance, partial(_with_first, sample))


def _leaf(sample: Mapping[Any, Any], name: str, what: str) -> Any:
    if name not in sample:
        there = ", ".join(map(repr, sample))
        cure = "see image_key, distance_key and distance"
        raise ValueError(f"{what} has no {name!r}, only {there}: {cure}")
    return sample[name]


P = ParamSpec("P")
T = TypeVar("T")


def uncompiled(function: Callable[P, T]) -> Callable[P, T]:
    """What `torch.compiler.disable` makes of a function, which `torch.compile` then leaves as it
    is, at a break of the graph; without its import of torch._dynamo (.7 s) where nobody compiles.
    """

    @wraps(function)
    def called(*args: P.args, **kwargs: P.kwargs) -> T:
        if "torch._dynamo" not in sys.modules:
            return function(*args, **kwargs)
        result: T = torch.compiler.disable(function)(*args, **kwargs)  # type: ignore[no-untyped-call]
        return result

    called._torchdynamo_disable = True  # type: ignore[attr-defined]
    return called


class SampleTransform(nn.Module):
    """What applies a random transform to samples; a subclass has `make_params` and `transform`.

    Args:
        image_key, distance_key: where to find the two in a dict.
        mapped: whether a sample holds a map of distances.
    """

    make_params: Callable[..., Any]
    transform: Callable[..., Tensor]

    def __init__(self, image_key: str, distance_key: str, *, mapped: bool) -> None:
        super().__init__()
        self.image_key = image_key
        self.distance_key = distance_key
        self._mapped = mapped

    def at(self, seed: int, epoch: int, index: int | str) -> Callable[..., Any]:
        """The transform with randomness from a key: the same result in any worker, in any order.

        Args:
            seed, epoch: of the run, of the pass through the data.
            index: of the picture (or batch); a number, or a name such as a path. "7" is 7.

        Returns:
            A function of the same inputs as the transform, which draws the same at every call.
        """
        return partial(self._apply_with, key_of(seed, epoch, index))

    @uncompiled
    def _apply_with(self, key: int, *inputs: Any) -> Any:
        generator = torch.Generator().manual_seed(key)
        image, distance, rebuild = self.taken_apart(inputs)
        return rebuild(self.transform(image, distance, self.make_params(image, generator)))

    @uncompiled
    def forward(self, *inputs: Any) -> Any:
        """Draw and degrade; see the class."""
        image, distance, rebuild = self.taken_apart(inputs)
        return rebuild(self.transform(image, distance, self.make_params(image)))

    def taken_apart(self, inputs: tuple[Any, ...]) -> Parts:
        """Image, map and the way back, of what the transform was called with."""
        parts = take_apart(inputs, self.image_key, self.distance_key, mapped=self._mapped)
        plain_image(parts.image)
        return parts


def key_of(seed: int, epoch: int, index: int | str) -> int:
    """A seed of 32 bits, all that a generator of torch takes, from a key; see `at`."""
    which = index if isinstance(index, str) else whole(index)
    text = f"{whole(seed)}/{whole(epoch)}/{which}"
    return int.from_bytes(hashlib.blake2b(text.encode(), digest_size=4).digest())


def _alone(result: Tensor) -> Tensor:
    return result


def _with_image(sample: Any, key: str, result: Tensor) -> Any:
    """A copy of a dict with another image."""
    changed = copy.copy(sample)
    changed[key] = result
    return changed


def _with_first(sample: Any, result: Tensor) -> Any:
    """The same tuple, named tuple or list with another first leaf."""
    leaves = (result, *sample[1:])
    return type(sample)(*leaves) if hasattr(sample, "_fields") else type(sample)(leaves)


def typed(x: Tensor, wanted: type[Tensor]) -> Tensor:
    """A tensor as another class of tensors."""
    return x if type(x) is wanted else x.as_subclass(wanted)


def plain_image(image: Any) -> Tensor:
    """Check an image's type and shape; return it as a plain tensor."""
    if not isinstance(image, Tensor) or image.dtype != torch.uint8:
        checks.floating("image", image, "; or uint8")
    checks.picture("image", image, 3)
    return typed(image, Tensor)


def maps_for(
    image: Tensor, distance: Any, chosen: list[int], instead: Any
) -> Sequence[Tensor | None]:
    """A map for each of the chosen pictures of a batch; None where the picture is put on a plane.

    Args:
        image (3xHxW or Bx3xHxW tensor): plain.
        distance: the map that was given, or None.
        chosen: indices of pictures.
        instead: what there is instead of a map: None, numbers, or a callable that guesses maps.
    """
    batch = image if image.ndim == 4 else image[None]
    if distance is not None:
        maps = _plain_maps(distance, batch)
        return [maps[i] for i in chosen]
    if instead is None:
        cure = "RandomUnderwater(distance=…) a constant, a range or a callable"
        # as it cannot be told from a call that forgot the map
        kornia = "kornia gives its children the image alone: call RandomUnderwater after it"
        raise ValueError(f"distance is missing: give a map, or {cure}; {kornia}")
    if not callable(instead) or not chosen:
        return [None] * len(chosen)
    seen = batch[chosen]
    shown = image if image.ndim == 3 else seen
    with torch.no_grad():
        guess = instead(shown / 255 if shown.dtype == torch.uint8 else shown)
    return list(_plain_maps(guess, seen))


@contextmanager
def naming(index: int, count: int) -> Iterator[None]:
    """Say in refusals which picture of a batch it is."""
    try:
        yield
    except ValueError as error:
        if count == 1:
            raise
        raise ValueError(f"picture {index} of {count}, counted from 0: {error}") from None


def _plain_maps(distance: Any, images: Tensor) -> Tensor:
    """Check a map of distances; return one for each image (Bx1xHxW), as a plain tensor."""
    hint = "; divide a map in millimetres by 1000"
    if not isinstance(distance, Tensor):
        hint = "; expected (image, distance, …), (image, {'distance': …}) or a dict of both"
    checks.floating("distance", distance, hint)
    checks.picture("distance", distance, 1)
    checks.same_size("distance", distance, images)
    maps, batch = typed(distance, Tensor), len(images)
    maps = maps if maps.ndim == 4 else maps[None]
    if len(maps) not in (1, batch):
        raise ValueError(f"distance is a batch of {len(maps)} but image is one of {batch}")
    return maps.expand(batch, -1, -1, -1)
