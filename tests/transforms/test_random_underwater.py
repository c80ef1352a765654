"""What holds for `RandomUnderwater`, whatever its options are."""

import copy
import json
import math
import pickle
from collections.abc import Callable
from dataclasses import replace
from functools import partial, reduce
from itertools import product
from typing import Any

import pytest
import torch
from augmenting import (
    COAST,
    EVERYTHING,
    FIT,
    OPTIONS,
    RAW,
    TANK,
    H,
    W,
    distances,
    flat,
    leaves,
    picture,
    result,
    same,
)
from torch import Tensor

import uwaug
from uwaug import Lamp, Light, RandomDevelopment, RandomLight, RandomUnderwater, RandomWater, Sensor
from uwaug._support import checks
from uwaug.distance import Inverse, MadeUp, Metres, Network, Plane, Relative
from uwaug.formation.colour import LUMINANCE
from uwaug.formation.contrast import metres_for
from uwaug.transforms.conditions import Conditions
from uwaug.transforms.random_underwater import SEVERITIES
from uwaug.transforms.random_water import VISIBLE, WATERS

LIT = Light((Lamp((0.4, 0.0, 0.0)),), 0.3)
PLAIN: dict[str, Any] = {**RandomWater.PLAIN, "point_spread": uwaug.PointSpread.paper()}


def seeded(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def wall(metres: float, *batch: int) -> Tensor:
    return torch.full((*batch, 1, H, W), metres)


def fixed(development: Any = RAW, light: Any = None, **water: Any) -> RandomUnderwater:
    """A transform of which nothing is random but what is said."""
    noun = RandomWater(**{"waters": "3C", **PLAIN, **water})
    return RandomUnderwater(noun, light=light, development=development)


@pytest.mark.parametrize("name", OPTIONS)
def test_a_record_makes_the_picture_again(name: str) -> None:
    """By the transform and by its twins: in another process, copied, of plain data."""
    aug = RandomUnderwater(**OPTIONS[name])
    twins = [aug, pickle.loads(pickle.dumps(aug)), copy.deepcopy(aug)]
    if name == "network":
        with pytest.raises(TypeError, match="cannot be written as numbers and words"):
            aug.to_dict()
    else:
        twins.append(RandomUnderwater.from_dict(json.loads(json.dumps(aug.to_dict()))))
        assert all(twin.to_dict() == aug.to_dict() for twin in twins)
    image, *rest = leaves(aug, 3)
    torch.manual_seed(5)
    record = aug.make_params(image)
    torch.manual_seed(5)
    drawn = aug(image, *rest)
    made = drawn[0] if rest else drawn
    assert made.isfinite().all()
    read = json.loads(json.dumps(record, allow_nan=False))
    assert read == record
    for twin in twins:
        assert same(made, twin.transform(image, rest[0] if rest else None, read))


def test_a_water_is_said_in_many_ways() -> None:
    said = [RandomWater("3C"), RandomWater(["3c"]), uwaug.Water.jerlov("3C")]
    tables = ["3C", ["3C"], {"waters": "3C"}, {"kind": "RandomWater", "waters": ["3C"]}]
    expected = result(RandomUnderwater(water="3C"))
    made = [RandomUnderwater(water) for water in said]
    made += [RandomUnderwater.from_dict({"water": table}) for table in tables]
    assert all(same(result(aug), expected) for aug in made)
    aug = RandomUnderwater.from_dict(
        {
            "water": {"waters": ["II", "chlorophyll=1:20,cdom=.1:2,minerals=.5"],
                      "contrast": "none", "point_spread": {"scale": 3.0}},
            "development": {"exposure": [-1, 0]},
            "distance": {"kind": "Relative", "far": [4, 8]},
        }
    )  # fmt: skip
    assert aug.development == RandomDevelopment(exposure=(-1, 0))
    assert aug.distance == Relative(far=(4, 8))
    assert (aug.water.contrast, aug.water.point_spread) == (None, uwaug.PointSpread(3.0))
    assert list(aug.water.by_name.values())[1] == COAST


def test_draws_fill_their_ranges() -> None:
    water = RandomWater([COAST, "II", "II"], **EVERYTHING)
    aug = RandomUnderwater(water, p=0.5, distance=Relative(1, (3, 9)), conditions=None)
    samples = aug.make_params(torch.empty(2000, 3, 1, 1), seeded())["samples"]
    assert sum(sample["applied"] for sample in samples) / 2000 == pytest.approx(0.5, abs=0.04)
    ranges = {f"water.{name}": ends for name, ends in EVERYTHING.items()}
    ranges |= {"distance.far": (3, 9), "development.gamut": RandomDevelopment().gamut}
    for name, (low, high) in ranges.items():
        drawn = torch.tensor([flat(sample)[name] for sample in samples])
        assert low <= drawn.min() <= drawn.max() <= high
        middle = math.sqrt(low * high) if name == "water.contrast" else (low + high) / 2
        assert float(drawn.median()) == pytest.approx(middle, abs=0.04 * (high - low))
    waters = [water for sample in samples for water in sample["water"]["waters"]]
    assert waters.count("II") / len(waters) == pytest.approx(2 / 3, abs=0.03)
    amounts = [water for water in waters if water != "II"]
    assert all(COAST.holds(each) for each in amounts)
    assert len({each["cdom"] for each in amounts}) > 1000


def test_fixed_options_are_an_underwater() -> None:
    """The same picture by the module, of the water that the transform says it takes."""
    aug = fixed(vertical_depth=2.0, contrast=0.4)
    image, z = picture().double(), 2 + distances().double()
    # of the waters that leave .4 at the median distance, this one
    scaled = uwaug.Water.jerlov("3C").with_contrast(0.4, float(z.median()))
    law = PLAIN["point_spread"]
    medium = uwaug.Medium.from_water(scaled, vertical_depth=2.0, g=0.2, point_spread=law)
    assert (aug(image, z)[0] - uwaug.Underwater(medium, (2.0, 3.0))(image, z)).abs().max() < 2e-3
    shares = aug.contrast_left(image, z, aug.make_params(picture()))
    assert (shares - uwaug.contrast_left(z, medium)).abs().max() < 5e-3


def test_no_veil_that_is_drawn_is_brighter_than_a_white_plate() -> None:
    def veil(**options: Any) -> Tensor:
        aug = RandomUnderwater(RandomWater("II", **options))
        record = aug.make_params(picture(), seeded())
        (drawn,) = aug.scenes(picture(), 1 + distances(), record).scenes
        return drawn.setting.medium.curves(torch.tensor([[[[1e4]]]])).veil

    held, highest, asked = (veil(g=0.02, mu=mu) for mu in ((0.03, 0.04), 0.02, 0.03))
    torch.testing.assert_close(held, highest)
    torch.testing.assert_close(asked, 1.5 * highest, rtol=1e-3, atol=0)


def test_a_field_is_drawn_for_each_picture() -> None:
    water = RandomWater("II", field=(0.2, 3.0), vertical_depth=1.0)
    aug = RandomUnderwater(water, light=None)
    params = aug.make_params(picture())
    left = aug.contrast_left(picture(), wall(3.0), params)
    medium = aug.scenes(picture(), wall(3.0), params).scenes[0].setting.medium
    ends = uwaug.contrast_left(torch.tensor([[[9.0, 0.6]]]), medium).flatten()
    torch.testing.assert_close(torch.stack(left.aminmax()), ends, rtol=0.02, atol=0)


def test_scenes_are_no_deeper_than_a_meter_makes_up_for_unless_lamps_shine() -> None:
    image, z = scene = picture(), 1 + distances()
    water, lamps = RandomWater("9C", vertical_depth=100.0), Light((Lamp((0.3, -0.2, 0.0), 4.0),))
    for light, metered, mean, metres in (
        (None, True, (0.1, 1), (1, 20)),
        (None, False, (0, 1e-3), (100, 100)),
        (lamps, True, (0.1, 1), (100, 100)),
        (lamps, False, (0.02, 1), (100, 100)),
    ):
        development = RandomDevelopment() if metered else RAW
        aug = RandomUnderwater(water, light=light, development=development)
        record = aug.make_params(image)
        assert record["samples"][0]["water"]["vertical_depth"] == 100
        assert mean[0] <= aug(*scene)[0].mean() <= mean[1]
        assert metres[0] <= aug.scenes(image, z, record).truth().vertical_depth <= metres[1]


@pytest.mark.parametrize("kind, light", [("srgb", None), ("linear", LIT)])
def test_gradients_pass_to_image_and_distance(kind: Any, light: Light | None) -> None:
    # a blur is planned for the distances and the exposure at hand, which are not followed
    water = RandomWater(["II", "5C"], point_spread=uwaug.PointSpread.none())
    development = RandomDevelopment(color_space=kind, noise=None)
    aug = RandomUnderwater(water, development=development, light=light)
    image = (0.2 + 0.6 * torch.rand(3, 3, 5, dtype=torch.float64)).requires_grad_()
    z = (1 + torch.rand(1, 3, 5, dtype=torch.float64)).requires_grad_()
    record = aug.make_params(image, seeded(3))
    assert torch.autograd.gradcheck(
        lambda image, z: aug.transform(image, z, record), (image, z), atol=1e-5, rtol=1e-3
    )


ROUNDING = {torch.uint8: 0.51 / 255, torch.float16: 6e-4, torch.bfloat16: 5e-3, torch.float32: 1e-4}


@pytest.mark.parametrize("dtype", ROUNDING)
def test_types(dtype: torch.dtype) -> None:
    aug = RandomUnderwater(distance=3.0)
    for batch in (None, 2):
        image, white = picture(batch, dtype), 255 if dtype == torch.uint8 else 1
        record = aug.make_params(image)
        out = aug.transform(image, None, record)
        assert (out.dtype, out.shape) == (dtype, image.shape)
        exact = aug.transform(image.double() / white, None, record)
        assert (out.double() / white - exact).abs().max() <= ROUNDING[dtype]


def test_torch_compile_breaks_the_graph_and_draws_the_same() -> None:
    torch.compiler.reset()
    torch._dynamo.utils.counters.clear()
    augment, layer = RandomUnderwater(), torch.nn.Conv2d(3, 4, 3)

    def classified(image: Tensor, distance: Tensor) -> Tensor:
        result: Tensor = layer(augment(2 * image - image, distance)[0])
        return result

    compiled = torch.compile(classified, backend="eager")
    for seed in range(2):
        results = []
        for either in (classified, compiled):
            torch.manual_seed(seed)
            results.append(either(picture(2), distances(2) + 1))
        assert same(*results)
    # before and behind the transform
    assert torch._dynamo.utils.counters["stats"]["unique_graphs"] == 2


# ---- how clear, and how large


@pytest.mark.filterwarnings("ignore:.*if distances are metres")
@pytest.mark.parametrize("light", [None, LIT])
@pytest.mark.parametrize("water", ["9C", RandomWater(contrast=0.3), FIT, None], ids=str)
def test_distances_are_those_of_the_map_in_any_water(water: Any, light: Light | None) -> None:
    noun = water if isinstance(water, RandomWater) else RandomWater(water)
    for aug in (RandomUnderwater(noun, light=light), RandomUnderwater.severity(5, noun)):
        for times in (0.5, 40.0):
            z, record = times * (1 + distances(2)), aug.make_params(picture(2))
            assert torch.equal(aug.scenes(picture(2), z, record).metres, z)
            plane = replace(aug, distance=Plane(times))
            scenes = plane.scenes(picture(2), None, plane.make_params(picture(2)))
            assert scenes.metres.unique().tolist() == [pytest.approx(times)]
            assert scenes.clarity(1).metres == pytest.approx(times)


TANK_FIT = uwaug.load_preset("tank-proposed-1").water.waters


@pytest.mark.parametrize("light", [None, LIT])
@pytest.mark.parametrize("water", ["II", TANK, "chlorophyll=5,cdom=.3", FIT, TANK_FIT], ids=str)
def test_a_grade_is_what_is_left_at_the_median_distance(water: Any, light: Light | None) -> None:
    noun, shares = RandomWater(water, field=None), []
    for level, grade in SEVERITIES.items():
        aug = RandomUnderwater.severity(level, noun, light=light)
        record = aug.make_params(picture())
        shares.append(float(aug.contrast_left(picture(), wall(2.5), record).mean()))
        if light is None:  # without scattered light
            made = aug.scenes(picture(), wall(2.5), record).clarity(0).water
            assert metres_for(made, grade) == pytest.approx(2.5, rel=1e-3)
        else:
            assert shares[-1] == pytest.approx(grade, abs=0.002)
    assert shares == sorted(set(shares), reverse=True)


@pytest.mark.parametrize("water", ["II", TANK, COAST, RandomWater(["IA", COAST], mixing=0.5), None])
def test_a_visibility_is_reached_at_any_distance(water: Any) -> None:
    noun = water if isinstance(water, RandomWater) else RandomWater(water)
    aug = RandomUnderwater(replace(noun, visibility=(3.0, 9.0)))
    for metres in (2.5, 75.0):
        record = aug.make_params(picture(4))
        scenes = aug.scenes(picture(4), wall(metres, 4), record)
        for i, sample in enumerate(record["samples"]):
            asked, seen = sample["water"]["visibility"], scenes.clarity(i).record()["visibility"]
            assert 3 <= asked <= 9
            assert seen == pytest.approx(asked, rel=1e-6)


@pytest.mark.parametrize("metres", [0.3, 1.5, 4.0])
def test_default_waters_let_one_see_so_many_median_distances(metres: float) -> None:
    aug = RandomUnderwater(light=None)
    record = aug.make_params(picture(32), seeded())
    scenes = aug.scenes(picture(32), wall(metres, 32), record)
    least, most = (share * metres for share in VISIBLE)
    for i, sample in enumerate(record["samples"]):
        (drawn,) = sample["water"]["waters"]
        wanted = least * (most / least) ** sample["water"]["clearness"]
        pure = uwaug.Water.of_amounts(drawn).with_contents(1e-3).visibility()
        seen = scenes.clarity(i).record()["visibility"]
        assert seen == pytest.approx(min(wanted, pure), rel=1e-3)


@pytest.mark.usefixtures("nothing_is_said")
@pytest.mark.parametrize("metres", [0.1, 3.0, 30.0])
def test_default_draws_are_waters(metres: float) -> None:
    """None is odd, however clear: a warning would be an error."""
    aug = RandomUnderwater()
    params = aug.make_params(picture())
    (sample,) = params["samples"]
    for share, clearness in product((0.0, 0.5, 1.0), (0.0, 1.0)):
        drawn = WATERS.drawn({}.fromkeys(WATERS.ranges(), share).__getitem__)
        sample["water"] |= {"waters": [drawn], "clearness": clearness}
        aug.transform(picture(), wall(metres), params)


@pytest.mark.parametrize("distance", [Relative(), Inverse(), MadeUp()])
@pytest.mark.parametrize("water", ["II", FIT, None], ids=str)
def test_a_scene_without_a_size_ends_where_its_water_leaves_so_much(
    water: Any, distance: Any
) -> None:
    aug, t = RandomUnderwater(RandomWater(water, field=None), distance=distance), distances(8)
    t.flatten(1)[:, 0], t.flatten(1)[:, 1] = 0.0, 1.0
    record = aug.make_params(picture(8), seeded(1))
    for sample in record["samples"]:
        sample["distance"] |= {"near_left": 0.6, "far_left": 0.04}
        sample["water"] |= {"clearness": 0.4} if water is None else {}  # neither end is held
    scenes = aug.scenes(picture(8), t if distance.reads_maps else None, record)
    for i, metres in enumerate(scenes.metres):
        water = scenes.clarity(i).water
        z = torch.stack([metres.min(), metres[metres.isfinite()].max()])
        if isinstance(water, uwaug.Medium):
            light = water.transmission(z[:, None, None, None])[..., 0, 0]
            ends = (light @ torch.tensor(LUMINANCE)).tolist()
        else:
            ends = [water.contrast(float(end)) for end in z]
        assert ends == pytest.approx((0.6, 0.04), abs=0.1 if distance == MadeUp() else 0.002)


# ---- modules


METERED = RandomDevelopment(**{**RandomDevelopment.PLAIN, "metered": True, "tone": 1.2})
FIXED = {
    "spectral": fixed(color_matrix=0.5, field=(0.5, 2.0)),
    "deep and metered": fixed(METERED, vertical_depth=100.0),
    "noisy": fixed(replace(RAW, noise=Sensor(2000.0, 3.0, seed=1))),
    "snowy": fixed(snow=uwaug.MarineSnow(5000.0, seed=3)),
    "lamps": fixed(light=Light((Lamp((0.3, 0.0, -0.5), 2.0),), 0.5)),
    "never a lamp": fixed(light=RandomLight(share=0.0, pitch=None)),
    "a pitch": fixed(light=RandomLight(share=0.0, pitch=10.0)),
    "medium": fixed(waters=FIT),
    "plane": replace(fixed(), distance=3.0),
    "linear": fixed(replace(RAW, color_space="linear")),
    **{name: uwaug.load_preset(name) for name in ("calibrated", "tank-proposed-1")},
}


@pytest.mark.parametrize("name", FIXED)
def test_a_module_is_the_only_draw(name: str) -> None:
    aug, image, z = FIXED[name], picture().double(), 1 + 2 * distances().double()
    metres = replace(aug, distance=Metres(), water=replace(aug.water, field=None))
    module = aug.module((1, 3), sides=(H, H))
    assert (module.color_space, module.sides) == (aug.development.color_space, (H, H))
    made = module(image, z)
    assert (metres(image, z)[0] - made).abs().max() < 5e-3
    assert (made - image).abs().mean() > 0.01


def test_a_module_is_planned_for_the_distances_times_the_field() -> None:
    for distance, ends in (
        (Metres(), (0.05, 40.0)),
        (Relative(2, (4, 8)), (1.0, 16.0)),
        (MadeUp(1, 5), (0.5, 10.0)),
        (Plane((25, 30)), (12.5, 60.0)),
        (Network(torch.mean, Inverse(3, 4)), (1.5, 8.0)),
    ):
        aug = replace(fixed(field=(0.5, 2.0)), distance=distance)
        assert aug.module().distance_range == ends


RANDOM: dict[str, RandomUnderwater] = {
    "water.contrast": fixed(contrast=0.2),
    "water.vertical_depth": fixed(vertical_depth=(0.0, 3.0)),
    "water.waters": fixed(waters=["II", "7C"]),
    "water.mixing": fixed(mixing=(0.0, 0.5)),
    "water.snow.seed": fixed(snow=uwaug.MarineSnow()),
    "development.exposure": fixed(replace(RAW, exposure=(-1.0, 0.0))),
    "development.noise.seed": fixed(replace(RAW, noise=Sensor(2000.0))),
    "p": replace(fixed(), p=0.5),
    "conditions": replace(fixed(), conditions=Conditions([{}, {"water": {"g": 0.3}}])),
    "water.waters, light.share, light.daylight, .*": fixed(waters=COAST, light=RandomLight()),
}


def test_what_is_random_is_no_module() -> None:
    for name, aug in RANDOM.items():
        with pytest.raises(ValueError, match=f"the same of all pictures, but {name} differ"):
            aug.module()


def test_a_medium_has_its_own_daylight_unless_lamps_are_asked_for() -> None:
    def lit(aug: RandomUnderwater) -> bool:
        record = aug.make_params(picture(300), seeded())
        return any("rig" in sample["light"] for sample in record["samples"])

    default = RandomUnderwater("II")
    assert lit(default)
    for water in (FIT, ["II", FIT]):
        # as it is, and after a process or a file
        for twin in (default, pickle.loads(pickle.dumps(default))):
            assert not lit(replace(twin, water=RandomWater(water)))
        assert not lit(RandomUnderwater(water))
        for light in (RandomLight(), RandomLight(share=0.5)):
            aug = RandomUnderwater(water, light=light)
            assert RandomUnderwater.from_dict(aug.to_dict()).light == aug.light == light
            assert lit(aug)


def test_a_network_in_place_of_maps() -> None:
    aug = RandomUnderwater("II", distance=Network(OPTIONS["network"]["distance"].model))
    by_maps = RandomUnderwater("II", distance=Inverse())
    record = aug.make_params(picture(2))
    held = [{**each, "distance": each["distance"]["holds"]} for each in record["samples"]]
    maps = picture(2).mean(1, keepdim=True)
    expected = by_maps.transform(picture(2), maps, {"samples": held})
    assert same(aug.transform(picture(2), None, record), expected)
    inputs = picture(2, torch.uint8), "label", "other"
    assert aug(*inputs)[1:] == inputs[1:]


# ---- what is said, and what is refused

HOSTS = pytest.mark.parametrize("host", [True, False])


@HOSTS
def test_open_water(host: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(checks, "on_host", lambda x: host)
    z = distances(2)
    z[0] = z[1, ..., : W // 2] = math.inf
    assert RandomUnderwater()(picture(2), z)[0].isfinite().all()


SHARES = torch.linspace(0.01, 1, H * W).reshape(1, H, W)
NO_WATER = "times what is in it, which is hardly that water"
THICK = RandomWater("chlorophyll=.01", visibility=2.0)
SAID: list[tuple[RandomWater, Light | None, Tensor, str]] = [
    (RandomWater("9C", field=None), None, wall(50.0), r"less than 3 % .* median of 50 m"),
    (RandomWater("I", contrast=0.4), None, wall(3.0), NO_WATER),
    (RandomWater("I", contrast=0.1), LIT, wall(0.5), NO_WATER),
    (THICK, None, wall(0.5), NO_WATER),
    (RandomWater(COAST, contrast=0.9), None, wall(30.0), "pure water has less than a contrast"),
    (RandomWater(COAST, contrast=0.9), LIT, wall(30.0), "0.9 at 30 m: ask for less"),
    (RandomWater(), None, SHARES, r"0…1, which looks relative: .*Inverse\(near, far\)"),
    (RandomWater("II", visibility=200.0), None, wall(4.0), "less than the visibility at 4 m"),
]


@pytest.mark.usefixtures("nothing_is_said")
@HOSTS
@pytest.mark.parametrize("water, light, z, message", SAID)
def test_says_once_what_is_odd(
    water: Any, light: Any, z: Tensor, message: str, host: bool, monkeypatch: Any
) -> None:
    monkeypatch.setattr(checks, "on_host", lambda x: host)
    aug = RandomUnderwater(water, light=light)
    with pytest.warns(UserWarning, match=message):
        aug(picture(), z)
    aug(picture(), z)  # silent: a warning would be an error


def options(make: Callable[..., Any], *words: str, **given: Any) -> tuple[Callable[[], Any], str]:
    return partial(make, **given), ".*".join(words)


NAMED = uwaug.Water([400, 700], [1, 1], [1, 1], [1, 1], name="tank")
OPTIONS_REFUSED = [
    options(RandomWater, "contrast must be a number or a range", contrast=(0.5, 0.2)),
    options(RandomWater, "waters must have an order", waters={"II"}),
    options(RandomWater, "two are called 'tank'", waters=[TANK, NAMED]),
    options(RandomWater, "mixing must be 0", waters=["II", FIT], mixing=(0, 1)),
    options(RandomWater, "visibility and contrast both", visibility=4.0, contrast=0.3),
    options(RandomUnderwater, "water must be one of", water="IX"),
    options(RandomUnderwater, r"p must be in \[0, 1\]", p=2.0),
    options(RandomUnderwater, "distance must be", r"Network\(", distance=torch.nn.Identity()),
    options(RandomUnderwater, "light must be a", "RandomLight, got float", light=3.0),
    options(RandomLight, r"share must be in \[0, 1\]", share=1.5),
    options(RandomLight, "rigs must be one of vehicle, diver, strobe", rigs=("torch",)),
    options(RandomLight, "rigs must be one of vehicle, diver, strobe", rigs=()),
    options(RandomLight, "cone must be a number or a range", cone=120.0),
    options(RandomDevelopment, "metered must be True or False, got 'off'", metered="off"),
    options(uwaug.Development, "metered must be True or False, got 0", metered=0),
]
THREE, ONES = picture(3), torch.ones(3, 1, H, W)
BAD = torch.zeros(3, 1, 1, 1).index_fill(0, torch.tensor(1), 1.0)
SECOND = "^picture 1 of 3, counted from 0"
INPUTS_REFUSED: list[tuple[Any, Any, str]] = [
    (picture(), None, "distance is missing: .*MadeUp.*, Network.* or Plane"),
    (THREE, ONES + 3000 * BAD, f"{SECOND}: distance must be in metres.*by 1000"),
    (THREE, ONES.where(BAD < 1, 0.0), f"{SECOND}: .* zero at 792 of 792 pixels: give"),
    (THREE, ONES - 9 * BAD, f"{SECOND}: distance must be above 0 m"),
    (picture(), distances()[..., 9:], "height and width must agree"),
    (picture(), "coral", r"expected \(image, distance, …\)"),
    (picture(2), distances(3), "batch of 3 but image is one of 2"),
    (THREE + torch.nan * BAD, ONES, "image is NaN"),
    (THREE + 300 * BAD, ONES, f"{SECOND}: image reaches"),
    (THREE - 9 * BAD, ONES, f"{SECOND}: image falls to"),
    (picture().numpy(), distances(), "from_numpy"),
]
ALL_DRAWN = RandomUnderwater(
    RandomWater(["II", COAST], contrast=(0.2, 0.4), snow=uwaug.MarineSnow((500, 5000))),
    distance=Relative((0.5, 1.0), 5.0),
    light=RandomLight(share=1.0),
    development=RandomDevelopment(noise=Sensor(2000.0)),
)
FILM = {"median": 2.0, "exposure": 0.0, "white_balance": None, "saturation": 1.0}
RECORDS_REFUSED: list[tuple[str, Any, str]] = [
    ("camera", "D90", "other options: sample.camera"),
    ("applied", "yes", "applied must be true or false, got 'yes'"),
    ("water", {"contrast": 0.4}, "other options: water.color_matrix"),
    ("water.waters", ["9C"], "asks for '9C', but this transform has II, chlorophyll"),
    ("water.waters", [{"chlorophyll": 99.0}], "asks for {'chlorophyll': 99"),
    ("water.waters", ["II", "II"], "water.waters must be 1, got"),
    ("water.field_seed", 1.5, "water.field_seed must be a whole number from 0 to 4294967295"),
    *[("development.noise.seed", s, "noise.seed must be a whole") for s in (-1, True, "7", None)],
    ("light.power", "bright", "light.power must be"),
    ("development.gamut", 7.0, r"development.gamut must be in \[0, 1\], got 7"),
    ("moved", math.inf, "moved must be finite"),
    ("measured", {"median": -1}, "other options: measured.exposure, measured.saturation"),
    *[("measured", {**FILM, "median": m}, "median must be above 0 m") for m in (-1, math.nan, "3")],
    ("measured", {**FILM, "white_balance": [1.0, 2.0, -1.0]}, "white_balance must be"),
]


def refused() -> list[tuple[Callable[[], Any], str]]:
    """Options, inputs and records: what is called, and what is said."""
    usual = RandomUnderwater()
    params, calls = usual.make_params(picture()), list(OPTIONS_REFUSED)
    calls += [(partial(usual.transform, x, z, params), said) for x, z, said in INPUTS_REFUSED]
    records: list[tuple[Any, str]] = [(ALL_DRAWN.make_params(picture(2)), "has 2 samples")]
    records += [(x, "must be a rec") for x in (None, {}, {"samples": {}}, {"samples": [1]})]
    for name, value, said in RECORDS_REFUSED:
        record = ALL_DRAWN.make_params(picture())
        *outer, last = name.split(".")
        reduce(dict.__getitem__, outer, record["samples"][0])[last] = value
        records.append((record, said))
    for record, said in records:
        call = partial(ALL_DRAWN.transform, picture(), distances(), record)
        calls.append((call, f"params.*{said}"))
    return calls


@HOSTS
def test_what_is_refused(host: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(checks, "on_host", lambda x: host)
    for call, message in refused():
        with pytest.raises((TypeError, ValueError), match=message):
            call()
