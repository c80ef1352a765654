"""What holds for `RandomUnderwater`, whatever its options are."""

import copy
import json
import math
import pickle
from typing import Any

import pytest
import torch
from augmenting import (
    COAST,
    EVERYTHING,
    FIT,
    LASERS,
    OPTIONS,
    RAW,
    TANK,
    H,
    W,
    distances,
    leaves,
    picture,
    result,
    same,
)
from torch import Tensor

import uwaug
from uwaug import (
    Constituents,
    Lamp,
    Light,
    Medium,
    PointSpread,
    RandomDevelopment,
    RandomUnderwater,
    Underwater,
    Water,
    load_preset,
)
from uwaug._support import checks
from uwaug.distance import Inverse, Metres, Network, Plane, Relative
from uwaug.distance.doubts import first_maps
from uwaug.transforms.random_water import WATERS


def mapped(rest: list[Tensor], i: int | None = None) -> Tensor | None:
    """The maps of a batch, or the i-th, where there are any."""
    if not rest:
        return None
    return rest[0] if i is None else rest[0][i]


@pytest.mark.parametrize("name", OPTIONS)
def test_a_record_makes_the_picture_again(name: str) -> None:
    aug = RandomUnderwater(**OPTIONS[name])
    image, *rest = leaves(aug, 3)
    torch.manual_seed(5)
    record = aug.make_params(image)
    made = aug.transform(image, mapped(rest), record)
    assert made.isfinite().all()
    torch.manual_seed(5)
    drawn = aug(image, *rest)
    assert same(made, drawn[0] if rest else drawn)
    read = json.loads(json.dumps(record, allow_nan=False))
    assert read == record
    for twin in (pickle.loads(pickle.dumps(aug)), copy.deepcopy(aug)):
        assert same(made, twin.transform(image, mapped(rest), read))


@pytest.mark.parametrize("name", OPTIONS)
def test_a_batch_is_its_pictures_one_by_one(name: str) -> None:
    aug = RandomUnderwater(**OPTIONS[name])
    image, *rest = leaves(aug, 3)
    record = aug.make_params(image)
    pictures = [
        aug.transform(one, mapped(rest, i), {"samples": [record["samples"][i]]})
        for i, one in enumerate(image)
    ]
    assert same(aug.transform(image, mapped(rest), record), torch.stack(pictures))


@pytest.mark.parametrize("name", OPTIONS)
def test_options_as_plain_data(name: str) -> None:
    aug = RandomUnderwater(**OPTIONS[name])
    if name == "network":
        with pytest.raises(TypeError, match="cannot be written as numbers and words"):
            aug.to_dict()
        return
    twin = RandomUnderwater.from_dict(json.loads(json.dumps(aug.to_dict())))
    assert same(result(twin), result(aug))
    assert twin.to_dict() == aug.to_dict()


def test_tables_as_a_person_writes_them() -> None:
    aug = RandomUnderwater.from_dict(
        {
            "waters": ["II", "chlorophyll=1:20,cdom=.1:2,minerals=.5"],
            "development": {"exposure": [-1, 0]},
            "distance": {"kind": "Relative", "far": [4, 8]},
            "point_spread": {"scale": 3.0},
        }
    )
    assert aug.development == RandomDevelopment(exposure=(-1, 0))
    assert aug.distance == Relative(far=(4, 8))
    assert aug.point_spread == PointSpread(3.0)
    assert aug.make_params(picture())["samples"][0]["numbers"]["gamma"] == 1.0


def test_repr_shows_what_differs_from_the_default() -> None:
    assert repr(RandomUnderwater()) == "RandomUnderwater()"
    aug = RandomUnderwater("3C", distance=(1.0, 2.0), contrast=None)
    expected = "waters='3C', contrast=None, distance=Plane(low=1.0, high=2.0)"
    assert repr(aug) == f"RandomUnderwater({expected})"


def test_draws_fill_their_ranges() -> None:
    aug = RandomUnderwater([COAST, "II", "II"], **EVERYTHING, p=0.5, distance=Relative(1, (3, 9)))
    image = torch.empty(2000, 3, 1, 1)
    samples = aug.make_params(image, torch.Generator().manual_seed(0))["samples"]
    assert sum(sample["applied"] for sample in samples) / 2000 == pytest.approx(0.5, abs=0.04)
    for name, (low, high) in {
        **EVERYTHING,
        "far": (3, 9),
        "gamut": RandomDevelopment().gamut,
    }.items():
        drawn = torch.tensor([sample["numbers"][name] for sample in samples])
        assert drawn.min() >= low
        assert drawn.max() <= high
        middle = math.sqrt(low * high) if name == "contrast" else (low + high) / 2
        assert float(drawn.median()) == pytest.approx(middle, abs=0.04 * (high - low))
    names = [name for sample in samples for name in sample["waters"]]
    assert names.count("II") / len(names) == pytest.approx(2 / 3, abs=0.03)
    assert all(COAST.holds(Constituents.parse(name)) for name in names if name != "II")
    assert len(set(names)) > 1000


def test_fixed_options_are_an_underwater() -> None:
    """The same picture by the module, of the water that the transform says it takes."""
    water, law = Water.jerlov("3C"), PointSpread.paper()
    aug = RandomUnderwater(
        "3C",
        contrast=0.4,
        vertical_depth=2.0,
        mu=None,
        field=None,
        point_spread=law,
        development=RAW,
        light=None,
    )
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
        aug = RandomUnderwater("II", contrast=None, **options)
        record = aug.make_params(picture(), torch.Generator().manual_seed(0))
        return aug.scenes(*scene, record).waters[0].medium.curves(torch.tensor([[[[1e4]]]])).veil

    held, highest, asked = (
        veil(g=0.02, mu=(0.03, 0.04)),
        veil(g=0.02, mu=0.02),
        veil(g=0.02, mu=0.03),
    )
    torch.testing.assert_close(held, highest)
    torch.testing.assert_close(asked, 1.5 * highest, rtol=1e-3, atol=0)


def test_a_medium_stays_as_it_is() -> None:
    aug = RandomUnderwater(FIT, field=None, development=RAW, contrast=0.1, light=None)
    z = 1 + distances()
    expected = Underwater(FIT, (1.0, 2.0))(picture(), z)
    assert (aug(picture(), z)[0] - expected).abs().max() < 1e-4


def test_a_field_is_drawn_for_each_picture() -> None:
    options: Any = {"contrast": None, "vertical_depth": 1.0, "light": None}
    aug = RandomUnderwater("II", field=(0.2, 3.0), **options)
    z = torch.full((1, 24, 33), 3.0)
    params = aug.make_params(picture())
    left = aug.contrast_left(picture(), z, params)
    medium = aug.scenes(picture(), z, params).waters[0].medium
    ends = uwaug.contrast_left(torch.tensor([[[9.0, 0.6]]]), medium)
    assert float(left.min()) == pytest.approx(float(ends.min()), rel=0.02)
    assert float(left.max()) == pytest.approx(float(ends.max()), rel=0.02)


def test_deep_and_turbid_waters_are_no_deeper_than_a_meter_makes_up_for() -> None:
    scene = picture(), 1 + distances()
    params = RandomUnderwater("9C", vertical_depth=100.0).make_params(picture())
    options: Any = {"contrast": None, "vertical_depth": 100.0, "light": None}
    metered = RandomUnderwater("9C", **options)
    assert metered(*scene)[0].mean() > 0.1
    assert params["samples"][0]["numbers"]["vertical_depth"] == 100
    fixed = RandomUnderwater("9C", **options, development=RAW)
    assert fixed(*scene)[0].max() < 1e-3


@pytest.mark.parametrize("light", [None, Light((Lamp(),), daylight=0.3)])
@pytest.mark.parametrize("kind", ["srgb", "linear"])
def test_gradients_pass_to_image_and_distance(kind: Any, light: Light | None) -> None:
    # a blur is planned for the distances and the exposure at hand, which are not followed
    options: Any = {
        "waters": ["II", "5C"],
        "development": RandomDevelopment(color_space=kind),
        "point_spread": PointSpread.none(),
        "light": light,
    }
    aug = RandomUnderwater(**options)
    image = (0.2 + 0.6 * torch.rand(3, 6, 7, dtype=torch.float64)).requires_grad_()
    z = (1 + torch.rand(1, 6, 7, dtype=torch.float64)).requires_grad_()
    generator = torch.Generator().manual_seed(3)
    record = aug.make_params(image, generator)
    # water and drawn lamps are scaled to the median distance, which is not followed
    fixed = RandomUnderwater(**options, contrast=None)
    del record["samples"][0]["numbers"]["contrast"]

    assert torch.autograd.gradcheck(
        lambda image, z: fixed.transform(image, z, record), (image, z), atol=1e-5, rtol=1e-3
    )


ROUNDING = {torch.float16: 6e-4, torch.bfloat16: 5e-3, torch.float32: 1e-4}


@pytest.mark.parametrize("dtype", [torch.uint8, *ROUNDING])
@pytest.mark.parametrize("batch", [None, 2])
def test_types(dtype: torch.dtype, batch: int | None) -> None:
    aug = RandomUnderwater(distance=3.0)
    image = picture(batch, dtype)
    record = aug.make_params(image)
    out = aug.transform(image, None, record)
    assert (out.dtype, out.shape) == (dtype, image.shape)
    exact = aug.transform(image.double() / (255 if dtype == torch.uint8 else 1), None, record)
    if dtype == torch.uint8:
        assert (out.double() / 255 - exact).abs().max() < 0.51 / 255
    else:
        assert (out.double() - exact).abs().max() <= ROUNDING[dtype]


class Classifier(torch.nn.Module):
    """A model that puts its pictures under water itself."""

    def __init__(self, augment: torch.nn.Module) -> None:
        super().__init__()
        self.augment, self.layer = augment, torch.nn.Conv2d(3, 4, 3)

    def forward(self, image: Tensor, distance: Tensor) -> Tensor:
        degraded, _ = self.augment(2 * image - image, distance)
        out: Tensor = self.layer(degraded)
        return out


def test_torch_compile_breaks_the_graph_and_draws_the_same() -> None:
    torch.compiler.reset()
    torch._dynamo.utils.counters.clear()
    model = Classifier(RandomUnderwater())
    compiled = torch.compile(model, backend="eager")
    for seed in range(2):
        results = []
        for either in (model, compiled):
            torch.manual_seed(seed)
            results.append(either(picture(2), distances(2) + 1))
        assert same(*results)
    counts = torch._dynamo.utils.counters["stats"]
    assert counts["unique_graphs"] == 2  # before and behind the transform


def test_severities_leave_less_and_less() -> None:
    z = torch.full((1, 24, 33), 3.0)
    left = []
    for level in range(1, 6):
        options = {"vertical_depth": 3.0, "field": None, "waters": "1C", "light": None}
        aug = RandomUnderwater.severity(level, **options)
        left.append(float(aug.contrast_left(picture(), z, aug.make_params(picture())).mean()))
    assert left == sorted(left, reverse=True)
    assert left[0] > 4 * left[-1]


@pytest.mark.parametrize("name", ["calibrated", "survey", "tank-proposed-1"])
def test_presets_are_their_modules(name: str) -> None:
    preset = load_preset(name)
    aug = RandomUnderwater.from_preset(name, field=None)
    z = 1 + 2 * distances().double()
    expected = Underwater(
        preset.medium, (1, 3), color_space=preset.color_space, development=preset.development
    )(picture().double(), z)
    assert (aug(picture().double(), z)[0] - expected).abs().max() < 5e-3
    changed = RandomUnderwater.from_preset(name, p=0.5, development=RAW)
    assert (changed.p, changed.development, changed.light) == (0.5, RAW, None)


@pytest.mark.usefixtures("nothing_is_said")
def test_says_once_where_nothing_is_left_to_see() -> None:
    aug = RandomUnderwater("9C", contrast=None, field=None)
    with pytest.warns(UserWarning, match=r"less than 3 % .* median distance 50 m: are distances"):
        aug(picture(), torch.full((1, 24, 33), 50.0))
    aug(picture(), torch.full((1, 24, 33), 50.0))  # silent: a warning would be an error


@pytest.mark.usefixtures("nothing_is_said")
@pytest.mark.parametrize("later", [False, True])
def test_doubts_the_first_maps_of_a_process(later: bool) -> None:
    aug, shares = RandomUnderwater(), torch.linspace(0.01, 1, 24 * 33).reshape(1, 24, 33)
    if later:  # the first is right, most are not
        for z in [1 + 2 * shares, *[shares.roll(k) for k in range(1, 7)]]:
            aug(picture(), z)
    with pytest.warns(UserWarning, match=r"distances look relative, .* Inverse\(near, far\)"):
        aug(picture(), shares)
    aug(picture(), shares)  # silent: a warning would be an error


def test_open_water() -> None:
    z = torch.full((1, 24, 33), math.inf)
    record = RandomUnderwater().make_params(picture())
    assert RandomUnderwater().transform(picture(), z, record).isfinite().all()


LAMP = Light([Lamp((0.2, 0.0, 0.0))])
AS_IT_IS: dict[str, dict[str, Any]] = {
    "nature": {"contrast": None},
    "medium": {"waters": FIT},
    "lamps": {"light": LAMP},
}


@pytest.mark.parametrize("host", [True, False])
@pytest.mark.parametrize(("metres", "size"), [(32.0, 8.0), (0.25, 1.0), (3.0, 3.0)])
def test_distances_are_scaled_to_where_water_has_a_colour(
    metres: float, size: float, host: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(checks, "on_host", lambda x: host)
    aug, z = RandomUnderwater(), 0.5 + distances(3)
    z[..., 4:-4, :] = 1.0  # the median, whichever pixels are looked at
    z[..., :3, :3] = math.inf
    record = aug.make_params(picture(3))
    made, expected = (aug.transform(picture(3), k * z, record) for k in (metres, size))
    assert torch.equal(made, expected)
    waters = aug.scenes(picture(3), metres * z, record).waters
    assert [water.scale for water in waters] == 3 * [size / metres]


@pytest.mark.parametrize("name", AS_IT_IS)
def test_distances_that_stay(name: str) -> None:
    aug = RandomUnderwater(**AS_IT_IS[name], field=None)
    z = torch.full((1, H, W), 0.2)
    assert torch.equal(aug.scenes(picture(), z, aug.make_params(picture())).z[0], z)


ODD: dict[str, tuple[dict[str, Any], float, str]] = {
    "centimetres": ({}, 350.0, "350 m is scaled by 0.0229: are distances metres?"),
    "kilometres": ({}, 0.0035, "0.0035 m is scaled by 286: are distances metres?"),
    "type": ({"waters": "I", "contrast": 0.4}, 3.0, "water I is too clear for 0.4 at 3 m: that is"),
    "contents": (
        {"waters": "chlorophyll=.01", "contrast": 0.2},
        2.0,
        "water chlorophyll=0.01 is too clear for 0.2 at 2 m.*a more turbid one; contrast=None",
    ),
    "lamps": ({"light": LAMP, "contrast": 0.9}, 30.0, "leaves 0.16 of contrast, not 0.9 at 30 m"),
}


@pytest.mark.usefixtures("nothing_is_said")
@pytest.mark.parametrize("host", [True, False])
@pytest.mark.parametrize("case", ODD)
def test_says_once_that_a_water_is_none(
    case: str, host: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(checks, "on_host", lambda x: host)
    monkeypatch.setattr(first_maps, "said", True)  # these maps are odd in other ways, too
    options, metres, message = ODD[case]
    aug, z = RandomUnderwater(**options), torch.full((1, H, W), metres)
    with pytest.warns(UserWarning, match=message):
        aug(picture(), z)
    aug(picture(), z)  # silent: a warning would be an error


@pytest.mark.usefixtures("nothing_is_said")
@pytest.mark.parametrize("metres", [0.3, 1.0, 3.0, 8.0, 30.0])
def test_default_draws_are_waters(metres: float) -> None:
    """None is odd, at any contrast that is drawn: a warning would be an error."""
    aug, z = RandomUnderwater(), torch.full((1, H, W), metres)
    params = aug.make_params(picture())
    (sample,) = params["samples"]
    for water in WATERS[:8]:
        for contrast in (0.08, 0.9):
            sample["waters"], sample["numbers"]["contrast"] = [water], contrast
            aug.scenes(picture(), z, params)


REFUSED_OPTIONS: dict[str, tuple[dict[str, Any], str]] = {
    "falling range": ({"contrast": (0.5, 0.2)}, r"contrast must be a number or a range"),
    "domain": ({"g": 1.5}, r"g must be .* in \[0, 1\]; got 1.5"),
    "field": ({"field": (-1.0, 1.0)}, "field must be"),
    "p": ({"p": 2.0}, r"p must be in \[0, 1\]"),
    "no water": ({"waters": []}, "waters: expected at least one"),
    "set": ({"waters": {"II"}}, "waters must have an order"),
    "unknown water": ({"waters": "IX"}, "water must be one of"),
    "no text": ({"waters": 3.0}, "water must be a Jerlov type"),
    "names": (
        {"waters": [TANK, Water([400, 700], [1, 1], [1, 1], [1, 1], name="tank")]},
        "two are called 'tank'",
    ),
    "mixed medium": ({"waters": ["II", FIT], "mixing": (0, 1)}, "mixing needs spectra"),
    "module": ({"distance": torch.nn.Identity()}, r"distance must be .*Network\(…\)"),
    "development": ({"development": {"gamut": 1}}, "must be a uwaug.RandomDevelopment"),
    "light": ({"light": 3.0}, "light must be a uwaug.RandomLight, got float; or a uwaug.Light"),
    "law": ({"point_spread": 3.0}, "must be a uwaug.PointSpread"),
    "camera": ({"camera": "obscura"}, "no camera is called so"),
}


@pytest.mark.parametrize("case", REFUSED_OPTIONS)
def test_refused_options(case: str) -> None:
    options, message = REFUSED_OPTIONS[case]
    with pytest.raises((TypeError, ValueError), match=message):
        RandomUnderwater(**options)


def test_refused_grades_and_developments() -> None:
    with pytest.raises(ValueError, match="level must be a whole number from 1 to 5"):
        RandomUnderwater.severity(6)
    with pytest.raises(ValueError, match="tone must be"):
        RandomDevelopment(tone=9.0)


NAN_IMAGE = picture().index_fill(1, torch.tensor(2), math.nan)
HOLED = (1 + distances()).index_fill(1, torch.tensor(2), 0.0)
REFUSED_INPUTS: dict[str, tuple[tuple[Any, Any], str]] = {
    "no map": ((picture(), None), r"distance is missing: .*MadeUp, Network and Plane"),
    "millimetres": ((picture(), 1000 * (2 + distances())), "metres.*divide by 1000"),
    "holes": ((picture(), HOLED), r"zero at 33 of 792 pixels: give holes="),
    "size": ((picture(), distances()[..., 9:]), "height and width must agree"),
    "integers": ((picture(), distances().int()), "distance must be a floating-point tensor"),
    "label": ((picture(), "coral"), r"expected \(image, distance, …\)"),
    "batches": ((picture(2), distances(3)), "batch of 3 but image is one of 2"),
    "NaN": ((NAN_IMAGE, 1 + distances()), "image is NaN at 99"),
    "0…255": ((255 * picture(), 1 + distances()), "image"),
    "grey": ((picture()[:1], distances()), "image must have shape"),
    "array": ((picture().numpy(), distances()), r"from_numpy"),
    "which": ((picture(2), torch.stack([1 + distances(), HOLED])), "^picture 1 of 2, counted"),
}


@pytest.mark.parametrize("case", REFUSED_INPUTS)
def test_refused_inputs(case: str) -> None:
    inputs, message = REFUSED_INPUTS[case]
    record = RandomUnderwater().make_params(picture())
    with pytest.raises((TypeError, ValueError), match=message):
        RandomUnderwater().transform(*inputs, record)


REFUSED_RECORDS: dict[str, tuple[dict[str, Any], str]] = {
    "key": ({"camera": "D90"}, "other options: camera"),
    "numbers": ({"numbers": {"contrast": 0.4}}, "other options: color_matrix"),
    "water": ({"waters": ["9C"]}, "asks for '9C', but this transform has II, chlorophyll"),
    "contents": ({"waters": ["chlorophyll=99"]}, "asks for 'chlorophyll=99'"),
}


@pytest.mark.parametrize("case", REFUSED_RECORDS)
def test_refused_records(case: str) -> None:
    change, message = REFUSED_RECORDS[case]
    aug = RandomUnderwater(["II", COAST])
    good = aug.make_params(picture(2))
    with pytest.raises(ValueError, match=message):
        aug.transform(picture(), 1 + distances(), {"samples": [good["samples"][0] | change]})


def test_refused_records_of_another_kind() -> None:
    aug = RandomUnderwater()
    two = aug.make_params(picture(2))
    for record in (None, {}, {"samples": {}}, {"samples": [1]}):
        with pytest.raises(TypeError, match="params must be a record from make_params"):
            aug.transform(picture(), distances(), record)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="params has 2 samples but image is a batch of 1"):
        aug.transform(picture(), distances(), two)
    two["samples"][0]["numbers"]["gamut"] = 7.0
    with pytest.raises(ValueError, match=r"params: gamut must be in \[0, 1\], got 7"):
        aug.transform(picture(2), distances(), two)


@pytest.mark.parametrize(
    "source", [Metres("behind"), Relative(0.5, (3, 8), holes="far"), Inverse(holes=4.0), Plane(2)]
)
def test_sources_and_holes(source: Any) -> None:
    maps = distances(2)
    maps[:, :, 3:8, 4:9] = math.nan
    aug = RandomUnderwater(distance=source, camera=LASERS)
    made = aug(picture(2), maps)
    assert made[0].isfinite().all()
    assert made[1] is maps


def test_a_network_in_place_of_maps() -> None:
    aug = RandomUnderwater("II", distance=Network(OPTIONS["network"]["distance"].model))
    maps = picture(2).mean(1, keepdim=True)
    by_maps = RandomUnderwater("II", distance=Inverse())
    record = aug.make_params(picture(2))
    expected = by_maps.transform(picture(2), maps, record)
    assert same(aug.transform(picture(2), None, record), expected)
    inputs = picture(2, torch.uint8), "label", "other"
    assert aug(*inputs)[1:] == inputs[1:]


def test_lamps_shine_at_any_depth() -> None:
    lamps = Light((Lamp((0.3, -0.2, 0.0), power=4.0),))
    options: Any = {"vertical_depth": 200.0, "contrast": None, "development": RAW, "waters": "II"}
    scene = picture(), 1 + distances()
    assert RandomUnderwater(**options, light=None)(*scene)[0].max() < 0.01
    aug = RandomUnderwater(**options, light=lamps)
    assert aug(*scene)[0].mean() > 0.1
    left = aug.contrast_left(*scene, aug.make_params(picture()))
    assert 0.1 < left.median() < 0.9
    assert RandomUnderwater.from_dict(aug.to_dict()).light == lamps
