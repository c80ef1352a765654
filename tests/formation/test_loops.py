"""Pictures by the compiled loops against double precision, and who computes which."""

import json
import logging
import multiprocessing
import os
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import pytest
import torch
from filing import metres, pixels, save
from referees.conditions import Case, conditions
from scenes import coefficients, rand, stepped
from torch import Tensor

import uwaug
from benchmarks.accuracy import stability
from uwaug import fused
from uwaug.formation.loops import backend, render

pytest.importorskip("numba")

CONDITIONS = {name: case for group in conditions().values() for name, case in group.items()}
ERROR = 2e-6
"""Of sRGB values: light has some three roundings of 6e-8, and the curve a slope of up to 12.92."""


@pytest.fixture(autouse=True)
def by_default(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(backend.VARIABLE, raising=False)


@pytest.fixture
def rendered(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """The calls of the loops."""
    assert backend.ready()
    calls: list[Any] = []
    kernels = backend.loaded("kernels")
    run = kernels.render_rows
    monkeypatch.setattr(kernels, "render_rows", lambda *a: (calls.append(a), run(*a)))
    return calls


def assert_exact(module: uwaug.Underwater, image: Tensor, z: Tensor, most: float = ERROR) -> Tensor:
    """What the loops make of a picture, which is what PyTorch makes of it in double precision."""
    values = image / 255 if image.dtype == torch.uint8 else image
    with torch.no_grad(), fused.use(True):
        ours, exact = module(image, z.float()), module(values.double(), z.float().double())
    if image.dtype == torch.uint8:  # rounded, and clipped as bytes are
        exact, most = 255 * exact.clamp(0, 1), 0.5 + 255 * most
    torch.testing.assert_close(ours.double(), exact, rtol=0, atol=most)
    return ours


@pytest.mark.parametrize("name", CONDITIONS)
def test_every_condition(name: str, rendered: list[Any]) -> None:
    case: Case = CONDITIONS[name]
    with fused.use(True), torch.no_grad():
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


@pytest.mark.parametrize(
    "size, color_space, law",
    [
        ((1, 1), "srgb", None),
        ((3, 300), "linear", None),
        ((300, 3), "srgb", uwaug.PointSpread.calibrated(500.0)),
        ((40, 257), "srgb", None),
        ((70, 512), "linear", uwaug.PointSpread.calibrated(500.0)),
    ],
)
def test_every_size(size: tuple[int, int], color_space: Any, law: Any, rendered: list[Any]) -> None:
    medium = uwaug.Medium.from_water("7C", point_spread=law)
    module = uwaug.Underwater(medium, color_space=color_space, exposure="auto")
    image, z = rand(2, 3, *size).float(), stepped(2, 1, *size, far=15.0)
    assert_exact(module, image, z)
    assert_exact(module, (image * 255).to(torch.uint8), z)
    assert len(rendered) == 4


@pytest.mark.parametrize("images, maps, media", [(1, 1, 3), (3, 1, 1), (2, 2, 2), (1, 2, 2)])
def test_batches(images: int, maps: int, media: int) -> None:
    medium = uwaug.Medium.stack([coefficients(seed=n) for n in range(media)])
    module = uwaug.Underwater(medium, color_space="linear")
    assert_exact(module, rand(images, 3, 33, 65).float(), stepped(maps, 1, 33, 65))


def test_bright_pictures_keep_their_largest_value() -> None:
    module = uwaug.Underwater(uwaug.Medium.from_water("I"), None)
    image = rand(2, 3, 20, 30).float() * torch.tensor([1.0, 4.0]).reshape(2, 1, 1, 1)
    ours = assert_exact(module, image, torch.zeros(1, 1, 20, 30), 4 * ERROR)
    assert ours[1].max() > 1.5


def test_decoding_and_encoding_undo_each_other() -> None:
    values = torch.linspace(0, 1, 30_000).reshape(3, 100, 100)
    air = uwaug.Medium.from_coefficients([0.0] * 3, [0.0] * 3, [0.0] * 3)
    ours = assert_exact(uwaug.Underwater(air, None), values, torch.zeros(1, 100, 100), 8e-7)
    assert ours[0, 0, 0] == 0
    assert ours.max() == 1
    assert ours[-1, -1, -1] == 1


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
    image, z = rand(3, size, size + 33).float(), 1 + 4 * rand(1, size, size + 33, seed=1).float()
    with torch.no_grad():
        return module(image, z)


def test_bits_are_the_same_on_any_threads_and_in_any_bands(monkeypatch: pytest.MonkeyPatch) -> None:
    before, whole = torch.get_num_threads(), degraded()
    monkeypatch.setattr(render, "_LEAST", 1 << 10)  # bands of a few rows
    try:
        for count in (1, 2, 4):
            torch.set_num_threads(count)
            assert torch.equal(degraded(), whole)
    finally:
        torch.set_num_threads(before)
    assert render._pool is not None
    monkeypatch.setattr(render, "_BAND", 1)
    assert torch.equal(degraded(), whole)


def in_child(held: object, queue: Any) -> None:
    assert backend._lock is not held
    assert render._pool is None
    torch.set_num_threads(1)
    queue.put(float(degraded().double().sum()))


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork here")
def test_a_child_goes_on_after_a_fork(monkeypatch: pytest.MonkeyPatch) -> None:
    here, held = degraded(), threading.Lock()
    render._executor(1)
    held.acquire()  # as another thread may have left it
    monkeypatch.setattr(backend, "_lock", held)
    context = multiprocessing.get_context("fork")
    queue = context.SimpleQueue()
    child = context.Process(target=in_child, args=(held, queue))
    child.start()
    child.join(60)
    assert child.exitcode == 0
    assert queue.get() == float(here.double().sum())


def test_what_the_loops_take(rendered: list[Any]) -> None:
    image, z = rand(1, 3, 20, 30).float(), stepped(1, 1, 20, 30).float()
    medium = coefficients()
    with fused.use(True):
        module = uwaug.Underwater(medium, learnable=True, color_space="linear")
        module(image, z).sum().backward()
        assert len(rendered) == 1
        with torch.no_grad():
            module(image, z)
        assert len(rendered) == 2
        assert module(image.double(), z.double()).dtype == torch.float64
        uwaug.Underwater(medium, order="source")(image, z)
        plain = uwaug.Underwater(medium)
        torch.func.grad(lambda x: plain(x, z).sum())(image)
        with fused.use(False):
            plain(image, z)
        assert len(rendered) == 2


def test_nothing_is_compiled_in_the_middle_of_a_run() -> None:
    assert backend.ready(gradients=True)
    for name in ("kernels", "adjoint"):
        for kernel in vars(backend.loaded(name)).values():
            if "forceinline" not in getattr(kernel, "targetoptions", {"forceinline": True}):
                assert len(kernel.signatures) == 1, kernel


def test_the_switch(monkeypatch: pytest.MonkeyPatch) -> None:
    module = uwaug.Underwater(coefficients())
    assert fused.path() == "fused"
    assert "fused" in repr(module)
    with fused.use(False):
        assert fused.path() == "eager"
        assert "eager" in repr(module)
        with fused.use(True):
            assert fused.path() == "fused"
        assert fused.path() == "eager"
    monkeypatch.setenv(backend.VARIABLE, "0")
    assert fused.path() == "eager"
    with fused.use(True):
        assert fused.path() == "fused"
    monkeypatch.setenv(backend.VARIABLE, "yes")
    with pytest.raises(ValueError, match="UWAUG_FUSED must be 0 or 1, got 'yes'"):
        fused.path()
    with pytest.raises(TypeError, match="fused must be True, False or None, got 1"):
        fused.use(1)  # type: ignore[arg-type]


def test_without_numba(monkeypatch: pytest.MonkeyPatch, rendered: list[Any]) -> None:
    monkeypatch.setattr(backend, "_numba", False)
    assert fused.path() == "eager"
    degraded(20)
    assert not rendered
    with pytest.raises(ModuleNotFoundError, match=r'pip install "\.\[fast\]"'):
        fused.use(True)
    monkeypatch.setenv(backend.VARIABLE, "1")
    with pytest.raises(ModuleNotFoundError, match=r"UWAUG_FUSED=1: install numba"):
        fused.path()


BROKEN = """
import warnings, torch, uwaug
from uwaug import fused
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
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), root])}
    subprocess.run([sys.executable, "-c", BROKEN], env=environment, check=True, cwd=tmp_path)


def test_compiling(monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture) -> None:
    import numba
    from numba.core import caching

    def twice(x: float) -> float:
        return 2 * x

    monkeypatch.setattr(caching.CacheImpl, "_locator_classes", [])
    with pytest.raises(RuntimeError, match="cannot cache"):
        numba.njit(cache=True)(twice)
    with caplog.at_level(logging.INFO, "uwaug"), backend._compiling_told():
        assert backend.kernel(twice)(2.0) == 4.0  # without a folder to keep it in
    assert "compiling" in caplog.text
    caplog.clear()
    with caplog.at_level(logging.INFO, "uwaug"), backend._compiling_told():
        pass
    assert not caplog.text


def test_a_full_disk_keeps_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    errors = [OSError("No space left on device")]
    monkeypatch.setattr(backend, "_ready", set())
    monkeypatch.setattr(backend, "_on_disk", True)
    monkeypatch.setattr(render, "run_once", lambda: errors and (_ for _ in ()).throw(errors.pop()))
    kernels = backend.loaded("kernels")
    before = dict(vars(kernels))
    try:
        assert kernels.render_rows.stats.cache_path is not None
        assert backend.ready()
        assert kernels.render_rows.stats.cache_path is None
    finally:
        vars(kernels).update(before)


def test_loops_of_another_version_are_forgotten(tmp_path: Path) -> None:
    folder, sources = tmp_path / "kept", tmp_path / "loops"
    folder.mkdir()
    sources.mkdir()
    called, kept = sources / "called.py", folder / "caller.nbi"
    for text, stays in (("a = 1", False), ("a = 1", True), ("a = 2", False)):
        called.write_text(text)
        kept.touch()
        backend._drop_older.cache_clear()
        backend._drop_older(folder, sources)
        assert kept.exists() == stays


def test_a_record_is_replayed_by_its_own_path() -> None:
    augment = uwaug.RandomUnderwater.survey(waters="7C")
    image, z = rand(3, 60, 70).float(), 1 + rand(1, 60, 70, seed=1).float()
    by_path = {}
    for name, on in (("fused", True), ("eager", False)):
        with fused.use(on):
            record = augment.make_params(image)
            assert record["samples"][0]["path"] == name
            by_path[name] = record, augment.transform(image, z, record)
    with fused.use(True):
        for record, picture in by_path.values():
            assert torch.equal(augment.transform(image, z, record), picture)
    record, picture = by_path["fused"]
    with fused.use(False), pytest.warns(UserWarning, match="fused path, which is switched off"):
        other = augment.transform(image, z, record)
    torch.testing.assert_close(other, picture, rtol=0, atol=2 * ERROR)
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
    options = ("--distance", "z.npy", "--out", "out")
    assert run("degrade", "a.png", *options, *how)[0] == 0
    record = Path("out/a.png.json")
    assert '"path": "fused"' in record.read_text()
    values = json.loads(record.read_text())
    record.write_text(json.dumps({**values, "sha256": "0" * 64}))
    monkeypatch.setattr(backend, "_numba", False)
    code, _, err = run("degrade", "--from", str(record), "--out", "again")
    assert code == 1
    assert "(fused)" in err
    assert "(eager)" in err
