"""Batches on a device, which are formed at once; here on the CPU, taken for one."""

from typing import Any

import pytest
import torch
from augmenting import OPTIONS, H, W, distances, picture, same
from torch import Tensor
from torch.nn.functional import interpolate
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves

from uwaug import RandomUnderwater
from uwaug._support import checks

WAITS = ("_local_scalar_dense", "nonzero", "masked_select", "equal", "unique")


def storage(x: Tensor) -> int:
    """What tells the memory of a tensor from any other, as long as it is there."""
    return x.untyped_storage()._cdata


class NoWait(TorchDispatchMode):
    """Refuses what a device would wait for, of all that is computed from some tensors."""

    def __init__(self, *tensors: Tensor) -> None:
        super().__init__()
        self.theirs = {storage(tensor): tensor for tensor in tensors}

    def __torch_dispatch__(self, function, types, args=(), kwargs=None) -> Any:
        inputs = [x for x in tree_leaves((args, kwargs)) if isinstance(x, Tensor)]
        result = function(*args, **(kwargs or {}))
        if any(storage(x) in self.theirs for x in inputs):
            assert not any(wait in str(function) for wait in WAITS), function
            made = [x for x in tree_leaves(result) if isinstance(x, Tensor)]
            self.theirs |= {storage(x): x for x in made}
        return result


@pytest.fixture(autouse=True)
def taken_for_a_device(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(checks, "on_host", lambda x: False)


def one_by_one(aug: RandomUnderwater, record: Any, image: Tensor, maps: Tensor | None) -> Tensor:
    """The pictures of a batch, each by itself."""
    made = []
    for i, sample in enumerate(record["samples"]):
        z = None if maps is None else maps[i]
        made.append(aug.transform(image[i], z, {"samples": [sample]}))
    return torch.stack(made)


BATCHES = [(name, torch.float32) for name in OPTIONS]
BATCHES += [(name, torch.uint8) for name in ("default", "network", "half", "snowy")]


@pytest.mark.parametrize(("name", "dtype"), BATCHES)
def test_a_batch_is_its_pictures_one_by_one_and_those_of_the_host(
    name: str, dtype: torch.dtype, monkeypatch: pytest.MonkeyPatch
) -> None:
    aug = RandomUnderwater(**OPTIONS[name])
    maps = distances(4) if aug.distance.reads_maps else None
    # the blur's tolerance is that of pictures, not of noise
    image = interpolate(picture(4)[..., ::6, ::6], (H, W), mode="bilinear")
    image, white, rounding = (
        (image, 1, 1e-5) if dtype.is_floating_point else ((255 * image).byte(), 255, 1)
    )
    record = aug.make_params(image, torch.Generator().manual_seed(0))
    together = aug.transform(image, maps, record)
    assert together.dtype == dtype
    apart = together.double() - one_by_one(aug, record, image, maps)
    assert apart.abs().max() <= rounding
    monkeypatch.setattr(checks, "on_host", lambda x: True)
    host = aug.transform(image, maps, record)
    # plans differ, as that of a batch is made before its light is measured
    assert (together.double() - host).square().mean().sqrt() < 0.002 * white
    assert same(host, one_by_one(aug, record, image, maps))


@pytest.mark.parametrize("name", ["default", "raw", "contents", "half", "night", "noisy"])
@pytest.mark.parametrize("dtype", [torch.float32, torch.uint8])
def test_the_host_waits_for_one_look(
    name: str, dtype: torch.dtype, monkeypatch: pytest.MonkeyPatch
) -> None:
    aug = RandomUnderwater(**OPTIONS[name])
    image, z = picture(4, dtype), distances(4)
    record = aug.make_params(image, torch.Generator().manual_seed(1))
    assert any(sample["applied"] for sample in record["samples"])
    mode, copies = NoWait(image, z), set()
    for copy in ("cpu", "tolist", "numpy", "item"):
        original = getattr(Tensor, copy)

        def counted(self: Tensor, *args: Any, original: Any = original) -> Any:
            # now, as another tensor may get the memory of one that is gone
            if storage(self) in mode.theirs:
                copies.add(storage(self))
            return original(self, *args)

        monkeypatch.setattr(Tensor, copy, counted)
    with mode:
        aug.transform(image, z, record)
    # .cpu().tolist() of the same numbers
    assert len(copies) == 1


def test_gradients_pass() -> None:
    image, z = picture(3).requires_grad_(), distances(3).requires_grad_()
    RandomUnderwater()(image, z)[0].sum().backward()
    for gradient in (image.grad, z.grad):
        assert gradient is not None
        assert gradient.abs().sum() > 0
