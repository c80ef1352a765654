"""Damaged files of every format give a picture, or a reason that a person understands."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

pytest.importorskip("cv2")
pytest.importorskip("OpenEXR")

from benchmarks.accuracy import jobs_fuzz

EACH = 8
KINDS = jobs_fuzz.samples()


@pytest.fixture
def folder(tmp_path):
    Image.fromarray(jobs_fuzz.smooth(3, 255, np.uint8)).save(tmp_path / "good.png")
    np.save(tmp_path / "good.npy", jobs_fuzz.metres())
    return tmp_path


@pytest.mark.parametrize("kind", KINDS)
def test_damaged_files(folder: Path, kind: str) -> None:
    sample = KINDS[kind]
    sample.save(folder / sample.name)
    whole = (folder / sample.name).read_bytes()
    assert jobs_fuzz.attempt(sample, whole, folder)["status"] == "done"
    rng = np.random.default_rng(list(KINDS).index(kind))
    damaged = [jobs_fuzz.damaged(whole, rng) for _ in range(EACH)]
    found = [jobs_fuzz.attempt(sample, content, folder) for content in damaged]
    assert [one for one in found if one["wrong"]] == []
    assert {one["status"] for one in found} <= {"done", "failed"}


def test_what_is_no_sentence() -> None:
    for said in ("cannot identify <_io.BytesIO object>", "KeyError: 3", "b'IDAT'", "one\ntwo"):
        assert jobs_fuzz.UNCLEAR.search(said)
    assert not jobs_fuzz.UNCLEAR.search("a.png: is empty; expected 0…1, got 2 < 3")
