import re

import numpy as np
import pytest

from uwaug import JERLOV_TYPES, Water, load_camera, load_preset
from uwaug.presets.files import bundled_preset, list_presets


def test_list(run):
    code, out, err = run("preset", "list")
    assert (code, err) == (0, "")
    assert [line.split()[0] for line in out.splitlines()[1:]] == list_presets()
    row = r"^examples-4 +0.25–2 +2.5 +0.3–1.7 +arXiv:2509.15011, figure 7, row 4"
    assert re.search(row, out, re.MULTILINE)


@pytest.mark.parametrize("name", ["survey", "tank-adjusted-1"])
def test_what_is_shown_is_a_preset_itself(run, tmp_path, name):
    code, out, err = run("preset", "show", name)
    assert (code, err) == (0, "")
    assert out.startswith(bundled_preset(name).read_text(encoding="utf-8"))
    assert out.splitlines()[-1] == f"# It comes to {load_preset(name).medium}"
    own = tmp_path / "own.toml"
    own.write_text(out, encoding="utf-8")
    assert str(load_preset(own).medium) == str(load_preset(name).medium)
    assert run("preset", "show", str(own))[0] == 0


def test_copy_never_writes_over_a_file_unasked(run, tmp_path):
    own = tmp_path / "own.toml"
    code, out, err = run("preset", "copy", "survey", str(own))
    assert (code, err) == (0, "")
    assert out.startswith(f"{own}  (")
    assert "a copy of survey: edit it" in out
    assert own.read_bytes() == bundled_preset("survey").read_bytes()
    own.write_text("mine")
    code, out, err = run("preset", "copy", "survey", str(own))
    assert (code, out) == (2, "")
    assert err.startswith(f"Error: {own} exists: ")
    assert own.read_text() == "mine"
    assert run("preset", "copy", "calibrated", str(own), "--force")[0] == 0
    assert own.read_bytes() == bundled_preset("calibrated").read_bytes()
    assert [path.name for path in tmp_path.iterdir()] == ["own.toml"]


def test_waters(run):
    code, out, err = run("waters")
    assert (code, err) == (0, "")
    rows = {line.split()[1]: line for line in out.splitlines() if re.match(r"│ \w+ ", line)}
    assert list(rows) == list(JERLOV_TYPES)
    assert all(f" {Water.jerlov(t).visibility():.1f} " in row for t, row in rows.items())
    nm = np.arange(400, 701, 5)
    response = load_camera("Nikon 5100 (NPL)").at(nm)
    for type, row in rows.items():
        water = Water.jerlov(type)
        for spectrum in (water.a + water.b, water.kd):
            means = np.interp(nm, water.wavelengths, spectrum) @ response / response.sum(axis=0)
            assert "  ".join(f"{v:.3f}" for v in means) in row
    doubts = out[out.index("doubtful") :]
    assert "5C: a at 600–700 nm: Williamson & Hollins 2022 (misprinted" in doubts
    assert "Jerlov I: b at 300–700 nm: suspect" in doubts
    assert "9C" not in doubts
