"""Where distances come from, of what is said of them."""

from pathlib import Path
from typing import Any

import pytest
from filing import metres, pixels, save

from uwaug import RandomUnderwater
from uwaug.distance import Inverse, MadeUp, Metres, Plane, Source
from uwaug.files.distances import are_maps, distances_of


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("01", "1:5", "made-up", "maps"):
        save(f"{name}/a.npy", metres())
    save("photos/a.png", pixels())


@pytest.mark.parametrize("said", [{"unit": "cm"}, {"holes": "far"}, {"source": {"planar": True}}])
def test_metres_have_nothing_that_is_of_maps(said: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=r"distance is 80 m for all of a picture: leave out unit"):
        distances_of("80", **said)


@pytest.mark.parametrize(
    "said", [{"unit": "cm"}, {"holes": "far"}, {"source": {"kind": "Inverse"}}]
)
def test_guesses_have_nothing_that_is_of_maps(
    said: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path / "photos")
    with pytest.raises(ValueError, match="made-up, guessed from pictures: leave out unit"):
        distances_of("made-up", **said)


@pytest.mark.parametrize(
    "distance, said, source, maps",
    [
        # nothing is said
        (None, {}, MadeUp(), None),
        (None, {"is_film": True}, Plane((1.0, 5.0)), None),
        # metres, or a word
        ("3", {}, Plane(3.0), None),
        ("2:5.5", {"is_film": True}, Plane((2.0, 5.5)), None),
        (None, {"has_maps": True, "is_film": True}, Metres(), None),
        ("made up", {}, Metres(), "made up"),
        # files, whatever they are called
        ("maps", {}, Metres(), "maps"),
        ("01", {}, Metres(), "01"),
        ("1:5", {}, Metres(), "1:5"),
        ("made-up", {}, Metres(), "made-up"),
        ("maps/a.npy", {"holes": "behind", "unit": "mm"}, Metres("behind"), "maps/a.npy"),
        ("{stem}_depth.png", {"holes": 9.0}, Metres(9.0), "{stem}_depth.png"),
        ("maps", {"source": {"kind": "Inverse"}}, Inverse(), "maps"),
        ("maps", {"source": {"kind": "Inverse"}, "holes": "far"}, Inverse(holes="far"), "maps"),
        ("maps", {"source": {"planar": True}, "holes": 2.0}, Metres(2.0, True), "maps"),
        # who speaks of them has maps
        (None, {"unit": "mm"}, Metres(), None),
        (None, {"holes": "fill"}, Metres("fill"), None),
        (None, {"source": 4.0}, Plane(4.0), None),
        (None, {"source": {"kind": "MadeUp", "far": 9.0}}, MadeUp(far=9.0), None),
    ],
)
def test_what_is_said_is_done(
    distance: str | None, said: dict[str, Any], source: Source, maps: str | None
) -> None:
    chosen, note = distances_of(distance, **said)
    assert RandomUnderwater.from_dict({"distance": chosen}).distance == source
    assert are_maps(distance) == (maps is not None)
    assert bool(note) == (distance is None and not said.keys() - {"is_film"})


@pytest.mark.parametrize("distance", ["3", "1:4", "depth-anything"])
def test_a_table_with_maps_takes_no_metres(distance: str) -> None:
    with pytest.raises(ValueError, match=f"distance is {distance}, but the table names maps"):
        distances_of(distance, has_maps=True)


def test_made_up_where_no_file_is_called_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path / "photos")
    chosen, note = distances_of("made-up", {"far": 9.0})
    assert RandomUnderwater.from_dict({"distance": chosen}).distance == MadeUp(far=9.0)
    assert (are_maps("made-up"), note) == (False, "")
