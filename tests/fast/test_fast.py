"""The compiled loops against PyTorch, and who computes which."""

import math
import multiprocessing
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from hypothesis import example, given, settings
from hypothesis import strategies as st
from referees.conditions import Case, conditions
from scenes import coefficients, rand, stepped
from torch import Tensor

import uwaug
from benchmarks.accuracy import stability
from uwaug import (
    Development,
    Lamp,
    Light,
    MarineSnow,
    Medium,
    PointSpread,
    Sensor,
    Underwater,
    View,
    fast,
)
from uwaug.fast import gate
from uwaug.formation.setting import Setting
from uwaug.optics.curves import FARTHEST

pytest.importorskip("numba")

from uwaug.fast import kernels, render

CONDITIONS = {name: case for group in conditions().values() for name, case in group.items()}
ERROR = 2e-6
"""Of sRGB values: light has some three roundings of 6e-8, and the curve a slope of up to 12.92."""


@pytest.fixture(autouse=True)
def by_default(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("UWAUG_FAST", raising=False)


@pytest.fixture
def rendered(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """The calls of the loops."""
    calls: list[Any] = []
    run = kernels.render_rows
    monkeypatch.setattr(kernels, "render_rows", lambda *a: (calls.append(a), run(*a)))
    return calls


# ---- loops and PyTorch are one function


def formed(degrade: Underwater, image: Tensor, z: Tensor, most: float, *field: Tensor) -> Tensor:
    """What the loops make of a picture; refuses one that PyTorch does not make in double
    precision.
    """
    z, values = z.float(), image / 255 if image.dtype == torch.uint8 else image
    assert fast.can(image, z, replace(degrade.setting, medium=degrade.medium.to(torch.float32)))
    ours = degrade(image, z, *(x.float() for x in field))
    exact = degrade(values.double(), z.double(), *(x.float().double() for x in field))
    if image.dtype == torch.uint8:  # rounded, and clipped as bytes are
        exact, most = 255 * exact.clamp(0, 1), 0.5 + 255 * most
    elif degrade.color_space == "linear":  # of any range
        most *= max(1.0, float(exact.abs().max()))
    assert ours.dtype == image.dtype
    torch.testing.assert_close(ours.double(), exact, rtol=0, atol=most)
    return ours


class OwnMedium(Medium):
    """One of somebody's own, in which plankton glows."""

    def further_terms(self, z: Tensor) -> dict[str, Tensor]:
        return {"glow": z.new_tensor([0.1, 0.2, 0.3])[:, None, None] * -torch.expm1(-z)}


DEVELOPMENTS = {
    "none": Development(),
    "metered": Development(metered=True),
    "stops": Development(-1.3),
    "white balance": Development(white_balance=0.7),
    "saturation": Development(saturation=1.7),
    "gamut": Development(gamut=1.0),
    "more contrast": Development(tone=1.6),
    "less contrast": Development(tone=0.6),
    "all": Development(0.5, 0.6, 1.4, 0.8, 1.3, metered=True),
    "noise": Development(0.0, 0.6, metered=True, tone=1.3, noise=Sensor(1000, seed=1)),
    "noise of all": Development(0.5, 0.6, 1.4, 0.8, 1.3, metered=True, noise=Sensor(1000, seed=1)),
}
SNOW = MarineSnow(3000, seed=7)
MEDIA = {
    "grey": lambda: Medium.from_water("1C"),
    "spectral": lambda: Medium.from_water("II", surfaces="spectral", vertical_depth=6.0),
    "batch": lambda: Medium.stack([coefficients(seed) for seed in (1, 2)]),
    "glowing": lambda: OwnMedium(*MEDIA["blur coarse"]().tensors()),
    "spectral, glowing": lambda: OwnMedium(*MEDIA["spectral"]().tensors()),
    "snowy": lambda: coefficients(4).with_snow(SNOW),
    "spectral, snowy": lambda: MEDIA["spectral"]().with_snow(SNOW),
    "one of two snowy": lambda: Medium.stack([coefficients(4).with_snow(SNOW), coefficients(5)]),
}
LAWS = {
    "none": PointSpread.none(),
    "narrow": PointSpread(0.3),
    "coarse": PointSpread(30.0, 0.5),
    "from none to coarse": PointSpread(4.0, 2.0),
    "heavy tails": PointSpread(15.0, 0.62, "exponential"),
}
MEDIA |= {f"blur {name}": lambda law=law: coefficients(3, law) for name, law in LAWS.items()}
BESIDE = Lamp((0.4, -0.3, 0.0), 3.0, (-0.1, 0.1, 1.0), cone=45.0)
AHEAD = Lamp((0.1, 0.05, 1.5), 0.5, (0.0, 0.3, -1.0), cone=80.0)
LIGHTS = {
    "of the medium": None,
    "a lamp": Light((BESIDE,), daylight=0.0),
    "lamps": Light((BESIDE, Lamp((-0.5, 0.0, -0.2), 2.0, color=(1.0, 0.5, 0.2))), daylight=0.3),
    "in view": Light((AHEAD,)),
    "away": Light((Lamp((0.2, 0.0, 0.0), 2.0, (1.0, 0.0, -0.2), cone=90.0),)),
    "dim daylight": Light(daylight=0.4),
    "looking up": Light(pitch=12.0),
    "looking down, by lamp": Light((BESIDE,), daylight=0.3, pitch=-20.0),
}
SIZES = [(1, 1), (1, 9), (7, 5), (3, 300), (300, 3), (40, 257), (40, 270), (33, 70), (70, 90)]


SCENES = {
    "medium": MEDIA,
    "light": LIGHTS,
    "development": DEVELOPMENTS,
    "size": SIZES,
    "images": [1, 2],
    "maps": [1, 2],
    "field": [None, 0.7],
    "space": ["srgb", "linear"],
    "range": [None, (0.0, 20.0)],
    "dtype": [torch.float32, torch.uint8],
    "far": [6.0, 15.0],
    "view": [60.0, 75.0, View(focal_px=40.0, center=(3.0, 5.0))],
}
USUAL = {name: next(iter(values)) for name, values in SCENES.items()}


@settings(max_examples=120)
@given(st.fixed_dictionaries({name: st.sampled_from([*of]) for name, of in SCENES.items()}))
@example({**USUAL, "images": 2, "maps": 2, "dtype": torch.uint8})
@example({**USUAL, "medium": "batch", "size": (3, 300), "maps": 2, "far": 15.0})
@example({**USUAL, "medium": "spectral", "light": "in view", "development": "noise of all",
          "size": (40, 270), "field": 0.7, "view": 75.0})  # fmt: skip
@example({**USUAL, "light": "lamps", "development": "metered", "size": (40, 257)})
@example({**USUAL, "medium": "snowy", "light": "lamps", "development": "all", "size": (70, 90)})
@example({**USUAL, "medium": "glowing", "development": "all"})
@example({**USUAL, "medium": "spectral, glowing", "light": "lamps"})
@example({**USUAL, "medium": "blur from none to coarse", "light": "a lamp", "size": (70, 90)})
@example({**USUAL, "medium": "spectral", "light": "looking up", "size": (33, 70), "images": 2})
def test_loops_are_pytorch(scene: dict[str, Any]) -> None:
    image = rand(scene["images"], 3, *scene["size"]).float()
    z = stepped(scene["maps"], 1, *scene["size"], far=scene["far"])
    light, development = LIGHTS[scene["light"]], DEVELOPMENTS[scene["development"]]
    # brighter light has larger roundings; below black, curves of less contrast are steep
    most = ERROR if light is None and development == Development() else 4 * ERROR
    most = 5e-5 if development.tone < 1 else 2e-5 if "snowy" in scene["medium"] else most
    degrade = Underwater(
        MEDIA[scene["medium"]](),
        scene["range"],
        color_space=scene["space"],
        development=development,
        light=light,
        view=scene["view"],
    )
    field = [] if scene["field"] is None else [torch.full_like(z, scene["field"])]
    image = (255 * image).byte() if scene["dtype"] == torch.uint8 else image
    formed(degrade, image, z, most, *field)


@pytest.mark.parametrize("name", CONDITIONS)
def test_every_condition(name: str, rendered: list[Any]) -> None:
    case: Case = CONDITIONS[name]
    with torch.no_grad():
        if case.error:
            with pytest.raises(ValueError, match=case.error):
                stability.ours(case.to(case.dtype))
            return
        ours = stability.ours(case.to(case.dtype))
        assert bool(rendered) == (case.dtype != torch.float64 and case.image.numel() > 0)
        # the input as that type holds it
        exact = stability.ours(case.to(case.dtype).to(torch.float64))
    assert ours.dtype == case.dtype
    rounding = torch.finfo(case.dtype).eps if case.dtype.itemsize < 4 else ERROR
    torch.testing.assert_close(ours.double(), exact, rtol=0, atol=rounding * case.peak)


@pytest.mark.parametrize("place", [(0.0, 0.0, 0.0), (0.0, 0.0, 2.0), (0.0, 0.0, -1.0)])
def test_where_rays_meet_lamps(place: tuple[float, float, float]) -> None:
    lamps = Lamp(place, 0.1, cone=70.0), Lamp(place, 0.1, aim=(1.0, 0.0, 0.0), cone=90.0)
    degrade = Underwater(MEDIA["spectral"](), None, light=Light(lamps))
    for far in (0.0, 1e-3, 2.0, FARTHEST):
        image, z = rand(1, 3, 9, 9).float(), torch.full((1, 1, 9, 9), 3.0)
        z[..., 4:6, 4:6] = far
        formed(degrade, image, z, 4 * ERROR)


def test_bright_pictures_keep_their_largest_value() -> None:
    image = rand(2, 3, 20, 30).float() * torch.tensor([1.0, 4.0]).reshape(2, 1, 1, 1)
    degrade = Underwater(Medium.from_water("I"), None)
    assert formed(degrade, image, torch.zeros(1, 1, 20, 30), 4 * ERROR)[1].max() > 1.5


def test_decoding_and_encoding_undo_each_other() -> None:
    values = torch.linspace(0, 1, 30_000).reshape(1, 3, 100, 100)
    air = Underwater(Medium.from_coefficients([0.0] * 3, [0.0] * 3, [0.0] * 3), None)
    ours = formed(air, values, torch.zeros(1, 1, 100, 100), 8e-7)
    assert (ours[0, 0, 0, 0], ours.max(), ours[0, -1, -1, -1]) == (0, 1, 1)


# ---- the gate


def own(kind: type, method: str) -> type:
    """A subclass of somebody's own."""
    return type("Own", (kind,), {method: lambda *_: None})


IMAGE, Z, WATER = rand(1, 3, 20, 30).float(), stepped(1, 1, 20, 30).float(), coefficients()
LEARNED = WATER.map(lambda t: t.clone().requires_grad_())
LEARNED_LAW = replace(WATER, scale=torch.ones(1, dtype=torch.float64, requires_grad=True))


@pytest.mark.parametrize(
    "change",
    [
        {"image": IMAGE.clone().requires_grad_()},
        {"z": Z.clone().requires_grad_()},
        {"medium": LEARNED},
        {"medium": LEARNED_LAW},
        {"medium": own(Medium, "curves")(*WATER.tensors())},
        {"medium": own(Medium, "width")(*WATER.tensors())},
        {"medium": own(Medium, "image")(*WATER.tensors())},
        {"z": Z.double()},
        {"image": IMAGE.to("meta")},
        {"light": object()},
        {"light": Light((Lamp(), own(Lamp, "sent")((0.5, 0.0, 0.0))))},
        {"view": own(View, "focal")(75.0)},
        {"development": Development(exposure=torch.tensor(0.5, requires_grad=True))},
    ],
    ids=lambda change: next(iter(change)),
)
def test_the_gate_is_closed(change: dict[str, Any]) -> None:
    assert fast.can(IMAGE, Z, Setting(WATER))
    image, z = change.pop("image", IMAGE), change.pop("z", Z)
    assert not fast.can(image, z, Setting(**{"medium": WATER, **change}))


def test_the_gate_is_open_where_gradients_are_off_and_to_bytes() -> None:
    with torch.no_grad():
        assert fast.can(IMAGE.clone().requires_grad_(), Z, Setting(LEARNED))
    assert fast.can((255 * IMAGE).byte(), Z, Setting(WATER))


def test_the_switches(rendered: list[Any], monkeypatch: pytest.MonkeyPatch) -> None:
    degrade = Underwater(WATER)
    by_loops = degrade(IMAGE, Z)
    assert len(rendered) == 1
    for name, value in (("UWAUG_FAST", "0"), ("NUMBA_DISABLE_JIT", "1")):
        with monkeypatch.context() as switched:
            switched.setenv(name, value)
            torch.testing.assert_close(degrade(IMAGE, Z), by_loops, rtol=0, atol=ERROR)
            with pytest.raises(ModuleNotFoundError, match="the compiled loops need numba"):
                fast.warm_up()
    monkeypatch.setattr(gate, "_has_numba", lambda: False)
    degrade(IMAGE, Z)
    assert len(rendered) == 1


BROKEN = """
import warnings, torch, uwaug
degrade = uwaug.Underwater(uwaug.Medium.from_water("7C"))
assert "numba" not in __import__("sys").modules
with warnings.catch_warnings(record=True) as caught:
    warnings.simplefilter("always")
    degrade(torch.rand(3, 20, 30), torch.ones(1, 20, 30))
assert "does not work" in str(caught[0].message), caught
"""


def test_a_numba_that_does_not_work_is_told_of(tmp_path: Path) -> None:
    (tmp_path / "numba.py").write_text("raise ImportError('Numba needs NumPy 1.0')")
    root = str(Path(uwaug.__file__).parent.parent)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), root])}
    subprocess.run([sys.executable, "-c", BROKEN], env=environment, check=True, cwd=tmp_path)


def test_nothing_is_compiled_in_the_middle_of_a_run() -> None:
    fast.warm_up()
    compiled = [k for k in vars(kernels).values() if getattr(k, "targetoptions", {}).get("nogil")]
    for kernel in compiled:
        if not kernel.targetoptions.get("forceinline"):
            assert len(kernel.signatures) == 1, kernel


# ---- threads and processes: one path, which gives the same bits


def degraded() -> Tensor:
    z = 1 + 4 * rand(1, 400, 433, seed=1).float()
    return Underwater(Medium.from_water("7C"))(rand(3, 400, 433).float(), z)


def test_bits_are_the_same_on_any_threads_and_in_any_bands(monkeypatch: pytest.MonkeyPatch) -> None:
    before, whole = torch.get_num_threads(), degraded()
    monkeypatch.setattr(render, "_LEAST", 1 << 10)  # bands of a few rows
    try:
        for count in (1, 2, 4):
            torch.set_num_threads(count)
            assert torch.equal(degraded(), whole)
    finally:
        torch.set_num_threads(before)
    monkeypatch.setattr(render, "_BAND", 1)
    assert torch.equal(degraded(), whole)


def in_child(queue: Any) -> None:
    assert render._pool is None
    torch.set_num_threads(1)
    queue.put(float(degraded().double().sum()))


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork here")
def test_a_child_goes_on_after_a_fork() -> None:
    here = degraded()
    render._executor(1)
    context = multiprocessing.get_context("fork")
    queue = context.SimpleQueue()
    # as another thread may hold it
    with render._lock:
        child = context.Process(target=in_child, args=(queue,))
        child.start()
    child.join(60)
    assert child.exitcode == 0
    assert math.isclose(queue.get(), float(here.double().sum()), rel_tol=0)
