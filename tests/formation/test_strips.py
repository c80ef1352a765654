"""Large pictures, in strips, are what small ones are in one piece."""

import math
from typing import Any

import pytest
import torch
from torch import Tensor

import uwaug
import uwaug._support.tiles
import uwaug.blur.tiled
import uwaug.formation.loops.render
import uwaug.formation.scene
from uwaug import Light, PointSpread, RandomUnderwater, Underwater, fused
from uwaug._support.tiles import RowSource, rows_of
from uwaug.blur.plan import plan_blur
from uwaug.blur.stack import blurred
from uwaug.blur.tiled import blurred_tiles
from uwaug.distance.complete import filled, filled_rows
from uwaug.formation.colour import srgb_to_linear
from uwaug.formation.field import gaussian_random_field, gaussian_random_rows
from uwaug.formation.loops import backend
from uwaug.transforms.random_underwater import HAZY

pytestmark = pytest.mark.filterwarnings("ignore:distance is unknown")

OPTIONS: dict[str, dict[str, Any]] = {
    "default": {},
    "no field": {"field_probability": 0.0},
    "gaussian": {"point_spread": PointSpread(6.0, 1.0)},
    "narrow": {"point_spread": PointSpread(0.4, 1.0)},
    "wide": {"blur_factor": 20.0},
    "fine": {"tolerance": 2e-4},
    "no blur": {"point_spread": PointSpread.none()},
    "the paper's size": {"point_spread": PointSpread.paper(2.0)},
    "light": {"order": "source", "color_space": "linear"},
    "stops": {"exposure": (-1.0, 2.0)},
    "fill": {"unknown": "fill"},
    "far": {"unknown": "far"},
    "relative": {"distance_kind": "relative", "far": 6.0},
    "inverse": {"distance_kind": "inverse"},
    # not developed, which makes more of the rounding of coarse grids
    "plane": {**HAZY, "waters": ["7C", "II"], "distance": 3.0},
}


def picture(height: int, width: int) -> Tensor:
    """Smooth shapes under noise, 0…1."""
    generator = torch.Generator().manual_seed(5)
    coarse = torch.rand(1, 3, 9, 11, generator=generator)
    smooth = torch.nn.functional.interpolate(coarse, size=(height, width), mode="bilinear")
    return 0.8 * smooth[0] + 0.2 * torch.rand(3, height, width, generator=generator)


def distances(name: str, height: int, width: int) -> Tensor | None:
    if name == "plane":
        return None
    down = torch.linspace(0.02, 1, height)[:, None]
    z = (down * (1 + 0.3 * torch.linspace(-1, 1, width).cos()) / 1.3)[None]
    if name in ("relative", "inverse"):
        return z
    z = 7 * z
    if name in ("fill", "far"):
        z[:, 20:60, 30:90] = 0
        z[:, ::17, ::13] = math.nan
    else:
        z[:, -9:] = math.inf
    return z


@pytest.fixture
def in_strips(monkeypatch: pytest.MonkeyPatch) -> Any:
    """What makes every picture a large one, in bands of some tens of rows."""

    def switch() -> None:
        monkeypatch.setattr(uwaug._support.tiles, "LARGE", 1)
        monkeypatch.setattr(uwaug._support.tiles, "_BAND", 20_000)
        monkeypatch.setattr(uwaug.blur.tiled, "_STRIP", 20_000)
        monkeypatch.setattr(uwaug.formation.loops.render, "_BAND", 20_000)

    return switch


@pytest.mark.parametrize("engine", ["eager", "fused-rows"])
@pytest.mark.parametrize("name", OPTIONS)
def test_strips_are_the_whole(name: str, engine: str, in_strips: Any) -> None:
    aug, size = RandomUnderwater(**{"waters": ["7C", "II"], **OPTIONS[name]}), (331, 257)
    image, z = picture(*size), distances(name, *size)
    levels = (255 * image).round().byte()
    record = aug.make_params(image, torch.Generator().manual_seed(3))
    sample = record["samples"][0]
    if engine == "fused-rows" and sample["path"] == "eager":
        pytest.skip("needs numba, and the line of sight")
    sample["path"] = engine.removesuffix("-rows")
    whole = [aug.transform(one, z, record) for one in (image, levels)]
    used = aug.resolve(image, z, record)["samples"][0]["used"]
    in_strips()
    sample["path"] = engine
    assert aug.resolve(image, z, record)["samples"][0]["path"] == engine
    out = [aug.transform(one, z, record) for one in (image, levels)]
    if engine == "fused-rows" and name == "plane":
        assert torch.equal(out[1], whole[1])
    assert aug.resolve(image, z, record)["samples"][0]["used"] == pytest.approx(used, rel=1e-5)
    light = [one if name == "light" else srgb_to_linear(one) for one in (out[0], whole[0])]
    torch.testing.assert_close(*light, rtol=0, atol=1e-5)
    apart = (out[1].int() - whole[1].int()).abs()
    assert apart.max() <= 1
    # where rounding falls the other way
    assert (apart > 0).float().mean() < 1e-3
    assert out[1].dtype == torch.uint8


LIGHTS = {
    "lamp": Light.lamp((0.4, -0.2, 0.0), (-0.1, 0.0, 1.0), 4.0, 40.0),
    "lamp in view": Light.lamp((0.2, 0.1, 1.5), (0.0, 0.0, 1.0), power=0.5, cone=180.0),
    "sun": Light.parallel(40.0, 120.0, gradient=0.5)
    + Light.lamp((-0.3, 0.0, 0.0), (0.1, 0.0, 1.0), 2.0),
}


def formed(aug: RandomUnderwater, image: Tensor, z: Tensor, record: Any) -> tuple[Tensor, Tensor]:
    """A picture in its water, and the contrast that is left."""
    look = lambda wet: (wet.scene.picture(), wet.scene.contrast())  # noqa: E731
    return aug.in_water(image, z, record, look)[0]


@pytest.mark.parametrize("name", LIGHTS)
@pytest.mark.parametrize("exposure", ["none", "auto"])
def test_large_pictures_have_lamps(name: str, exposure: Any, in_strips: Any) -> None:
    aug, size = RandomUnderwater("3C", light=LIGHTS[name], exposure=exposure), (331, 257)
    image, z = picture(*size), distances("default", *size)
    record = aug.make_params(image, torch.Generator().manual_seed(3))
    whole = aug.transform(image, z, record)
    _, left = formed(aug, image, z, record)
    used = aug.resolve(image, z, record)["samples"][0]["used"]
    in_strips()
    out, near = formed(aug, image, z, record)
    # the veil of a lamp lies on a grid of rays of each band, which is finer
    torch.testing.assert_close(*map(srgb_to_linear, (out, whole)), rtol=0, atol=2e-3)
    # in the dark, contrast is a quotient of hardly anything
    seen = srgb_to_linear(whole).amin(0, keepdim=True) > 1e-2
    torch.testing.assert_close(near[seen], left[seen], rtol=0, atol=2e-3)
    assert aug.resolve(image, z, record)["samples"][0]["used"] == pytest.approx(used, rel=1e-3)


def test_large_pictures_go_by_the_loops(in_strips: Any) -> None:
    if fused.path() == "eager":
        pytest.skip("needs numba")
    aug, size = RandomUnderwater("7C"), (331, 257)
    image, z = picture(*size), distances("default", *size)
    older = aug.make_params(image, torch.Generator().manual_seed(3))
    assert older["samples"][0]["path"] == "fused"
    in_strips()
    (sample,) = aug.make_params(image, torch.Generator().manual_seed(3))["samples"]
    assert sample["path"] == "fused-rows"
    # what older versions called fused was made by PyTorch
    by_tiles = {"samples": [{**sample, "path": "eager"}]}
    replayed = aug.transform(image, z, older)
    torch.testing.assert_close(replayed, aug.transform(image, z, by_tiles), rtol=0, atol=0)
    assert not torch.equal(replayed, aug.transform(image, z, {"samples": [sample]}))
    module = Underwater(uwaug.Medium.from_water("7C"))
    large = module(image, z)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(uwaug._support.tiles, "LARGE", 10**9)
        assert torch.equal(large, module(image, z))


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16, torch.float64])
def test_types(dtype: torch.dtype, in_strips: Any) -> None:
    aug, image, z = RandomUnderwater("7C"), 1.7 * picture(90, 70), distances("", 90, 70)
    record = aug.make_params(image)
    image = image.to(dtype).transpose(1, 2).contiguous().transpose(1, 2)
    whole = aug.transform(image, z, record)
    in_strips()
    out = aug.transform(image, z, record)
    assert out.dtype == dtype
    assert out.max() > 1  # as bright as what was given
    torch.testing.assert_close(out, whole, rtol=0, atol=2 * torch.finfo(dtype).eps + 1e-5)


def test_refusals_are_the_same(in_strips: Any) -> None:
    image, z = picture(90, 70), distances("fill", 90, 70)
    bright, broken = 255 * image, image.masked_fill(image < 0.3, math.nan)
    cases = [(image, z), (image, 3000 * z.nan_to_num(1)), (bright, z + 1), (broken, z + 1)]
    said = []
    for _ in range(2):
        for one, distance in cases:
            with pytest.raises(ValueError) as error:
                RandomUnderwater("7C")(one, distance)
            said.append(str(error.value))
        in_strips()
    assert said[:4] == said[4:]


@pytest.mark.parametrize("size", [(333, 130), (97, 412), (16, 16), (1, 50), (50, 1)])
@pytest.mark.parametrize("widths", [(1.0, 6.0, "gaussian"), (0.0, 200.0, "exponential")])
def test_blurs_in_bands(
    size: tuple[int, int], widths: tuple[float, float, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    image = picture(*size)
    low, high, shape = widths
    plan = plan_blur(low, high, 0.002, shape, max(size))
    whole = blurred(image[None], plan)
    for band in (None, 16, 112):
        source: Tensor | RowSource = image[None]
        if band is not None:
            monkeypatch.setattr(uwaug._support.tiles, "_BAND", band * size[1])
            source = RowSource(rows_of(image), (3, *size), image)
        out = [torch.full_like(blur, math.nan) for blur in whole]
        for tile, blurs in blurred_tiles(source, plan):
            for one, part in zip(out, blurs, strict=True):
                one[tile] = part
        for one, other in zip(out, whole, strict=True):
            torch.testing.assert_close(one, other, rtol=0, atol=2e-6)


def test_light_is_asked_for_in_bands(in_strips: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []
    if fused.path() == "fused":
        assert backend.ready()  # what they are proved with is no part of it
    decode = uwaug.formation.scene._decoded
    monkeypatch.setattr(
        uwaug.formation.scene, "_decoded", lambda *a: asked.append(a[0].shape[1]) or decode(*a)
    )
    in_strips()
    law = PointSpread(4.0, 0.6, "exponential")
    aug = RandomUnderwater("7C", point_spread=law, exposure="none")
    with fused.use(False):
        aug(picture(900, 64), distances("", 900, 64))
    # a band, and what blurs on the finest grids reach beyond it
    assert max(asked) <= 20_000 // 64 + 2 * 60
    assert sum(asked) < 4.5 * 900
    if fused.path() == "fused":
        asked.clear()
        aug(picture(900, 64), distances("", 900, 64))
        # the loops keep rows that they need again
        assert max(asked) <= 20_000 // 64 + 2 * 60
        assert sum(asked) == 2 * 900, "once for the coarsest grids, once for the bands"


def test_fields_in_rows() -> None:
    size = (123, 77)
    for low, high in ((0.7, 1.3), (1.2, 1.2)):
        options = {"low": low, "high": high}
        generator = torch.Generator().manual_seed(2)
        whole = gaussian_random_field(size, **options, generator=generator, dtype=torch.float32)
        rows = gaussian_random_rows(size, **options, generator=torch.Generator().manual_seed(2))
        parts = [rows(start, min(start + 50, 123)) for start in (0, 50, 100)]
        torch.testing.assert_close(torch.cat(parts, 1), whole[0], rtol=0, atol=1e-6)


@pytest.mark.parametrize("wide", [False, True])
def test_holes_are_filled_in_rows(wide: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    generator = torch.Generator().manual_seed(1)
    for height, width in ((133, 61), (97, 40), (3, 5)):
        z = 1 + torch.rand(1, height, width, generator=generator)
        z[:, :, width // 2 :] += 4
        z[:, height // 2, : width // 4] = math.inf
        z[torch.rand(z.shape, generator=generator) < 0.1] = math.nan
        if wide:
            z[:, height // 5 : -(height // 4), 3:-4] = 0
        whole = filled(z, ~(z > 0))
        for rows in (10, 26):
            monkeypatch.setattr(uwaug._support.tiles, "_BAND", rows * width)
            found = filled_rows(rows_of(z), (height, width))
            torch.testing.assert_close(found(0, height), whole, rtol=1e-5, atol=0)
            middle = slice(height // 3, height // 2)
            part = found(middle.start, middle.stop)
            torch.testing.assert_close(part, whole[:, middle], rtol=1e-5, atol=0)
