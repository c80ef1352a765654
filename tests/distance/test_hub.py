"""Networks of the Hugging Face hub, from one on the loopback interface."""

import hashlib
import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch
from huggingface_hub import constants
from networks import mean_of_channels
from PIL import Image

from uwaug.distance import Network
from uwaug.distance.hub import NAMED

SMALL = NAMED["depth-anything-v2-small"]


class Handler(BaseHTTPRequestHandler):
    """What the hub answers to requests for the files of a dictionary, `/owner/name/file`."""

    def do_HEAD(self) -> None:
        self.send_file(with_body=False)

    def do_GET(self) -> None:
        self.send_file(with_body=True)

    def send_file(self, with_body: bool) -> None:
        hub = self.server.hub
        repository, _, place = self.path[1:].partition("/resolve/")
        revision, _, file = place.partition("/")
        hub.revisions += [revision] if place else []  # it is asked for other things, too
        content = hub.files.get(f"{repository}/{file}")
        if repository in hub.refusals or content is None:
            status, code = hub.refusals.get(repository, (404, "EntryNotFound"))
            self.send_response(status)
            self.send_header("X-Error-Code", code)
            self.send_header("Content-Length", "0")
            self.end_headers()
            return
        self.send_response(200)
        self.send_header("X-Repo-Commit", SMALL.revision)
        self.send_header("ETag", f'"{hashlib.sha256(content).hexdigest()}"')
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        if with_body:
            self.wfile.write(content[: hub.bytes_sent])
            hub.bytes_sent = hub.bytes_sent if hub.is_weak else None
            self.close_connection = True

    def log_message(self, *words: object) -> None: ...


@pytest.fixture
def hub(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[SimpleNamespace]:
    """A hub with one network, whose maps are means of channels, and an empty cache."""
    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    server.hub = SimpleNamespace(
        files={}, refusals={}, revisions=[], bytes_sent=None, is_weak=False
    )
    server.hub.url = f"http://127.0.0.1:{server.server_port}"
    server.hub.files[f"{SMALL.repository}/{SMALL.file}"] = Path(
        mean_of_channels(tmp_path / "net.onnx")
    ).read_bytes()
    # HF_ENDPOINT and the like, which the library reads when it is imported
    template = constants.HUGGINGFACE_CO_URL_TEMPLATE.replace(constants.ENDPOINT, server.hub.url)
    monkeypatch.setattr(constants, "HUGGINGFACE_CO_URL_TEMPLATE", template)
    monkeypatch.setattr(constants, "ENDPOINT", server.hub.url)
    monkeypatch.setattr(constants, "HF_HUB_OFFLINE", False)
    monkeypatch.setattr(constants, "HF_HUB_CACHE", str(tmp_path / "cache"))
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
    thread.start()
    yield server.hub
    server.shutdown()
    server.server_close()
    thread.join()


def test_a_network_is_fetched_once(
    hub: SimpleNamespace, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    picture = torch.rand(3, 28, 42)
    depth = Network("depth-anything-v2-small", short_side=28)(picture)
    expected = Network(tmp_path / "net.onnx", short_side=28)(picture)
    assert torch.equal(depth, expected)
    requests = len(hub.revisions)
    assert set(hub.revisions) == {SMALL.revision}
    assert torch.equal(Network("depth-anything-v2-small", short_side=28)(picture), depth)
    assert len(hub.revisions) == requests  # a commit never changes
    monkeypatch.setattr(constants, "HF_HUB_OFFLINE", True)
    assert Network("depth-anything-v2-small").file.is_file()


def test_any_file_of_any_repository(hub: SimpleNamespace) -> None:
    hub.files["me/mine/a/b.onnx"] = hub.files[f"{SMALL.repository}/{SMALL.file}"]
    network = Network("me/mine:a/b.onnx", revision="v1", short_side=28)
    assert not hub.revisions  # a preset of a stranger, merely loaded, asks nothing
    assert network(torch.rand(3, 28, 42)).shape == (1, 28, 42)
    assert hub.revisions[0] == "v1"
    assert Network("me/mine:a/b.onnx").file.is_file()
    assert hub.revisions[-1] == "main"


@pytest.mark.parametrize(
    "model, refusal, error, words",
    [
        ("me/mine:b.onnx", (404, "EntryNotFound"), FileNotFoundError, "no such file"),
        ("me/mine:b.onnx", (401, "RepoNotFound"), FileNotFoundError, "no such repository; a priv"),
        ("me/mine:b.onnx", (404, "RevisionNotFound"), FileNotFoundError, "no such revision v1"),
        ("me/mine:b.onnx", (403, "GatedRepo"), PermissionError, "asks for an account: agree to"),
        ("me/mine:b.onnx", (500, ""), ConnectionError, "could not be fetched, "),
        ("me/-x:b.onnx", None, ValueError, "me/-x:b.onnx: "),
        ("me/mine/b.onnx", None, FileNotFoundError, "depth-anything-v2-small, or owner/name:file"),
        ("depth-anything-v3", None, FileNotFoundError, "depth-anything-v2-small, or owner/name"),
    ],
)
def test_what_the_hub_does_not_give(
    hub: SimpleNamespace,
    model: str,
    refusal: tuple[int, str] | None,
    error: type[Exception],
    words: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("time.sleep", lambda seconds: None)  # between its attempts
    hub.refusals["me/mine"] = refusal
    with pytest.raises(error, match=words):
        Network(model, revision="v1").file  # noqa: B018


def test_a_download_that_breaks_off_goes_on(
    hub: SimpleNamespace, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("time.sleep", lambda seconds: None)
    hub.bytes_sent = 100  # of the first answer
    network = Network("depth-anything-v2-small", short_side=28)
    assert network(torch.rand(3, 28, 42)).shape == (1, 28, 42)


def test_a_download_that_always_breaks_off(
    hub: SimpleNamespace, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("time.sleep", lambda seconds: None)
    hub.bytes_sent, hub.is_weak = 100, True
    with pytest.raises(ConnectionError, match=r"could not be fetched, .*: try again"):
        Network("depth-anything-v2-small").file  # noqa: B018
    assert not [path for path in (tmp_path / "cache").rglob("*.onnx") if path.is_file()]


def test_a_file_that_is_no_network(hub: SimpleNamespace) -> None:
    hub.files["me/mine/README.md"] = b"# Mine"
    with pytest.raises(ValueError, match=r"README\.md: ONNX Runtime cannot load it"):
        Network("me/mine:README.md")(torch.rand(3, 28, 42))


def test_no_connection(hub: SimpleNamespace, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(constants, "HF_HUB_OFFLINE", True)
    with pytest.raises(ConnectionError, match="hub cannot be reached: try again, or fetch the fil"):
        Network("depth-anything-v2-small").file  # noqa: B018


def test_no_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "huggingface_hub", None)
    with pytest.raises(ImportError, match=r"huggingface_hub is missing: pip install \"\.\[hub\]\""):
        Network("depth-anything-v2-small").file  # noqa: B018


def test_files_and_functions_have_no_revision(tmp_path: Path) -> None:
    for model in (mean_of_channels(tmp_path / "net.onnx"), lambda picture: picture[:1]):
        with pytest.raises(ValueError, match="revision is of the hub"):
            Network(model, revision="v1")


def test_the_command_line(hub: SimpleNamespace, tmp_path: Path) -> None:
    (tmp_path / "photos").mkdir()
    for name in "ab":
        pixels = (255 * torch.rand(28, 42, 3)).byte().numpy()
        Image.fromarray(pixels).save(tmp_path / "photos" / f"{name}.png")

    def uwaug(*words: str, **environment: str) -> subprocess.CompletedProcess[str]:
        cache = {
            "HF_HUB_CACHE": str(tmp_path / "cache"),
            "HF_ENDPOINT": hub.url,
            "HF_HUB_OFFLINE": "0",
        }
        return subprocess.run(
            [
                sys.executable,
                "-c",
                "from uwaug.cli.app import main; main()",
                *words,
                "--workers",
                "1",
            ],
            cwd=tmp_path,
            env={**os.environ, **cache, **environment},
            capture_output=True,
            text=True,
            check=False,
        )

    # nothing is written where nothing can be fetched
    degrade = ("degrade", "photos", "--distance", "depth-anything", "--out")
    run = uwaug(*degrade, "wet", HF_HUB_OFFLINE="1")
    assert run.returncode == 1
    assert run.stderr.startswith(f"Error: {SMALL.repository}:{SMALL.file} could not be fetched, ")
    assert not (tmp_path / "wet").exists()
    run = uwaug("depth", "photos", "--out", "maps")
    assert run.returncode == 0, run.stderr
    assert "2 of 2 maps written" in run.stdout
    run = uwaug(*degrade, "wet", HF_HUB_OFFLINE="1")
    assert run.returncode == 0, run.stderr
    assert len(list((tmp_path / "wet").glob("*.png"))) == 2
