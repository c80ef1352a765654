"""Samples as loaders give them, an image and a map inside a tuple, a list or a dict; and what is
common to all that transforms them.
"""

import copy
import hashlib
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial, wraps
from operator import index as whole_number
from typing import Any, NamedTuple, ParamSpec, TypeVar

import torch
from torch import Tensor, nn

from uwaug._support import checks

P = ParamSpec("P")
T = TypeVar("T")


class Parts(NamedTuple):
    """Image, map if there is one, and what puts a new image in the image's place."""

    image: Tensor
    distance: Any
    restore: Callable[[Tensor], Any]


def take_apart(inputs: tuple[Any, ...], image_key: str, distance_key: str, mapped: bool) -> Parts:
    """Find image and map in what a transform was called with.

    Args:
        inputs: (image, distance, …), or one tuple, list or dict that holds them, or an image. In
            second place of a tuple, a dict may hold the map.
        image_key, distance_key: of a dict.
        mapped: whether there has to be a map; if not, a tuple holds none.

    Raises:
        TypeError, ValueError: if there is no image or no map.
    """
    sample = inputs[0] if len(inputs) == 1 else inputs
    if isinstance(sample, Mapping):
        image = _leaf(sample, image_key, "sample")
        distance = _leaf(sample, distance_key, "sample") if mapped else sample.get(distance_key)
        parts = Parts(image, distance, partial(replaced, sample, image_key))
    elif not isinstance(sample, (tuple, list)):
        parts = Parts(sample, None, lambda result: result)
    elif not sample:
        raise ValueError("sample is empty: expected (image, distance, …)")
    else:
        distance = sample[1] if len(sample) > 1 and mapped else None
        if isinstance(distance, Mapping):
            # torchvision's (image, target)
            distance = _leaf(distance, distance_key, "the dict in second place")
        parts = Parts(sample[0], distance, partial(replaced, sample, 0))
    plain_image(parts.image)
    return parts


def _leaf(sample: Mapping[Any, Any], name: str, what: str) -> Any:
    if name not in sample:
        keys = ", ".join(map(repr, sample))
        cure = "see image_key, distance_key and distance"
        raise ValueError(f"{what} has no {name!r}, only {keys}: {cure}")
    return sample[name]


def replaced(sample: Any, place: Any, value: Any) -> Any:
    """A copy of a dict, tuple, named tuple or list with another value at a key or an index."""
    if isinstance(sample, Mapping):
        changed: Any = copy.copy(sample)
        changed[place] = value
        return changed
    leaves = [*sample[:place], value, *sample[place + 1 :]]
    return type(sample)(*leaves) if hasattr(sample, "_fields") else type(sample)(leaves)


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
    """A random transform of samples; a subclass says in `_sampled` what it does to one."""

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
        return self._sampled(inputs, torch.Generator().manual_seed(key))

    @uncompiled
    def forward(self, *inputs: Any) -> Any:
        """Draw and degrade; see the class."""
        return self._sampled(inputs, None)

    def _sampled(self, inputs: tuple[Any, ...], generator: torch.Generator | None) -> Any:
        raise NotImplementedError


def key_of(seed: int, epoch: int, index: int | str) -> int:
    """A seed of 32 bits, all that a generator of torch takes, from a key; see `at`."""
    which = index if isinstance(index, str) else whole_number(index)
    text = f"{whole_number(seed)}/{whole_number(epoch)}/{which}"
    return int.from_bytes(hashlib.blake2b(text.encode(), digest_size=4).digest())


def plain_image(image: Any) -> Tensor:
    """Check an image's type and shape; return it as a plain tensor."""
    if not isinstance(image, Tensor) or image.dtype != torch.uint8:
        checks.floating("image", image, "; or uint8")
    checks.picture("image", image, 3)
    return typed(image, Tensor)


def typed(x: Tensor, kind: type[Tensor]) -> Tensor:
    """A tensor as another class of tensors."""
    return x if type(x) is kind else x.as_subclass(kind)


def with_pictures(image: Tensor, pictures: Mapping[int, Tensor]) -> Tensor:
    """An image, or a batch of them, with new pictures in some places; itself if there are none."""
    if not pictures:
        return image
    if image.ndim == 3:
        return typed(pictures[0], type(image))
    plain = typed(image, Tensor)
    return typed(torch.stack([pictures.get(i, plain[i]) for i in range(len(plain))]), type(image))


def maps_for(
    image: Tensor, distance: Any, chosen: list[int], instead: Any
) -> Sequence[Tensor | None]:
    """A map for each of the chosen pictures of a batch; None where the picture is put on a plane.

    Args:
        image (3xHxW or Bx3xHxW tensor): plain.
        distance: the map of a sample, or None.
        chosen: indices of pictures.
        instead: what there is instead of a map: None, numbers, or a callable that guesses maps.

    Raises:
        TypeError, ValueError: if a map does not suit the image, or there is none.
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
    pictures = batch[chosen]
    shown = image if image.ndim == 3 else pictures
    with torch.no_grad():
        guess = instead(shown / 255 if shown.dtype == torch.uint8 else shown)
    return list(_plain_maps(guess, pictures))


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


@contextmanager
def naming(index: int, count: int) -> Iterator[None]:
    """Say in refusals which picture of a batch it is."""
    try:
        yield
    except ValueError as error:
        if count == 1:
            raise
        raise ValueError(f"picture {index} of {count}, counted from 0: {error}") from None
