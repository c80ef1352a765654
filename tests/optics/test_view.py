"""One view: planar depth, blur, daylight, lamps and snow follow it, of a crop as of the whole."""

import math
from typing import Any

import pytest
import torch
from refusing import refusals
from scenes import rand

from uwaug import (
    Lamp,
    Light,
    MarineSnow,
    Medium,
    PointSpread,
    RandomUnderwater,
    RandomWater,
    Underwater,
    View,
    contrast_left,
    form_image,
)
from uwaug.distance import Metres, along_ray

SIZE, LEFT, TOP = (96, 160), 88, 30
WATER = {"vertical_depth": 5.0, "g": 0.05, "surfaces": "spectral"}
SHARP = Medium.from_water("3C", point_spread=PointSpread.none(), **WATER)
LAMP = Lamp((0.4, -0.3, 0.0), 3.0, (-0.1, 0.1, 1.0), cone=45.0)
VIEWS = {"degrees": View(75.0), "px": View(focal_px=90.0), "aside": View(60.0, None, (40.0, 70.0))}


def part(x: torch.Tensor) -> torch.Tensor:
    """Of 48x64 px, to the right of the middle."""
    return x[..., TOP : TOP + 48, LEFT : LEFT + 64]


@pytest.mark.parametrize("name", VIEWS)
@pytest.mark.parametrize("light", [Light(pitch=12.0), Light((LAMP,), daylight=0.3, pitch=-20.0)])
def test_a_crop_is_a_part_of_the_whole(light: Light, name: str) -> None:
    image, z, view = rand(1, 3, *SIZE), 1 + 4 * rand(1, 1, *SIZE, seed=1), VIEWS[name]
    whole = form_image(image, z, SHARP, light=light, view=view).image
    options: dict[str, Any] = {"light": light, "view": view.crop(SIZE, LEFT, TOP)}
    crop = form_image(part(image), part(z), SHARP, **options).image
    torch.testing.assert_close(crop, part(whole), rtol=1e-9, atol=1e-12)
    left, all_left = (
        contrast_left(distance, SHARP, light=light, view=seen)
        for distance, seen in ((part(z), options["view"]), (z, view))
    )
    torch.testing.assert_close(left, part(all_left), rtol=1e-9, atol=1e-12)


def test_a_crop_has_the_blur_of_the_whole() -> None:
    medium = Medium.from_water("3C", point_spread=PointSpread.calibrated(), **WATER)
    for view in VIEWS.values():
        whole = medium.in_pixels(SIZE, view)
        crop = medium.in_pixels((48, 64), view.crop(SIZE, LEFT, TOP))
        torch.testing.assert_close(crop.scale, whole.scale)
        double = medium.in_pixels((192, 320), view.resized(2.0))
        torch.testing.assert_close(double.scale, 2 * whole.scale)


def test_a_crop_has_the_planar_depth_of_the_whole() -> None:
    image, depth, view = rand(3, *SIZE).float(), 1 + 4 * rand(1, *SIZE).float(), View(focal_px=90.0)

    def metres(x: torch.Tensor, z: torch.Tensor, seen: View) -> torch.Tensor:
        water = RandomWater(SHARP, field=None)
        augment = RandomUnderwater(water, distance=Metres(planar=True), view=seen)
        return augment.scenes(x, z, augment.make_params(x)).metres[0]

    whole = metres(image, depth, view)
    torch.testing.assert_close(whole, along_ray(depth, 90.0))
    cropped = metres(part(image), part(depth), view.crop(SIZE, LEFT, TOP))
    torch.testing.assert_close(cropped, part(whole))


def test_snow_is_as_dense_in_a_crop() -> None:
    seen = []
    for view, height, width in ((View(), 96, 160), (View().crop(SIZE, 120, 66), 30, 40)):
        image, z, total = torch.zeros(3, height, width), torch.full((1, height, width), 20.0), 0.0
        for seed in range(12):
            snowy = Medium.from_water("I").with_snow(MarineSnow(2e4, seed=seed))
            clear, white = (
                Underwater(medium, None, color_space="linear", view=view)(image, z)
                for medium in (snowy.with_snow(None), snowy)
            )
            total += float((white - clear).mean())
        seen.append(total)
    assert seen[1] == pytest.approx(seen[0], rel=0.25)


def planar(view: View) -> None:
    augment = RandomUnderwater("II", distance=Metres(planar=True), view=view)
    augment(rand(3, *SIZE).float(), torch.ones(1, *SIZE))


test_what_is_refused = refusals(
    (lambda: View(180.0), r"view: degrees must be in \[1, 170\], got 180"),
    (lambda: View(focal_px=0.0), "view: focal_px must be finite and > 0"),
    (lambda: View(60, 410.0), "say the same, got both"),
    (lambda: View(center=3.0), "view: center must be"),
    (lambda: View(center=(math.nan, 3.0)), "view: center must be finite"),
    (lambda: RandomUnderwater(view="wide"), r"view must be a uwaug\.View, got str"),
    # of a lens, in millimetres
    (planar, View(focal_px=2.8), "focal_px must be in px of the picture, .* got 2.8"),
)


def test_degrees_and_px_are_one() -> None:
    focal = 80 / math.tan(math.radians(35))
    assert View(70.0).focal(160) == pytest.approx(focal)
    assert View(focal_px=focal).middle(SIZE) == (79.5, 47.5)
    assert View(None, focal, (79.5, 47.5)).resized(0.5) == View(None, focal / 2, (39.5, 23.5))
    assert RandomUnderwater(view=70).view == Underwater(SHARP, view=70.0).view == View(70.0)


def test_planar_depth_needs_a_view_that_is_named() -> None:
    image, depth = rand(3, *SIZE).float(), torch.full((1, *SIZE), 3.0)
    for view in (60.0, View(80.0), View(focal_px=90.0)):
        aug = RandomUnderwater("II", distance=Metres(planar=True), view=view)
        again = RandomUnderwater.from_dict(aug.to_dict())  # 60° that are named stay so
        record = aug.make_params(image)
        metres = again.scenes(image, depth, record).metres
        focal = View.of(view).focal(SIZE[1])
        far = 3 * math.hypot(1, (SIZE[1] - 1) / 2 / focal, (SIZE[0] - 1) / 2 / focal)
        assert float(metres[..., 0, 0]) == pytest.approx(far, rel=1e-5)
    with pytest.raises(ValueError, match="planar maps need the camera's view: give view="):
        RandomUnderwater("II", distance=Metres(planar=True))(image, depth)


def test_a_view_in_px_plans_for_sizes_that_no_picture_has() -> None:
    view = View(focal_px=525)
    law = PointSpread.calibrated()
    degrade = Underwater(Medium.from_water("3C", g=1.0, point_spread=law), view=view)
    image, z = rand(1, 3, 24, 32).float(), 1 + rand(1, 1, 24, 32).float()
    assert degrade(image, z).isfinite().all()
    medium = Medium.from_water("3C", g=0.05, point_spread=law)
    assert Underwater(medium, view=view, sides=(32, 2160)).plan((400, 600)) is not None
    assert "View" in repr(Underwater(medium, view=View(focal_px=50)))
