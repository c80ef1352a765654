"""Charts in a water that is known."""

import csv

import cv2
import numpy as np
import pytest
import torch

from benchmarks.evidence.restore import Net, linear, restorer
from benchmarks.water import restore, waters
from benchmarks.water.patches import GREYS, Patches, fitted
from uwaug import Medium

RATES, VEIL = np.array([0.3, 0.2, 0.25]), np.array([0.02, 0.05, 0.06])
GAINS = {"near": np.array([2.0, 3.0, 4.0]), "far": np.array([1.0, 5.0, 2.0])}
EXPOSURES = {"near": GAINS["near"], "far": 0.6 * GAINS["near"]}  # of one white balance
WOBBLE = 1 + 0.002 * np.sin(np.arange(15)).reshape(5, 3)  # noise, alike in all charts
REFLECTANCES = np.array([0.24, 0.18, 0.12, 0.08, 0.03])[:, None].repeat(3, 1)


def charts(water: restore.Water, gains=GAINS) -> Patches:
    """Greys of five charts in two pictures."""
    parts = []
    for picture, metres in (
        ("near", 1.5),
        ("near", 3.0),
        ("near", 6.0),
        ("far", 5.0),
        ("far", 9.0),
    ):
        z = np.full(5, metres)
        arriving, veil = water(z)
        wet = gains[picture] * (arriving * REFLECTANCES + veil) * WOBBLE
        names = np.array([picture] * 5), np.array([f"{picture} {metres}"] * 5), np.array(GREYS)
        parts.append((*names, z, wet, REFLECTANCES, wet, REFLECTANCES))
    return Patches(*map(np.concatenate, zip(*parts, strict=True)), np.eye(3))


def haze(z):
    """A rate a colour."""
    return np.exp(-RATES * z[:, None]), VEIL * -np.expm1(-RATES * z[:, None])


def test_contrasts_tell_rates_whatever_the_veil():
    patches = charts(lambda z: (haze(z)[0], np.sqrt(z)[:, None] * VEIL))
    squares, rates, covariance = waters.contrasts_of(patches).explained()
    assert rates == pytest.approx(RATES, abs=0.01)
    assert squares < 1
    assert (np.diag(covariance) > 0).all()


def test_a_type_as_it_is_explains_its_own_charts_best(monkeypatch):
    monkeypatch.setattr(waters, "CONTENTS", np.array([0.5, 2.0]))
    medium = Medium.from_water("IB", vertical_depth=6.0, tolerance=0)
    patches = charts(restore.of_medium(medium))
    table = waters.types(waters.contrasts_of(patches), waters.CAMERAS[0])
    assert min(table, key=lambda name: table[name]["direct"]) == "IB"
    assert table["IB"]["direct"] < table["IB"]["direct, scaled"] + 1e-9


def test_haze_is_found_and_undone():
    patches = charts(haze, EXPOSURES)
    medium = fitted(patches).medium
    assert medium.G[0].tolist() == pytest.approx(RATES, rel=0.03)
    near = patches.of(patches.pictures == "near")
    assert restore.dry(near, restore.of_medium(medium)) == pytest.approx(near.truth, rel=0.05)
    assert restore.dry(near, restore.nothing) != pytest.approx(near.truth, rel=0.2)


@pytest.mark.parametrize("inverts", [False, True])
def test_a_kept_net_restores_as_before(tmp_path, inverts):
    torch.manual_seed(0)
    net = Net(inverts)
    net(torch.rand(4, 3, 32, 32))  # means of layers, which must be kept, too
    torch.save(net.state_dict(), tmp_path / "arm, 0.net")
    picture = torch.randint(256, (32, 48, 3), dtype=torch.uint8).numpy()
    encoded = net.eval()(torch.from_numpy(picture / 255).float().permute(2, 0, 1)[None])[0]
    expected = linear(encoded[0].permute(1, 2, 0).clamp(0, 1).detach().numpy())
    assert restorer(tmp_path / "arm, 0.net")(picture) == pytest.approx(expected, abs=1e-5)


def test_nets_answer_for_each_patch_where_it_stands(tmp_path):
    patches = charts(haze)
    folder = tmp_path / "charts"
    (folder / "pictures").mkdir(parents=True)
    light = np.random.default_rng(0).uniform(0.1, 0.9, patches.wet.shape)
    pictures = {name: np.full((64, 92, 3), 0.5) for name in GAINS}
    rows = []
    for i, (name, chart) in enumerate(zip(patches.pictures, patches.charts, strict=True)):
        x, y = 3 * i, i  # px, of a picture that is 80 times smaller
        pictures[name][y : y + 2, x : x + 3] = light[i]
        row = {"scene": name, "chart": chart.split()[1], "patch": patches.names[i]}
        rows.append(row | {"x0": 80 * x, "x1": 80 * (x + 3), "y0": 80 * y, "y1": 80 * (y + 2)})
    with (folder / "patches.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, rows[0])
        writer.writeheader()
        writer.writerows(reversed(rows))
    for name, picture in pictures.items():
        levels = np.round(65535 * picture[..., ::-1]).astype(np.uint16)
        cv2.imwrite(str(folder / f"pictures/{name}_lin16.png"), levels)
    net = Net(inverts=False)
    torch.nn.init.zeros_(net.last.weight)
    for name, more in {"same, 0": 0.0, "same, 1": 0.0, "brighter, 0": 0.05}.items():
        torch.nn.init.constant_(net.last.bias, more)
        torch.save(net.state_dict(), tmp_path / f"{name}.net")
    answers = restore.by_nets(tmp_path, patches, tmp_path)
    assert answers["net: same"] == pytest.approx(np.stack([light, light]), abs=0.005)
    assert (answers["net: brighter"] > light + 0.005).all()
