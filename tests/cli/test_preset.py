import re

import pytest

from uwaug import load_preset
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
    assert out.startswith(f"{own}  (a copy of survey")
    assert own.read_bytes() == bundled_preset("survey").read_bytes()
    own.write_text("mine")
    code, out, err = run("preset", "copy", "survey", str(own))
    cure = "choose another file, or --force to write over it"
    assert (code, out, err) == (2, "", f"Error: {own} exists: {cure}\n")
    assert own.read_text() == "mine"
    assert run("preset", "copy", "calibrated", str(own), "--force")[0] == 0
    assert own.read_bytes() == bundled_preset("calibrated").read_bytes()
    assert [path.name for path in tmp_path.iterdir()] == ["own.toml"]


@pytest.mark.parametrize(
    ("code", "arguments", "message"),
    [
        (2, "show no", "no preset is called 'no'; there are akkaynak-2018, calibrated"),
        (2, "copy no a.toml", "no preset is called 'no'; there are akkaynak-2018, calibrated"),
        (2, "copy bad.toml a.toml", "no preset is called 'bad.toml'"),
        (2, "copy survey a.txt", "expected a name that ends in .toml"),
        (1, "copy survey missing/a.toml", "there is no folder missing"),
        (1, "copy survey folder.toml --force", "is a folder"),
        (1, "show missing.toml", "No such file"),
        (1, "show bad.toml", "bad.toml: not a TOML file"),
    ],
)
def test_wrong_use(run, tmp_path, monkeypatch, code, arguments, message):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "bad.toml").write_text("no [toml")
    (tmp_path / "folder.toml").mkdir()
    got, out, err = run("preset", *arguments.split())
    assert (got, out) == (code, "")
    assert err.startswith("Error: ")
    assert message in err
    assert err.count("\n") == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["bad.toml", "folder.toml"]
