"""Batches on a device, which are formed at once; here on the CPU, taken for one."""

from typing import Any

import pytest
import torch
from augmenting import OPTIONS, H, W, distances, leaves, picture
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


def halved(aug: RandomUnderwater, record: Any, inputs: tuple[Tensor, ...]) -> Tensor:
    """The pictures of a batch, one by one."""
    return torch.stack(
        [
            aug.transform(inputs[0][i], inputs[1][i] if inputs[1:] else None, {"samples": [sample]})
            for i, sample in enumerate(record["samples"])
        ]
    )


@pytest.mark.parametrize("dtype", [torch.float32, torch.uint8])
@pytest.mark.parametrize("host", [True, False])
@pytest.mark.parametrize("name", OPTIONS)
def test_a_batch_is_its_pictures_one_by_one(
    name: str, host: bool, dtype: torch.dtype, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(checks, "on_host", lambda x: host)
    aug = RandomUnderwater(**OPTIONS[name])
    image, *maps = leaves(aug, 4)
    inputs = (picture(4, dtype), *maps)
    record = aug.make_params(image)
    together = aug.transform(inputs[0], maps[0] if maps else None, record)
    assert together.dtype == dtype
    one_by_one = halved(aug, record, inputs)
    most = 1 if dtype == torch.uint8 else 1e-5
    assert (together.double() - one_by_one.double()).abs().max() <= (0 if host else most)


@pytest.mark.parametrize("name", OPTIONS)
def test_they_are_those_of_the_host(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    aug = RandomUnderwater(**OPTIONS[name])
    _, *maps = leaves(aug, 4)
    # the blur's tolerance is that of pictures, not of noise
    image = interpolate(picture(4)[..., ::6, ::6], (H, W), mode="bilinear")
    record = aug.make_params(image, torch.Generator().manual_seed(0))
    z = maps[0] if maps else None
    together = aug.transform(image, z, record)
    monkeypatch.setattr(checks, "on_host", lambda x: True)
    difference = together - aug.transform(image, z, record)
    # plans differ, as that of a batch is made before its light is measured
    assert difference.square().mean().sqrt() < 0.002


@pytest.mark.parametrize("dtype", [torch.float32, torch.uint8])
@pytest.mark.parametrize(
    "name", ["default", "raw", "one water", "contents", "even", "half", "noisy", "night"]
)
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
