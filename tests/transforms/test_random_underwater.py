"""What holds for `RandomUnderwater`, whatever its options are."""

import copy
import json
import math
import pickle
from dataclasses import replace
from functools import reduce
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
from uwaug import (
    Development,
    Lamp,
    Light,
    MarineSnow,
    Medium,
    PointSpread,
    RandomDevelopment,
    RandomLight,
    RandomUnderwater,
    RandomWater,
    Sensor,
    Underwater,
    Water,
    load_preset,
    load_water,
)
from uwaug._support import checks
from uwaug.distance import Inverse, MadeUp, Metres, Network, Plane, Relative
from uwaug.formation.colour import LUMINANCE
from uwaug.formation.contrast import metres_for as seen_to
from uwaug.transforms.random_underwater import SEVERITIES
from uwaug.transforms.random_water import VISIBLE, WATERS


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
        assert twins[-1].to_dict() == aug.to_dict()
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


SAID: list[Any] = [
    RandomWater("3C"),
    RandomWater(["3c"]),
    Water.jerlov("3C"),
    {"water": "3C"},
    {"water": ["3C"]},
    {"water": {"waters": "3C"}},
    {"water": {"kind": "RandomWater", "waters": ["3C"]}},
]


@pytest.mark.parametrize("said", SAID)
def test_a_water_is_said_in_many_ways(said: Any) -> None:
    make = RandomUnderwater.from_dict if isinstance(said, dict) else RandomUnderwater
    assert same(result(make(said)), result(RandomUnderwater(water="3C")))


def test_tables_as_a_person_writes_them() -> None:
    aug = RandomUnderwater.from_dict(
        {
            "water": {
                "waters": ["II", "chlorophyll=1:20,cdom=.1:2,minerals=.5"],
                "contrast": "none",
                "point_spread": {"scale": 3.0},
            },
            "development": {"exposure": [-1, 0]},
            "distance": {"kind": "Relative", "far": [4, 8]},
        }
    )
    assert aug.development == RandomDevelopment(exposure=(-1, 0))
    assert aug.distance == Relative(far=(4, 8))
    assert (aug.water.contrast, aug.water.point_spread) == (None, PointSpread(3.0))
    assert aug.make_params(picture())["samples"][0]["distance"]["gamma"] == 1.0
    water = "RandomWater(waters='3C', contrast=0.3)"
    aug = RandomUnderwater(RandomWater("3C", contrast=0.3), distance=(1.0, 2.0))
    assert repr(aug) == f"RandomUnderwater(water={water}, distance=Plane(distance=(1.0, 2.0)))"
    assert repr(RandomUnderwater()) == "RandomUnderwater()"


def test_draws_fill_their_ranges() -> None:
    water = RandomWater([COAST, "II", "II"], **EVERYTHING)
    aug = RandomUnderwater(water, p=0.5, distance=Relative(1, (3, 9)))
    image = torch.empty(2000, 3, 1, 1)
    samples = aug.make_params(image, torch.Generator().manual_seed(0))["samples"]
    assert sum(sample["applied"] for sample in samples) / 2000 == pytest.approx(0.5, abs=0.04)
    for name, (low, high) in {
        **{f"water.{name}": ends for name, ends in EVERYTHING.items()},
        "distance.far": (3, 9),
        "development.gamut": RandomDevelopment().gamut,
    }.items():
        drawn = torch.tensor([flat(sample)[name] for sample in samples])
        assert drawn.min() >= low
        assert drawn.max() <= high
        middle = math.sqrt(low * high) if name == "water.contrast" else (low + high) / 2
        assert float(drawn.median()) == pytest.approx(middle, abs=0.04 * (high - low))
    waters = [water for sample in samples for water in sample["water"]["waters"]]
    assert waters.count("II") / len(waters) == pytest.approx(2 / 3, abs=0.03)
    amounts = [water for water in waters if water != "II"]
    assert all(COAST.holds(each) for each in amounts)
    assert len({each["cdom"] for each in amounts}) > 1000


PLAIN: dict[str, Any] = {**RandomWater.PLAIN, "point_spread": PointSpread.paper()}


def fixed(development: Any = RAW, light: Any = None, **water: Any) -> RandomUnderwater:
    """A transform of which nothing is random but what is said."""
    noun = RandomWater(**{"waters": "3C", **PLAIN, **water})
    return RandomUnderwater(noun, light=light, development=development)


def test_fixed_options_are_an_underwater() -> None:
    """The same picture by the module, of the water that the transform says it takes."""
    water, law = Water.jerlov("3C"), PLAIN["point_spread"]
    aug = fixed(vertical_depth=2.0, contrast=0.4)
    z = 2 + distances().double()
    # of the waters that leave .4 at the median distance, this one
    scaled = water.with_contrast(0.4, float(z.median()))
    medium = Medium.from_water(scaled, vertical_depth=2.0, g=0.05, point_spread=law)
    expected = Underwater(medium, (2.0, 3.0))(picture().double(), z)
    made, _ = aug(picture().double(), z)
    assert (made - expected).abs().max() < 2e-3
    left = uwaug.contrast_left(z, medium)
    shares = aug.contrast_left(picture().double(), z, aug.make_params(picture()))
    assert (shares - left).abs().max() < 5e-3


def test_no_veil_that_is_drawn_is_brighter_than_a_white_plate() -> None:
    scene = picture(), 1 + distances()

    def veil(**options: Any) -> Tensor:
        aug = RandomUnderwater(RandomWater("II", **options))
        record = aug.make_params(picture(), torch.Generator().manual_seed(0))
        (drawn,) = aug.scenes(*scene, record).scenes
        return drawn.setting.medium.curves(torch.tensor([[[[1e4]]]])).veil

    held, highest, asked = (veil(g=0.02, mu=mu) for mu in ((0.03, 0.04), 0.02, 0.03))
    torch.testing.assert_close(held, highest)
    torch.testing.assert_close(asked, 1.5 * highest, rtol=1e-3, atol=0)


def test_a_field_is_drawn_for_each_picture() -> None:
    water = RandomWater("II", field=(0.2, 3.0), vertical_depth=1.0)
    aug = RandomUnderwater(water, light=None)
    z = torch.full((1, 24, 33), 3.0)
    params = aug.make_params(picture())
    left = aug.contrast_left(picture(), z, params)
    medium = aug.scenes(picture(), z, params).scenes[0].setting.medium
    ends = uwaug.contrast_left(torch.tensor([[[9.0, 0.6]]]), medium)
    assert float(left.min()) == pytest.approx(float(ends.min()), rel=0.02)
    assert float(left.max()) == pytest.approx(float(ends.max()), rel=0.02)


def test_deep_and_turbid_waters_are_no_deeper_than_a_meter_makes_up_for() -> None:
    scene = picture(), 1 + distances()
    water = RandomWater("9C", vertical_depth=100.0)
    metered = RandomUnderwater(water, light=None)
    assert metered(*scene)[0].mean() > 0.1
    assert metered.make_params(picture())["samples"][0]["water"]["vertical_depth"] == 100
    fixed = RandomUnderwater(water, light=None, development=RAW)
    assert fixed(*scene)[0].max() < 1e-3


@pytest.mark.parametrize("light", [None, Light((Lamp(),), daylight=0.3)])
@pytest.mark.parametrize("kind", ["srgb", "linear"])
def test_gradients_pass_to_image_and_distance(kind: Any, light: Light | None) -> None:
    # a blur is planned for the distances and the exposure at hand, which are not followed
    water = RandomWater(["II", "5C"], point_spread=PointSpread.none())
    aug = RandomUnderwater(water, development=RandomDevelopment(color_space=kind), light=light)
    image = (0.2 + 0.6 * torch.rand(3, 3, 5, dtype=torch.float64)).requires_grad_()
    z = (1 + torch.rand(1, 3, 5, dtype=torch.float64)).requires_grad_()
    record = aug.make_params(image, torch.Generator().manual_seed(3))
    assert torch.autograd.gradcheck(
        lambda image, z: aug.transform(image, z, record), (image, z), atol=1e-5, rtol=1e-3
    )


ROUNDING = {torch.float16: 6e-4, torch.bfloat16: 5e-3, torch.float32: 1e-4}


@pytest.mark.parametrize("dtype", [torch.uint8, *ROUNDING])
def test_types(dtype: torch.dtype) -> None:
    aug = RandomUnderwater(distance=3.0)
    for batch in (None, 2):
        image, white = picture(batch, dtype), 255 if dtype == torch.uint8 else 1
        record = aug.make_params(image)
        out = aug.transform(image, None, record)
        assert (out.dtype, out.shape) == (dtype, image.shape)
        exact = aug.transform(image.double() / white, None, record)
        most = ROUNDING.get(dtype, 0.51 / 255)
        assert (out.double() / white - exact).abs().max() <= most


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
    counts = torch._dynamo.utils.counters["stats"]
    assert counts["unique_graphs"] == 2  # before and behind the transform


WALL, LIT = torch.full((1, H, W), 2.5), Light((Lamp((0.4, 0.0, 0.0)),), 0.3)
TANK_FIT = load_preset("tank-proposed-1").water.waters


@pytest.mark.filterwarnings("ignore:.*if distances are metres")
@pytest.mark.parametrize("light", [None, LIT])
@pytest.mark.parametrize("water", ["9C", RandomWater(contrast=0.3), FIT, COAST, None], ids=str)
def test_distances_are_those_of_the_map_in_any_water(water: Any, light: Light | None) -> None:
    noun = water if isinstance(water, RandomWater) else RandomWater(water)
    for aug in (RandomUnderwater(noun, light=light), RandomUnderwater.severity(5, noun)):
        for times in (0.5, 3.0, 40.0):
            z, record = times * (1 + distances(2)), aug.make_params(picture(2))
            assert torch.equal(aug.scenes(picture(2), z, record).metres, z)
            plane = replace(aug, distance=Plane(times))
            scenes = plane.scenes(picture(2), None, plane.make_params(picture(2)))
            assert scenes.metres.unique().tolist() == [pytest.approx(times)]
            assert scenes.clarity(1).metres == pytest.approx(times)


@pytest.mark.parametrize("light", [None, LIT])
@pytest.mark.parametrize("water", ["II", TANK, "chlorophyll=5,cdom=.3", FIT, TANK_FIT], ids=str)
def test_a_grade_is_what_is_left_at_the_median_distance(water: Any, light: Light | None) -> None:
    noun, shares = RandomWater(water, field=None), []
    for level, grade in SEVERITIES.items():
        aug = RandomUnderwater.severity(level, noun, light=light)
        record = aug.make_params(picture())
        shares.append(float(aug.contrast_left(picture(), WALL, record).mean()))
        if light is None:  # without scattered light
            made = aug.scenes(picture(), WALL, record).clarity(0).water
            assert seen_to(made, grade) == pytest.approx(2.5, rel=1e-3)
        else:
            assert shares[-1] == pytest.approx(grade, abs=0.002)
    assert shares == sorted(set(shares), reverse=True)


def test_a_scene_that_is_made_up_is_the_same_at_every_grade() -> None:
    grades, made = [RandomUnderwater.severity(n, distance=MadeUp()) for n in SEVERITIES], []
    for grade in grades:
        record = grade.make_params(picture(), grade.generator_of(0, 0, 1))
        made.append(grade.scenes(picture(), None, record).metres)
    assert all(torch.equal(other, made[0]) for other in made)


@pytest.mark.parametrize("water", ["II", TANK, COAST, RandomWater(["IA", COAST], mixing=0.5), None])
def test_a_visibility_is_reached_at_any_distance(water: Any) -> None:
    noun = water if isinstance(water, RandomWater) else RandomWater(water)
    aug = RandomUnderwater(replace(noun, visibility=(3.0, 9.0)))
    for times in (1.0, 30.0):
        record = aug.make_params(picture(4))
        scenes = aug.scenes(picture(4), times * WALL.expand(4, 1, H, W), record)
        for i, sample in enumerate(record["samples"]):
            asked, found = sample["water"]["visibility"], scenes.clarity(i).record()["visibility"]
            assert 3 <= asked <= 9
            assert found == pytest.approx(asked, rel=1e-6)


@pytest.mark.parametrize("metres", [0.3, 1.5, 4.0])
def test_default_waters_let_one_see_so_many_median_distances(metres: float) -> None:
    aug, z = RandomUnderwater(light=None), torch.full((32, 1, H, W), metres)
    record = aug.make_params(picture(32), torch.Generator().manual_seed(0))
    scenes, ends = aug.scenes(picture(32), z, record), (VISIBLE[0] * metres, VISIBLE[1] * metres)
    natural = []
    for i, sample in enumerate(record["samples"]):
        (drawn,), clearness = sample["water"]["waters"], sample["water"]["clearness"]
        wanted = ends[0] * (ends[1] / ends[0]) ** clearness
        if isinstance(drawn, str):
            natural.append(load_water(drawn).visibility())
            wanted = min(max(natural[-1], ends[0]), ends[1])
        found = scenes.clarity(i).record()
        assert found["visibility"] == pytest.approx(wanted, rel=1e-3)
        if wanted in natural:
            assert found["contents"] == pytest.approx(1, rel=1e-3)
    assert 0 < len(natural) < 32


@pytest.mark.parametrize("distance", [Relative(), Inverse(), MadeUp()])
@pytest.mark.parametrize("water", ["II", "5C", FIT, None], ids=str)
def test_a_scene_without_a_size_ends_where_its_water_leaves_so_much(
    water: Any, distance: Any
) -> None:
    aug, t = RandomUnderwater(RandomWater(water, field=None), distance=distance), distances(8)
    t.flatten(1)[:, 0], t.flatten(1)[:, 1] = 0.0, 1.0
    record = aug.make_params(picture(8), torch.Generator().manual_seed(1))
    for sample in record["samples"]:
        sample["distance"] |= {"near_left": 0.6, "far_left": 0.04}
    scenes = aug.scenes(picture(8), t if distance.reads_maps else None, record)
    for i, metres in enumerate(scenes.metres):
        water = scenes.clarity(i).water
        z = torch.stack([metres.min(), metres[metres.isfinite()].max()])
        if isinstance(water, Medium):
            near, far = (
                torch.tensor(LUMINANCE) @ water.transmission(z[:, None, None, None])[..., 0, 0].mT
            )
        else:
            near, far = (water.contrast(float(end)) for end in z)
        assert near == pytest.approx(0.6, abs=0.1 if distance == MadeUp() else 0.002)
        assert far == pytest.approx(0.04, abs=0.1 if distance == MadeUp() else 0.002)


METERED = RandomDevelopment(**{**RandomDevelopment.PLAIN, "metered": True, "tone": 1.2})
NOISY = replace(RAW, noise=Sensor(2000.0, 3.0, seed=1))
FIXED = {
    "plain": fixed(),
    "spectral": fixed(color_matrix=0.5, field=(0.5, 2.0)),
    "deep and metered": fixed(METERED, vertical_depth=100.0),
    "noisy": fixed(NOISY),
    "snowy": fixed(snow=MarineSnow(5000.0, seed=3)),
    "lamps": fixed(light=Light((Lamp((0.3, 0.0, -0.5), 2.0),), 0.5)),
    "never a lamp": fixed(light=RandomLight(share=0.0, pitch=None)),
    "a pitch": fixed(light=RandomLight(share=0.0, pitch=10.0)),
    "medium": fixed(waters=FIT),
    "plane": replace(fixed(), distance=3.0),
    "linear": fixed(replace(RAW, color_space="linear")),
    **{name: load_preset(name) for name in ("calibrated", "survey", "tank-proposed-1")},
}


@pytest.mark.parametrize("name", FIXED)
def test_a_module_is_the_only_draw(name: str) -> None:
    aug, z = FIXED[name], 1 + 2 * distances().double()
    metres = replace(aug, distance=Metres(), water=replace(aug.water, field=None))
    module = aug.module((1, 3), sides=(H, H))
    assert (module.color_space, module.sides) == (aug.development.color_space, (H, H))
    made = module(picture().double(), z)
    assert (metres(picture().double(), z)[0] - made).abs().max() < 5e-3
    assert (made - picture()).abs().mean() > 0.01


@pytest.mark.parametrize(
    "distance, ends",
    [
        (Metres(), (0.05, 40.0)),
        (Relative(2, (4, 8)), (1.0, 16.0)),
        (MadeUp(1, 5), (0.5, 10.0)),
        (Plane((25, 30)), (12.5, 60.0)),
        (Network(torch.mean, Inverse(3, 4)), (1.5, 8.0)),
    ],
)
def test_a_module_is_planned_for_the_distances_times_the_field(distance: Any, ends: Any) -> None:
    aug = replace(fixed(field=(0.5, 2.0)), distance=distance)
    assert aug.module().distance_range == ends


RANDOM: dict[str, RandomUnderwater] = {
    "water.contrast": fixed(contrast=0.2),
    "water.vertical_depth": fixed(vertical_depth=(0.0, 3.0)),
    "water.waters": fixed(waters=["II", "7C"]),
    "water.mixing": fixed(mixing=(0.0, 0.5)),
    "water.snow.seed": fixed(snow=MarineSnow()),
    "development.exposure": fixed(replace(RAW, exposure=(-1.0, 0.0))),
    "development.noise.seed": fixed(replace(RAW, noise=Sensor(2000.0))),
    "p": replace(fixed(), p=0.5),
    "water.waters, light.share, light.daylight, .*": fixed(waters=COAST, light=RandomLight()),
}


@pytest.mark.parametrize("name", RANDOM)
def test_what_is_random_is_no_module(name: str) -> None:
    with pytest.raises(ValueError, match=f"the same of all pictures, but {name} differ: fix them"):
        RANDOM[name].module()


def test_a_medium_has_its_own_daylight_unless_lamps_are_asked_for() -> None:
    def lit(aug: RandomUnderwater) -> bool:
        record = aug.make_params(picture(300), torch.Generator().manual_seed(0))
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


@pytest.mark.usefixtures("nothing_is_said")
def test_says_once_where_nothing_is_left_to_see() -> None:
    aug = RandomUnderwater(RandomWater("9C", field=None))
    with pytest.warns(UserWarning, match=r"less than 3 % .* median of 50 m: take clearer"):
        aug(picture(), torch.full((1, 24, 33), 50.0))
    aug(picture(), torch.full((1, 24, 33), 50.0))  # silent: a warning would be an error


@pytest.mark.usefixtures("nothing_is_said")
def test_doubts_the_first_maps_of_a_process() -> None:
    aug, shares = RandomUnderwater(), torch.linspace(0.01, 1, 24 * 33).reshape(1, 24, 33)
    with pytest.warns(UserWarning, match=r"0…1, which looks relative: .*Inverse\(near, far\)"):
        aug(picture(), shares)
    aug(picture(), shares)  # silent: a warning would be an error


HOSTS = pytest.mark.parametrize("host", [True, False])


@HOSTS
def test_open_water(host: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(checks, "on_host", lambda x: host)
    z = distances(2)
    z[0] = z[1, ..., : W // 2] = math.inf
    assert RandomUnderwater()(picture(2), z)[0].isfinite().all()


ODD: list[tuple[RandomWater, Light | None, float, str]] = [
    (RandomWater("I", contrast=0.4), None, 3.0, "times what is in it, which is hardly that water"),
    (RandomWater("I", contrast=0.1), LIT, 0.5, "times what is in it, which is hardly that water"),
    (
        RandomWater("chlorophyll=.01", visibility=2.0),
        None,
        0.5,
        "hardly that water: name a more turbid one",
    ),
    (RandomWater(COAST, contrast=0.9), None, 30.0, "pure water has less than a contrast of 0.9"),
    (RandomWater(COAST, contrast=0.9), LIT, 30.0, "0.9 at 30 m: ask for less"),
    (RandomWater("II", visibility=200.0), None, 4.0, "less than the visibility at 4 m"),
]


@pytest.mark.usefixtures("nothing_is_said")
@HOSTS
@pytest.mark.parametrize("water, light, metres, message", ODD)
def test_says_once_that_a_water_is_none(
    water: Any, light: Any, metres: float, message: str, host: bool, monkeypatch: Any
) -> None:
    monkeypatch.setattr(checks, "on_host", lambda x: host)
    aug, z = RandomUnderwater(water, light=light), torch.full((1, H, W), metres)
    with pytest.warns(UserWarning, match=message):
        aug(picture(), z)
    aug(picture(), z)  # silent: a warning would be an error


@pytest.mark.usefixtures("nothing_is_said")
@pytest.mark.parametrize("metres", [0.3, 1.0, 3.0, 8.0, 30.0])
def test_default_draws_are_waters(metres: float) -> None:
    """None is odd, however clear: a warning would be an error."""
    aug, z = RandomUnderwater(), torch.full((1, H, W), metres)
    params = aug.make_params(picture())
    (sample,) = params["samples"]
    for water in WATERS:
        drawn = water if isinstance(water, str) else water.drawn(lambda name: 0.5)
        for clearness in (0.0, 1.0):
            sample["water"] |= {"waters": [drawn], "clearness": clearness}
            aug.scenes(picture(), z, params)


NAMED = Water([400, 700], [1, 1], [1, 1], [1, 1], name="tank")
REFUSED_OPTIONS: dict[str, Any] = {
    "contrast must be a number or a range": lambda: RandomWater(contrast=(0.5, 0.2)),
    "waters: expected at least one": lambda: RandomWater([]),
    "waters must have an order": lambda: RandomWater({"II"}),
    "water must be one of": lambda: RandomUnderwater("IX"),
    "water must be a Jerlov type": lambda: RandomUnderwater(3.0),
    "two are called 'tank'": lambda: RandomWater([TANK, NAMED]),
    "mixing must be 0": lambda: RandomWater(["II", FIT], mixing=(0, 1)),
    "must be a uwaug.PointSpread": lambda: RandomWater(point_spread=3.0),
    "visibility and contrast both": lambda: RandomWater(visibility=4.0, contrast=0.3),
    r"p must be in \[0, 1\]": lambda: RandomUnderwater(p=2.0),
    r"names of image and map, got \['a'\]": lambda: RandomUnderwater(keys=["a"]),
    r"distance must be .*Network\(…\)": lambda: RandomUnderwater(distance=torch.nn.Identity()),
    "tone must be": lambda: RandomDevelopment(tone=9.0),
    "metered must be True or False, got 'off'": lambda: RandomDevelopment(metered="off"),
    "metered must be True or False, got 0": lambda: Development(metered=0),
    "light must be a .*RandomLight, got float; or a": lambda: RandomUnderwater(light=3.0),
    "level must be a whole number from 1 to 5": lambda: RandomUnderwater.severity(6),
    "no 'waters'.*mean water": lambda: RandomUnderwater.from_dict({"waters": "II"}),
}


@pytest.mark.parametrize("message", REFUSED_OPTIONS)
def test_refused_options(message: str) -> None:
    with pytest.raises((TypeError, ValueError), match=message):
        REFUSED_OPTIONS[message]()


THREE, ones = picture(3), torch.ones(3, 1, H, W)
BAD = torch.zeros(3, 1, 1, 1).index_fill(0, torch.tensor(1), 1.0)
SECOND = "^picture 1 of 3, counted from 0"
REFUSED_INPUTS: dict[str, tuple[tuple[Any, Any], str]] = {
    "no map": ((picture(), None), r"distance is missing: .*MadeUp.*, Network.* or Plane"),
    "millimetres": ((THREE, ones + 3000 * BAD), rf"{SECOND}: distance must be in metres.*by 1000"),
    "holes": ((THREE, ones.where(BAD < 1, 0.0)), rf"{SECOND}: .* zero at 792 of 792 pixels: give"),
    "negative": ((THREE, ones - 9 * BAD), f"{SECOND}: distance must be above 0 m"),
    "size": ((picture(), distances()[..., 9:]), "height and width must agree"),
    "integers": ((picture(), distances().int()), "distance must be a floating-point tensor"),
    "label": ((picture(), "coral"), r"expected \(image, distance, …\)"),
    "batches": ((picture(2), distances(3)), "batch of 3 but image is one of 2"),
    "NaN": ((THREE + torch.nan * BAD, ones), "image is NaN"),
    "0…255": ((THREE + 300 * BAD, ones), f"{SECOND}: image reaches"),
    "normalised": ((THREE - 9 * BAD, ones), f"{SECOND}: image falls to"),
    "grey": ((picture()[:1], distances()), "image must have shape"),
    "array": ((picture().numpy(), distances()), r"from_numpy"),
}


@pytest.mark.parametrize("case", REFUSED_INPUTS)
def test_refused_inputs(case: str, monkeypatch: pytest.MonkeyPatch) -> None:
    inputs, message = REFUSED_INPUTS[case]
    record = RandomUnderwater().make_params(picture())
    for host in (True, False):
        monkeypatch.setattr(checks, "on_host", lambda x, host=host: host)
        with pytest.raises((TypeError, ValueError), match=message):
            RandomUnderwater().transform(*inputs, record)


ALL_DRAWN = RandomUnderwater(
    RandomWater(["II", COAST], contrast=(0.2, 0.4), snow=MarineSnow((500, 5000))),
    distance=Relative((0.5, 1.0), 5.0),
    light=RandomLight(share=1.0),
    development=RandomDevelopment(noise=Sensor(2000.0)),
)
FILM = {"median": 2.0, "exposure": 0.0, "white_balance": None, "saturation": 1.0}
REFUSED_RECORDS: list[tuple[str, Any, str]] = [
    ("camera", "D90", "other options: sample.camera"),
    ("applied", "yes", "applied must be true or false, got 'yes'"),
    ("water", {"contrast": 0.4}, "other options: water.color_matrix"),
    ("water", None, "water must be a table"),
    ("water.waters", ["9C"], "asks for '9C', but this transform has II, chlorophyll"),
    ("water.waters", [{"chlorophyll": 99.0}], "asks for {'chlorophyll': 99"),
    ("water.waters", ["II", "II"], "water.waters must be 1, got"),
    ("water.contrast", 2.0, r"water.contrast must be in \[0.001, 1\], got 2"),
    ("water.snow.density", 0.5, "water.snow.density must be in"),
    ("water.field_seed", 1.5, "water.field_seed must be a whole number from 0 to 4294967295"),
    ("water.snow.seed", 2**32, "water.snow.seed must be a whole number"),
    *[("development.noise.seed", s, "noise.seed must be a whole") for s in (-1, True, "7", None)],
    ("distance.near", -1.0, "distance.near must be"),
    ("light.power", "bright", "light.power must be"),
    ("light", {"power": 1.0}, "of a transform with other options: light.pitch"),
    ("development.gamut", 7.0, r"development.gamut must be in \[0, 1\], got 7"),
    ("moved", math.inf, "moved must be finite"),
    ("motion", 0.1, "motion must be three numbers"),
    ("measured", 3.0, "measured must be a table"),
    ("measured", {"median": -1}, "other options: measured.exposure, measured.saturation"),
    *[("measured", {**FILM, "median": m}, "median must be above 0 m") for m in (-1, math.nan, "3")],
    ("measured", {**FILM, "white_balance": [1.0, 2.0]}, "white_balance must be"),
    ("measured", {**FILM, "white_balance": [1.0, 2.0, -1.0]}, "white_balance must be"),
]


@pytest.mark.parametrize("name, value, message", REFUSED_RECORDS)
def test_refused_records(name: str, value: Any, message: str) -> None:
    record = ALL_DRAWN.make_params(picture())
    *outer, last = name.split(".")
    reduce(dict.__getitem__, outer, record["samples"][0])[last] = value
    with pytest.raises((TypeError, ValueError), match=f"params.*{message}"):
        ALL_DRAWN.transform(picture(), distances(), record)
    for other in (None, {}, {"samples": {}}, {"samples": [1]}, ALL_DRAWN.make_params(picture(2))):
        with pytest.raises((TypeError, ValueError), match=r"params (must be a rec|has 2 samples)"):
            ALL_DRAWN.transform(picture(), distances(), other)  # type: ignore[arg-type]


def test_a_network_in_place_of_maps() -> None:
    aug = RandomUnderwater("II", distance=Network(OPTIONS["network"]["distance"].model))
    maps = picture(2).mean(1, keepdim=True)
    by_maps = RandomUnderwater("II", distance=Inverse())
    record = aug.make_params(picture(2))
    held = [{**each, "distance": each["distance"]["holds"]} for each in record["samples"]]
    expected = by_maps.transform(picture(2), maps, {"samples": held})
    assert same(aug.transform(picture(2), None, record), expected)
    inputs = picture(2, torch.uint8), "label", "other"
    assert aug(*inputs)[1:] == inputs[1:]


def test_lamps_shine_at_any_depth() -> None:
    lamps = Light((Lamp((0.3, -0.2, 0.0), power=4.0),))
    water = RandomWater("II", vertical_depth=200.0)
    scene = picture(), 1 + distances()
    assert RandomUnderwater(water, development=RAW, light=None)(*scene)[0].max() < 0.01
    aug = RandomUnderwater(water, development=RAW, light=lamps)
    assert aug(*scene)[0].mean() > 0.1
    left = aug.contrast_left(*scene, aug.make_params(picture()))
    assert 0.1 < left.median() < 0.9
