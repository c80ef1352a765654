"""Samples of loaders, an image and a map in a tuple, list or dict; the base of their transforms."""

import copy
import hashlib
import os
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import fields
from functools import partial, wraps
from operator import index as whole_number
from typing import Any, ParamSpec, Self, TypeVar

import numpy as np
import torch
from torch import Tensor, nn

from uwaug._support import checks
from uwaug.distance.sizes import require_aspect
from uwaug.distance.sources import Source

P = ParamSpec("P")
T = TypeVar("T")


def take_apart(
    inputs: tuple[Any, ...], keys: tuple[str, str], reads_maps: bool
) -> tuple[Any, Any, Callable[[Any], Any]]:
    """Find image, map or None, and a function that puts a new image in the image's place. They are
    in (image, distance, …), or one tuple, list or dict; in second place of a tuple, a dict may hold
    the map. Without `reads_maps` only a name makes a map.
    """
    sample = inputs[0] if len(inputs) == 1 else inputs
    if not isinstance(sample, (Mapping, tuple, list)) or are_pictures(sample):
        _refuse_frames()
        return sample, None, lambda result: result
    others, place = list[str](), keys[0] if isinstance(sample, Mapping) else 0
    if isinstance(sample, Mapping):
        image = _leaf(sample, keys[0], "sample")
        distance = _leaf(sample, keys[1], "sample") if reads_maps else sample.get(keys[1])
    elif not sample:
        raise ValueError("sample is empty: expected (image, distance, …)")
    else:
        image, distance = sample[0], sample[1] if len(sample) > 1 else None
        kind = _kind(image)
        alike = [i for i, leaf in enumerate(sample) if kind and _kind(leaf) == kind]
        others = [f"sample[{i}] is a third picture" for i in alike[2:] if alike[1] == 1]
        if isinstance(distance, Mapping):  # torchvision's (image, target)
            has_map = reads_maps or keys[1] in distance
            distance = _leaf(distance, keys[1], "the dict in second place") if has_map else None
        elif not reads_maps:
            distance = None
    restore = partial(replaced, sample, place)
    if "torchvision.tv_tensors" in sys.modules and [*_images(image, "image")]:
        others += [f"{name} is a second picture" for name in _images(restore(None), "sample")]
    if others:
        cure = "keep it out of the call; a batch is a list; `transform` takes one record for both"
        raise ValueError(f"{others[0]}, which would stay dry: {cure}")
    return image, distance, restore


def are_pictures(value: Any) -> bool:
    """True for a list of pictures (3xHxW), of any sizes: a batch."""
    kinds = {*map(_kind, value)} if isinstance(value, list) else set()
    return len(kinds) == 1 and None not in kinds and value[0].ndim == 3


def _kind(leaf: Any) -> Any:
    """Class and type of a picture or a batch of them; None of all else."""
    is_rgb = isinstance(leaf, Tensor) and leaf.shape[-3:-2] == (3,)
    return (type(leaf), leaf.dtype, leaf.ndim) if is_rgb else None


def _refuse_frames() -> None:
    """Refuse frames that kornia gives as a batch of pictures: only its call tells that they are."""
    frame: Any = sys._getframe()
    while frame and frame.f_globals.get("__name__") != "kornia.augmentation.container.video":
        frame = frame.f_back
    if frame and getattr(frame.f_locals.get("self"), "same_on_frame", False):
        cure = "call it outside, on torchvision's Video or with for_clip; or same_on_frame=False"
        raise ValueError(f"kornia's VideoSequential would give each frame its own water: {cure}")


def _images(value: Any, name: str) -> Iterator[str]:
    tensors = sys.modules["torchvision.tv_tensors"]
    if isinstance(value, (tensors.Image, tensors.Video)):
        yield name
    elif isinstance(value, (Mapping, tuple, list)):
        for place, member in value.items() if isinstance(value, Mapping) else enumerate(value):
            yield from _images(member, f"{name}[{place!r}]")


def _leaf(sample: Mapping[Any, Any], name: str, what: str) -> Any:
    if name not in sample:
        raise ValueError(f"{what} has no {name!r}, only {', '.join(map(repr, sample))}: see keys")
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
    """`torch.compiler.disable`, but no import of torch._dynamo (.7 s) where nobody compiles."""

    @wraps(function)
    def called(*args: P.args, **kwargs: P.kwargs) -> T:
        if "torch._dynamo" not in sys.modules:
            return function(*args, **kwargs)
        result: T = torch.compiler.disable(function)(*args, **kwargs)  # type: ignore[no-untyped-call]
        return result

    called._torchdynamo_disable = True  # type: ignore[attr-defined]
    return called


class SampleTransform(nn.Module):
    """A random transform of samples. A subclass is a dataclass with a `_sampled`."""

    def __new__(cls, *args: Any, **kwargs: Any) -> Self:  # noqa: D102  (no signature of its own)
        # a module has to be one before the fields of a dataclass are set
        transform = super().__new__(cls)
        nn.Module.__init__(transform)
        return transform

    def __setattr__(self, name: str, value: Any) -> None:
        """Set an attribute. An option is set once: all that was made of it would stay as it is."""
        if name in vars(self) and name in (field.name for field in fields(self)):  # type: ignore[arg-type]
            made = f"dataclasses.replace(transform, {name}=…) makes another"
            raise AttributeError(f"{type(self).__name__}.{name} is read-only: {made}")
        super().__setattr__(name, value)

    def at(self, seed: int, epoch: int, index: Any) -> Callable[..., Any]:
        """The transform with randomness from a key: the same result in any worker, in any order.

        Args:
            seed, epoch: of the run, and of the pass through the data.
            index: of the picture (or batch); a number, or a name such as a path. "7" is 7. Several
                (a list, a tensor) are those of a batch, one for each picture, else ValueError.

        Returns:
            A function of the same inputs, of the record `make_params(image, generator_of(…))`.
        """
        return partial(self._apply_with, (seed, epoch, index))

    @staticmethod
    def generator_of(seed: int, epoch: int, index: Any) -> Any:
        """The source of randomness of a key, or a list of them, see `at`."""
        if np.ndim(index):
            return [SampleTransform.generator_of(seed, epoch, each) for each in index]
        return torch.Generator().manual_seed(key_of(seed, epoch, index))

    @uncompiled
    def _apply_with(self, key: tuple[int, int, Any], *inputs: Any) -> Any:
        return self._sampled(inputs, self.generator_of(*key))

    @uncompiled
    def forward(self, *inputs: Any) -> Any:
        """Draw, and degrade a sample; see the class."""
        return self._sampled(inputs, None)

    def _sampled(self, inputs: tuple[Any, ...], generator: Any) -> Any:
        raise NotImplementedError


def key_of(seed: int, epoch: int, index: Any) -> int:
    """The seed of a key, see `at`: the 32 bits that a generator of torch takes."""
    name = os.fspath(index) if isinstance(index, str | os.PathLike) else whole_number(index)
    text = f"{whole_number(seed)}/{whole_number(epoch)}/{name}"
    return int.from_bytes(hashlib.blake2b(text.encode(), digest_size=4).digest())


def is_film(image: Any) -> bool:
    """True for torchvision's `Video`: the frames of one film (Tx3xHxW)."""
    tensors = sys.modules.get("torchvision.tv_tensors")
    return tensors is not None and isinstance(image, tensors.Video)


def typed(x: Tensor, kind: type[Tensor]) -> Tensor:
    """The same tensor, as one of another class, such as torchvision's `Image`."""
    return x if type(x) is kind else x.as_subclass(kind)


def pictures_of(image: Any) -> Tensor:
    """The pictures of an image or a batch (Bx3xHxW), as a plain tensor."""
    if not isinstance(image, Tensor) or image.dtype != torch.uint8:
        checks.floating("image", image, "; or uint8; several in a list")
    checks.picture("image", image, 3)
    plain = typed(image, Tensor)
    return plain if plain.ndim == 4 else plain[None]


def maps_for(pictures: Tensor, distance: Any, source: Source) -> Sequence[Tensor | None]:
    """A map (1xhxw, of the aspect of the pictures) for each picture of a batch, as a plain tensor;
    None if their source reads none.
    """
    if not source.reads_maps:
        if distance is not None:
            raise ValueError(f"distance: a map came, which {source!r:.80} does not read")
        return [None] * len(pictures)
    if distance is None:
        cure = "give a map, or RandomUnderwater(distance=MadeUp(), Network(…) or Plane(…))"
        kornia = "kornia's containers pass a picture alone: call the transform after them"
        raise ValueError(f"distance is missing: {cure}. {kornia}")
    hint = "; divide a map in millimetres by 1000"
    if not isinstance(distance, Tensor):
        hint = "; expected (image, distance, …), (image, {'distance': …}) or a dict of both"
    checks.floating("distance", distance, hint)
    checks.picture("distance", distance, 1)
    if distance.shape[-2:] != pictures.shape[-2:]:
        require_aspect("distance", distance, pictures)
    checks.same_device("distance", distance, pictures)
    plain, count = typed(distance, Tensor), len(pictures)
    maps = list(plain) if plain.ndim == 4 else [plain]
    if len(maps) not in (1, count):
        raise ValueError(f"distance is a batch of {len(maps)} but image is one of {count}")
    return maps if len(maps) == count else maps * count


@contextmanager
def naming(index: int, count: int) -> Iterator[None]:
    """Name the picture of a batch in refusals."""
    try:
        yield
    except ValueError as error:
        if count == 1:
            raise
        raise ValueError(f"picture {index} of {count}, counted from 0: {error}") from None
