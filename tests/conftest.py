import contextlib
import os
import signal
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import torch
from hypothesis import settings
from threadpoolctl import threadpool_limits
from torch import Tensor

import uwaug.presets.scene
from uwaug import fast
from uwaug._support.once import Once

pytest.register_assert_rewrite("referees.terms")  # before a test imports it
# at the end, so that `benchmarks` is found but an installed uwaug is tested, not the checkout's
sys.path.append(str(Path(__file__).parent.parent))
# no test asks the network
os.environ |= {"NO_ALBUMENTATIONS_UPDATE": "1", "HF_HUB_OFFLINE": "1"}
# the same examples at every run, however long each takes
settings.register_profile("uwaug", derandomize=True, deadline=None, max_examples=50)
settings.load_profile("uwaug")
if "PYTEST_XDIST_WORKER" in os.environ:
    # workers share the machine; what they start does, too
    torch.set_num_threads(1)
    threadpool_limits(1)
    os.environ.setdefault("OMP_NUM_THREADS", "1")


def pytest_configure(config: pytest.Config) -> None:
    """Compile the loops before workers begin, each of which would compile them for itself."""
    if getattr(config.option, "numprocesses", None) and "PYTEST_XDIST_WORKER" not in os.environ:
        with contextlib.suppress(ModuleNotFoundError):
            fast.warm_up()


class Scene(NamedTuple):
    """Middlebury's motorcycle, 500×741, with the 7 % of unknown pixels set to the farthest
    distance.
    """

    srgb: Tensor  # 3×H×W, float64
    linear: Tensor  # 3×H×W
    distance: Tensor  # 1×H×W, metres


@pytest.fixture(scope="session")
def motorcycle() -> Scene:
    from skimage.data import stereo_motorcycle

    left, _, disparity = stereo_motorcycle()
    known = np.isfinite(disparity)
    filled = np.where(known, disparity, disparity[known].min()).astype(np.float64)
    depth = 994.978 * 0.193001 / (filled + 31.086)
    srgb = left.transpose(2, 0, 1) / 255
    linear = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
    return Scene(*map(torch.from_numpy, (srgb, linear, depth[None])))


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> Any:
    """A scene of a few pixels in place of the motorcycle."""

    generator = torch.Generator().manual_seed(0)
    scene = uwaug.presets.scene.Scene(
        torch.rand(3, 20, 30, generator=generator),
        torch.linspace(1, 4, 600).reshape(1, 20, 30),
        view=uwaug.View(focal_px=40.0),
    )
    monkeypatch.setattr(uwaug.presets.scene, "motorcycle", lambda: scene)
    return scene


@pytest.fixture
def run(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Iterator[Callable[..., tuple[int, str, str]]]:
    """Run a command line; return exit code, stdout, stderr."""
    from uwaug.cli import app as cli

    def call(*arguments: str) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["uwaug", *arguments])
        with pytest.raises(SystemExit) as end:
            cli.main()
        return (end.value.code or 0, *capsys.readouterr())

    before = signal.getsignal(signal.SIGTERM)
    yield call
    signal.signal(signal.SIGTERM, before)


@pytest.fixture(scope="session")
def torchvision() -> Any:
    try:
        import torchvision
    except RuntimeError:
        # Built for a torch with CUDA, beside one without: its compiled part does not load, and its
        # Python part misses two operators.
        signature = "(Tensor dets, Tensor scores, float iou_threshold) -> Tensor"
        torch.library.define("torchvision::nms", signature)
        torch.library.define("torchvision::qnms", signature)
        import torchvision
    import torchvision.transforms.v2

    return torchvision


@pytest.fixture(autouse=True)
def all_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a process says once has been said, but for tests that ask for `nothing_is_said`: many
    take odd waters and maps.
    """
    monkeypatch.setattr(Once, "muted", True)


@pytest.fixture
def nothing_is_said(all_is_said: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """As in a new process."""
    monkeypatch.setattr(Once, "muted", False)
    for warning in Once.every:
        warning.renew()
