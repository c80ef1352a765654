"""Pictures by the compiled loops against double precision, and who computes which."""

import json
import logging
import multiprocessing
import os
import subprocess
import sys
import threading
from collections.abc import Iterator
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
from uwaug.formation import scene
from uwaug.formation.loops import backend, proof, render

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
    assert backend.ready(gradients=True)
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


def test_compiling_is_said_where_nobody_logs(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def twice(x: float) -> float:
        return 2 * x

    monkeypatch.setattr(backend, "_folder", lambda: None)
    with backend._compiling_told("kernels"):
        assert backend.kernel(twice)(2.0) == 4.0  # without a folder to keep it in
    (told,) = caplog.records
    assert told.levelno == logging.WARNING
    assert "compiles its loops" in told.message
    assert "no folder can be written to" in told.message
    caplog.clear()
    with backend._compiling_told("kernels"):
        pass
    assert not caplog.text


def test_nothing_is_kept_where_no_folder_can_be_written(monkeypatch: pytest.MonkeyPatch) -> None:
    from numba.core import caching

    assert backend._folder() is not None
    backend._folder.cache_clear()
    monkeypatch.setattr(caching.CacheImpl, "_locator_classes", [])
    assert backend._folder() is None
    backend._folder.cache_clear()


@pytest.fixture
def unloaded(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """The kernels, which a process is about to load; it is another's again after the test."""
    kernels = backend.loaded("kernels")
    for name, value in (("_ready", set()), ("_on_disk", True), ("_numba", True), ("_failure", "")):
        monkeypatch.setattr(backend, name, value)
    before = dict(vars(kernels))
    yield kernels
    vars(kernels).update(before)


def test_a_full_disk_keeps_nothing(monkeypatch: pytest.MonkeyPatch, unloaded: Any) -> None:
    def prove() -> None:
        if backend._on_disk:
            raise OSError("No space left on device")

    monkeypatch.setattr(proof, "prove", prove)
    assert unloaded.render_rows.stats.cache_path is not None
    assert backend.ready()
    assert unloaded.render_rows.stats.cache_path is None


def test_a_damaged_file_is_made_anew(
    monkeypatch: pytest.MonkeyPatch, unloaded: Any, tmp_path: Path
) -> None:
    damaged = tmp_path / "kernels.render_rows.nbi"
    other = tmp_path / "adjoint.slope_rows.nbi"

    def prove() -> None:
        if damaged.exists():
            raise EOFError("Ran out of input")

    monkeypatch.setattr(backend, "_folder", lambda: tmp_path)
    monkeypatch.setattr(proof, "prove", prove)
    backend._drop_older(tmp_path)
    damaged.touch()
    other.touch()
    assert backend.ready()
    assert fused.path() == "fused"
    assert other.exists()


CHANGES = {
    "law": (uwaug.PointSpread, "sigma", lambda sigma: lambda *a: 1.2 * sigma(*a)),
    "term": (scene, "total", lambda total: lambda *a: tuple(t + 0.01 for t in total(*a))),
}


@pytest.mark.parametrize("change", ["law", "term"])
def test_a_changed_law_or_term_is_not_ignored(
    change: str, monkeypatch: pytest.MonkeyPatch, unloaded: Any
) -> None:
    owner, name, changed = CHANGES[change]
    monkeypatch.setattr(owner, name, changed(getattr(owner, name)))
    with pytest.warns(UserWarning, match="has a law or a term been changed"):
        assert not backend.ready()
    assert fused.path() == "eager"
    with pytest.raises(ModuleNotFoundError, match="another picture than PyTorch"):
        fused.warm_up()


def test_a_changed_slope_is_not_ignored(monkeypatch: pytest.MonkeyPatch) -> None:
    proof.prove_gradients()
    adjoint = backend.loaded("adjoint")
    gathered = adjoint.gathered_rows
    monkeypatch.setattr(adjoint, "gathered_rows", lambda *a: (gathered(*a), a[4].__imul__(1.01)))
    with pytest.raises(proof.LoopsDifferError, match="another gradient"):
        proof.prove_gradients()


class Wider(uwaug.PointSpread):
    def sigma(self, *arguments: Any) -> Tensor:
        return 2 * super().sigma(*arguments)


def test_a_law_of_ones_own_goes_by_pytorch(rendered: list[Any]) -> None:
    image, z = rand(3, 20, 30).float(), stepped(1, 20, 30).float()
    own, usual = Wider(1.0), uwaug.PointSpread(2.0)
    wide, same = (uwaug.Underwater(coefficients(law=law)) for law in (own, usual))
    with torch.no_grad(), fused.use(True):
        picture = wide(image, z)
    assert not rendered
    with torch.no_grad(), fused.use(False):
        torch.testing.assert_close(picture, same(image, z), rtol=0, atol=1e-3)


def test_one_process_compiles_at_a_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fcntl = pytest.importorskip("fcntl")
    monkeypatch.setattr(backend, "_folder", lambda: tmp_path)

    def is_free() -> bool:
        with (tmp_path / "loops.lock").open("w") as other:
            try:
                fcntl.flock(other, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                return False
        return True

    assert is_free()
    with backend._alone():
        assert not is_free()
    assert is_free()
    monkeypatch.setattr(fcntl, "flock", lambda *_: (_ for _ in ()).throw(OSError("no locks")))
    with backend._alone():
        pass


def test_numba_that_may_not_compile(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(backend, "_numba", None)
    monkeypatch.setenv("NUMBA_DISABLE_JIT", "1")
    assert fused.path() == "eager"
    with pytest.raises(ModuleNotFoundError, match="unset NUMBA_DISABLE_JIT"):
        fused.use(True)
    monkeypatch.setattr(backend, "_numba", None)
    monkeypatch.setenv("NUMBA_DISABLE_JIT", "0")
    assert fused.path() == "fused"


def test_warm_up(run: Any) -> None:
    code, out, _ = run("warm-up")
    assert code == 0
    assert str(fused.warm_up()) in out


DEFAULTS = """
import sys, torch
torch.set_default_dtype(torch.bfloat16)
torch.set_default_device("meta")  # as "cuda" would be, where pictures are on the CPU
import uwaug
from uwaug import fused
image = torch.arange(3 * 24 * 30, dtype=torch.float32, device="cpu").reshape(3, 24, 30) % 97 / 97
z = 0.1 + 4 * image[:1]
development = uwaug.Development(white_balance=0.5, gamut=1.0)
lamp = uwaug.Light.lamp((0.4, -0.3, 0.0), (-0.1, 0.1, 1.0))
media = [uwaug.Medium.from_water("7C", surfaces=surfaces) for surfaces in ("grey", "spectral")]
results = []
for on in (True, False):
    with fused.use(on):
        x = image.clone().requires_grad_()
        learned = uwaug.Underwater(media[0], color_space="linear")(x, z)
        results += [learned, *torch.autograd.grad(learned.sum(), x)]
        results += [uwaug.Underwater(media[1], exposure="auto", development=development)(image, z)]
        results += [uwaug.Underwater(media[0], light=lamp, focal_px=30.0)(image, z)]
        results += [uwaug.RandomUnderwater().at(0, 0, 0)(image, z)[0]]
assert {r.dtype for r in results} == {torch.float32} and {r.device.type for r in results} == {"cpu"}
half = len(results) // 2
for ours, eager in zip(results[:half], results[half:], strict=True):
    print(float((ours - eager).abs().max()), float(ours.detach().double().sum()))
"""


def test_defaults_of_torch_change_nothing() -> None:
    def outputs(code: str) -> list[float]:
        command = [sys.executable, "-c", code]
        done = subprocess.run(command, check=True, capture_output=True, text=True)
        return [float(number) for number in done.stdout.split()]

    usual = DEFAULTS.replace("torch.bfloat16", "torch.float32").replace('"meta"', '"cpu"')
    numbers = outputs(DEFAULTS)
    assert numbers == outputs(usual)
    assert max(numbers[::2]) < 1e-5


def test_loops_of_another_version_are_forgotten(tmp_path: Path) -> None:
    folder, sources = tmp_path / "kept", tmp_path / "loops"
    folder.mkdir()
    sources.mkdir()
    called, kept = sources / "called.py", folder / "caller.nbi"
    for text, stays in (("a = 1", False), ("a = 1", True), ("a = 2", False)):
        called.write_text(text)
        kept.touch()
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
