"""The compiled loops against eager PyTorch, and how they are chosen."""

import json
import logging
import multiprocessing
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from filing import metres, pixels, save
from forming import coefficients, distances
from inputs import rand
from referees.conditions import Case, conditions
from torch import Tensor

import uwaug
from benchmarks.accuracy import stability
from uwaug import fused
from uwaug.formation.colour import srgb_to_linear
from uwaug.formation.loops import compiling, loops, switch, threads
from uwaug.formation.loops import picture as pictures

CONDITIONS = {name: case for group in conditions().values() for name, case in group.items()}
ERROR = 2e-6

pytestmark = pytest.mark.skipif(not switch._is_found(), reason="numba is not installed")


@pytest.fixture(autouse=True)
def by_default(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(switch.VARIABLE, raising=False)


@pytest.fixture
def formed(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """The calls of the loops."""
    calls: list[Any] = []
    form = pictures._form
    monkeypatch.setattr(pictures, "_form", lambda *given: (calls.append(given), form(*given)))
    return calls


def both(run: Callable[[], Tensor]) -> tuple[Tensor, Tensor]:
    """What the loops and what PyTorch makes."""
    with torch.no_grad():
        with fused.use(True):
            ours = run()
        with fused.use(False):
            return ours, run()


@pytest.mark.parametrize("name", CONDITIONS)
def test_every_condition_is_as_eager_has_it(name: str, formed: list[Any]) -> None:
    case: Case = CONDITIONS[name]
    if case.error:
        for on in (True, False):
            with fused.use(on), torch.no_grad(), pytest.raises(ValueError, match=case.error):
                stability.ours(case.to(case.dtype))
        return
    ours, eager = both(lambda: stability.ours(case.to(case.dtype)))
    rounding = torch.finfo(case.dtype).eps if case.dtype.itemsize < 4 else ERROR
    torch.testing.assert_close(ours, eager, rtol=0, atol=rounding * case.peak)
    assert ours.dtype == case.dtype
    taken = case.dtype != torch.float64 and case.image.numel() > 0
    assert bool(formed) == taken


SIZES = [(1, 1), (3, 300), (300, 3), (40, 257), (70, 512)]


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("color_space", ["srgb", "linear"])
@pytest.mark.parametrize("preset", ["survey", "calibrated"])
def test_every_size_and_colour_space(
    size: tuple[int, int], color_space: Any, preset: str, formed: list[Any]
) -> None:
    law = uwaug.PointSpread.calibrated(500.0) if preset == "calibrated" else None
    medium = uwaug.Medium.from_water("7C", point_spread=law)
    module = uwaug.Underwater(medium, color_space=color_space, exposure="auto")
    image, z = rand(2, 3, *size).float(), distances(2, 1, *size, far=15.0).float()
    ours, eager = both(lambda: module(image, z))
    torch.testing.assert_close(ours, eager, rtol=0, atol=ERROR)
    bytes_in = (image * 255).to(torch.uint8)
    ours, eager = both(lambda: module(bytes_in, z).int())
    apart = (ours - eager).abs()
    assert apart.max() <= 1
    assert apart.double().mean() < 1e-3
    assert len(formed) == 4


@pytest.mark.parametrize("images, maps, media", [(1, 1, 3), (3, 1, 1), (2, 2, 2), (1, 2, 2)])
def test_batches(images: int, maps: int, media: int) -> None:
    medium = uwaug.Medium.stack([coefficients(seed=n) for n in range(media)])
    module = uwaug.Underwater(medium, color_space="linear").float()
    image, z = rand(images, 3, 33, 65).float(), distances(maps, 1, 33, 65).float()
    ours, eager = both(lambda: module(image, z))
    torch.testing.assert_close(ours, eager, rtol=0, atol=ERROR)


def test_bright_pictures_keep_their_largest_value() -> None:
    module = uwaug.Underwater(uwaug.Medium.from_water("I"))
    image = rand(2, 3, 20, 30).float() * torch.tensor([1.0, 4.0]).reshape(2, 1, 1, 1)
    ours, eager = both(lambda: module(image, torch.zeros(1, 1, 20, 30)))
    torch.testing.assert_close(ours, eager, rtol=0, atol=4 * ERROR)
    assert ours[1].max() > 1.5


def test_white_stays_white() -> None:
    white = torch.ones(3, 1, 256)
    with fused.use(True):
        assert torch.equal(pictures.to_light(white, "srgb"), white)


def test_decoding_and_encoding_undo_each_other() -> None:
    values = torch.linspace(0, 1, 30_000).reshape(3, 100, 100)
    water = uwaug.Medium.from_coefficients([0.0] * 3, [0.0] * 3, [0.0] * 3)
    with torch.no_grad(), fused.use(True):
        light = pictures.to_light(values, "srgb")
        again = uwaug.Underwater(water)(values, torch.zeros(1, 100, 100))
    expected = srgb_to_linear(values.double())
    torch.testing.assert_close(light.double(), expected, rtol=0, atol=3e-7)
    torch.testing.assert_close(again, values, rtol=0, atol=8e-7)
    assert again[0, 0, 0] == 0
    assert again.max() == 1


def test_a_pixel_beyond_white_changes_no_other() -> None:
    image, z = rand(3, 20, 300).float(), torch.ones(1, 20, 300)
    bright = image.clone()
    bright[:, 3, 7] = torch.tensor([-0.05, 1.5, 3.0])
    module = uwaug.Underwater(coefficients(law=uwaug.PointSpread.none())).float()
    with torch.no_grad(), fused.use(True):
        changed = (module(image, z) != module(bright, z)).nonzero()
    assert changed.tolist() == [[c, 3, 7] for c in range(3)]


def degraded(size: int = 400) -> Tensor:
    module = uwaug.load_preset("survey", water="7C").module()
    with torch.no_grad():
        return module(
            rand(3, size, size + 33).float(), 1 + 4 * rand(1, size, size + 33, seed=1).float()
        )


def test_bits_are_the_same_on_any_number_of_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    before = torch.get_num_threads()
    monkeypatch.setattr(threads, "_LEAST", 1 << 10)  # bands of a few rows
    try:
        made = []
        for count in (1, 2, 4):
            torch.set_num_threads(count)
            made.append(degraded())
    finally:
        torch.set_num_threads(before)
    assert torch.equal(made[0], made[1])
    assert torch.equal(made[0], made[2])
    assert threads._pool is not None


def test_bits_are_the_same_in_any_bands(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = degraded()
    monkeypatch.setattr(pictures, "_BAND", 1)
    assert torch.equal(degraded(), whole)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork here")
def test_a_child_goes_on_after_a_fork(monkeypatch: pytest.MonkeyPatch) -> None:
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        here = degraded()
    finally:
        torch.set_num_threads(before)
    monkeypatch.setattr(loops, "_lock", _Held())  # as another thread may have left it
    context = multiprocessing.get_context("fork")
    queue = context.SimpleQueue()
    child = context.Process(target=_forked, args=(queue,))
    child.start()
    child.join(60)
    assert child.exitcode == 0
    assert queue.get() == float(here.double().sum())


class _Held:
    def __enter__(self) -> None:
        raise AssertionError("the parent's lock was taken")

    def __exit__(self, *_: Any) -> None: ...


def _forked(queue: Any) -> None:
    assert type(loops._lock) is not _Held
    assert threads._pool is None
    torch.set_num_threads(1)
    queue.put(float(degraded().double().sum()))


def test_gradients_are_by_loops_and_other_numbers_eager(formed: list[Any]) -> None:
    image, z = rand(1, 3, 20, 30).float(), distances(1, 1, 20, 30).float()
    medium = coefficients()
    with fused.use(True):
        module = uwaug.Underwater(medium, learnable=True, color_space="linear")
        module(image, z).sum().backward()
        assert len(formed) == 1
        formed.clear()
        assert module(image.double(), z.double()).dtype == torch.float64
        source = uwaug.Underwater(medium, order="source")
        source(image, z)
        plain = uwaug.Underwater(medium)
        torch.func.grad(lambda x: plain(x, z).sum())(image)
        assert not formed
        with torch.no_grad():
            module(image, z)
        assert len(formed) == 1


def test_the_switch(monkeypatch: pytest.MonkeyPatch) -> None:
    assert fused.path() == "fused"
    with fused.use(False):
        assert fused.path() == "eager"
        with fused.use(True):
            assert fused.path() == "fused"
        assert fused.path() == "eager"
    monkeypatch.setenv(switch.VARIABLE, "0")
    assert fused.path() == "eager"
    with fused.use(True):
        assert fused.path() == "fused"
    monkeypatch.setenv(switch.VARIABLE, "yes")
    with pytest.raises(ValueError, match="UWAUG_FUSED must be 0 or 1, got 'yes'"):
        fused.path()
    with pytest.raises(TypeError, match="fused must be True, False or None, got 1"):
        fused.use(1)  # type: ignore[arg-type]


def test_repr_says_which_path_is_used() -> None:
    module = uwaug.Underwater(coefficients())
    with fused.use(True):
        assert "fused" in repr(module)
    with fused.use(False):
        assert "eager" in repr(module)


def test_without_numba_all_is_as_before(monkeypatch: pytest.MonkeyPatch, formed: list[Any]) -> None:
    monkeypatch.setattr(switch, "_found", False)
    assert fused.path() == "eager"
    degraded(20)
    assert not formed
    with pytest.raises(ModuleNotFoundError, match=r"uwaug\[fast\]"):
        fused.use(True)
    monkeypatch.setenv(switch.VARIABLE, "1")
    with pytest.raises(ModuleNotFoundError, match=r"UWAUG_FUSED=1: install numba"):
        fused.path()


BROKEN = """
import warnings, torch, uwaug
from uwaug import fused
from uwaug.formation.colour import srgb_to_linear
degrade = uwaug.load_preset("survey", water="7C").module()
assert "numba" not in __import__("sys").modules
with warnings.catch_warnings(record=True) as caught, torch.no_grad():
    warnings.simplefilter("always")
    degrade(torch.rand(3, 20, 30), torch.ones(1, 20, 30))
assert "does not work" in str(caught[0].message), caught
assert fused.path() == "eager"
"""


def test_a_numba_that_does_not_work_is_told(tmp_path: Path) -> None:
    (tmp_path / "numba.py").write_text("raise ImportError('Numba needs NumPy 1.0')")
    root = str(Path(uwaug.__file__).parent.parent)
    paths = os.pathsep.join([str(tmp_path), root])
    environment = {**os.environ, "PYTHONPATH": paths}
    subprocess.run([sys.executable, "-c", BROKEN], env=environment, check=True, cwd=tmp_path)


def test_loops_are_compiled_without_a_folder_to_keep_them(monkeypatch: pytest.MonkeyPatch) -> None:
    import numba
    from numba.core import caching

    monkeypatch.setattr(caching.CacheImpl, "_locator_classes", [])

    def twice(x: float) -> float:
        return 2 * x

    with pytest.raises(RuntimeError, match="cannot cache"):
        numba.njit(cache=True)(twice)
    assert compiling.kernel(twice)(2.0) == 4.0


def test_loops_of_another_version_are_forgotten(tmp_path: Path) -> None:
    folder, sources = tmp_path / "kept", tmp_path / "loops"
    folder.mkdir()
    sources.mkdir()
    called, kept = sources / "called.py", folder / "caller.nbi"
    for text, stays in (("a = 1", False), ("a = 1", True), ("a = 2", False)):
        called.write_text(text)
        kept.touch()
        compiling._drop_older.cache_clear()
        compiling._drop_older(folder, sources)
        assert kept.exists() == stays


def test_compiling_is_logged(caplog: pytest.LogCaptureFixture) -> None:
    def thrice(x: float) -> float:
        return 3 * x

    with caplog.at_level(logging.INFO, "uwaug.fused"), loops._told():
        assert compiling.inner(thrice)(2.0) == 6.0
    assert "compiling" in caplog.text
    caplog.clear()
    with caplog.at_level(logging.INFO, "uwaug.fused"), loops._told():
        pass
    assert not caplog.text


def test_a_record_is_replayed_by_its_own_path() -> None:
    augment = uwaug.RandomUnderwater.survey(waters="7C")
    image, z = rand(3, 60, 70).float(), 1 + rand(1, 60, 70, seed=1).float()
    made = {}
    for name, on in (("fused", True), ("eager", False)):
        with fused.use(on):
            record = augment.make_params(image)
            assert record["samples"][0]["path"] == name
            made[name] = record, augment.transform(image, z, record)
    with fused.use(True):
        for record, picture in made.values():
            assert torch.equal(augment.transform(image, z, record), picture)
    record, picture = made["fused"]
    with fused.use(False), pytest.warns(UserWarning, match="fused path, which is switched off"):
        other = augment.transform(image, z, record)
    torch.testing.assert_close(other, picture, rtol=0, atol=ERROR)
    odd = {"samples": [{**record["samples"][0], "path": "fast"}]}
    with pytest.raises(ValueError, match="params: path"):
        augment.transform(image, z, odd)


@pytest.mark.parametrize("how", [["--water", "3C"], ["--random", "--seed", "5"]])
def test_a_file_that_another_path_would_make_is_refused(
    how: list[str], run: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    save("a.png", pixels())
    save("z.npy", metres())
    given = ("--distance", "z.npy", "--out", "out")
    assert run("degrade", "a.png", *given, *how)[0] == 0
    record = Path("out/a.png.json")
    assert '"path": "fused"' in record.read_text()
    made = json.loads(record.read_text())
    record.write_text(json.dumps({**made, "sha256": "0" * 64}))
    monkeypatch.setattr(switch, "_found", False)
    with pytest.warns(UserWarning, match="the record is of the fused path, which needs numba"):
        code, _, err = run("degrade", "--from", str(record), "--out", "again")
    assert code == 1
    assert "(fused)" in err
    assert "(eager)" in err
