"""The graph in eager mode: one function with the module, at once and in strips."""

import pytest
import torch
from exporting import FAR, NEAR, apart, scene

from uwaug import (
    Development,
    Light,
    Medium,
    PointSpread,
    Underwater,
    Water,
    list_presets,
    load_preset,
)
from uwaug.blur.plan import BlurPlan
from uwaug.blur.stack import blurred
from uwaug.onnx.blurs import Blurs
from uwaug.onnx.graph import Graph, Options, parameters_of
from uwaug.onnx.scan import lengths

pytestmark = pytest.mark.filterwarnings("ignore:.* that the blur is planned for")

SIZES = [(33, 57), (150, 131), (420, 700)]


def whole(size: int) -> torch.Tensor:
    """A length in whole periods."""
    return torch.arange(-(-size // 16) * 16)


@torch.no_grad()
def in_strips(graph: Graph, *inputs: torch.Tensor, height: int = 48) -> torch.Tensor:
    """What a file computes: strips of rows, of which the last goes beyond the end."""
    given = dict(zip(graph.inputs, inputs, strict=True))
    h, w = inputs[0].shape[-2:]
    prepared = graph.before(given, whole(h), whole(w))
    rows = [torch.arange(first, first + height) for first in range(0, h, height)]
    strips = [graph.strip(given | prepared, numbers, whole(w)) for numbers in rows]
    return torch.cat(strips, 2)[:, :, :h]


@pytest.mark.parametrize("name", list_presets())
def test_module_and_graph_are_one_function(name) -> None:
    preset = load_preset(name)
    module = preset.module(sides=(32, 2160), focal_px=60.0)
    graph = Graph(module, Options())
    for size in SIZES:
        image = scene(1, *size)[0]
        distance = preset.distance(torch.linspace(0, 1, size[0] * size[1]).reshape(1, 1, *size))
        with torch.no_grad():
            expected = module(image, distance)
            assert apart(graph(image, distance), expected) <= 2e-5
        if graph.in_strips:
            assert apart(in_strips(graph, image, distance), expected) <= 2e-5


@pytest.mark.parametrize("exposure", ["none", "auto", 1.5])
@pytest.mark.parametrize("parameters", ["frozen", "inputs"])
@pytest.mark.parametrize("image", ["float32", "uint8"])
def test_what_is_chosen_is_one_function_with_its_graph(exposure, parameters, image) -> None:
    medium = Medium.from_water(Water.jerlov("1C"), vertical_depth=10.0)
    module = Underwater(medium, (NEAR, FAR), exposure=exposure, sides=(32, 2160))
    graph = Graph(module, Options(parameters, "input", image))
    rows = [x.expand(2, *x.shape[1:]) for x in parameters_of(medium).values()]
    for size in (*SIZES[:2], (1, 1), (3, 70)):
        picture, distance, field = scene(2, *size)
        picture = picture * 1.8  # beyond white
        if image == "uint8":
            picture = (picture.clamp(max=1) * 255).round().to(torch.uint8)
        inputs = (picture, distance, field, *(rows if parameters == "inputs" else ()))
        # in uint8 a level
        tolerance = 1 if image == "uint8" else 2e-5
        with torch.no_grad():
            expected = module(picture, distance, field)
            assert apart(graph(*inputs), expected) <= tolerance
        assert apart(in_strips(graph, *inputs), expected) <= tolerance


@pytest.mark.parametrize(
    "development",
    [
        Development(black_point=0.5),
        Development(white_balance=0.8),
        Development(-0.5, 0.6, 1.2, 0.4, 0.8, 1.1),
        Development(tone=0.6),
    ],
)
def test_what_a_camera_develops_is_one_function_with_its_graph(development) -> None:
    medium = Medium.from_water("II", vertical_depth=5.0, surfaces="spectral")
    module = Underwater(medium, (NEAR, FAR), sides=(32, 160), development=development)
    graph = Graph(module, Options())
    image, distance, _ = scene(2, 50, 70)
    expected = module(image, distance)
    assert apart(graph(image, distance), expected) <= 2e-5
    assert apart(in_strips(graph, image, distance), expected) <= 2e-5
    given = {"image": image, "distance": distance}
    prepared = graph.before(given, whole(50), whole(70))
    # a file names this size once, for pictures and for what is prepared of them
    assert all(len(prepared[name]) == 2 for name in ("weights", "black") if name in prepared)


def test_what_is_learned_is_one_function_with_its_graph() -> None:
    medium = Medium.from_water(Water.jerlov("3C"), point_spread=PointSpread.paper())
    module = Underwater(medium, (NEAR, FAR), learnable=True, sides=(32, 160))
    with torch.no_grad():
        for parameter in module.parameters():
            parameter += 0.1
        # beyond what was planned at the start
        module.coefficients.raw_scale += 8.0
    image, distance, _ = scene(1, 150, 131)
    graph = Graph(module, Options())
    expected = module(image, distance).detach()
    assert apart(graph(image, distance), expected) <= 2e-5
    assert apart(expected, Underwater(medium, (NEAR, FAR))(image, distance)) > 0.01


@pytest.mark.parametrize("law", [PointSpread.none(), PointSpread(4.0, 1e-3)])
def test_no_blur_and_one_blur(law) -> None:
    beta, G, veil = (1.0, 0.8, 0.9), (0.4, 0.3, 0.5), (0.1, 0.3, 0.4)
    medium = Medium.from_coefficients(beta, G, veil, b_mean=0.5, point_spread=law)
    module = Underwater(medium, (1.0, 4.0))
    graph = Graph(module, Options())
    assert graph.plan == module.plan((512, 512))
    assert len(graph.plan.sigmas) == 1
    image, distance, _ = scene(2, 50, 37)
    assert apart(graph(image, distance), module(image, distance)) <= 2e-5
    assert apart(in_strips(graph, image, distance), module(image, distance)) <= 2e-5


CELLS = (1.0, 16 / 9, 2.0, 16 / 7, 16 / 5, 4.0, 8.0, 16.0, 32.0, 48.0, 400.0)


@pytest.mark.parametrize("cells", [*((cell,) for cell in CELLS), (1.0, 1.0, *CELLS)])
def test_blurs_of_the_graph_are_those_of_the_stack(cells) -> None:
    """Each alone, and all together with none and a narrow one, which have margins of their own."""
    sigmas = tuple(1.3 if cell == 1 else 1.2 * cell for cell in cells)
    if len(cells) > 1:
        sigmas = (0.0, 0.5, *sigmas[2:])
    plan = BlurPlan(min(sigmas), max(sigmas), sigmas, cells, ((1.0,),) * len(cells), 3.0, 1e-3)
    blurs = Blurs(plan)
    sizes = [(1, 1), (2, 40), (15, 16), (17, 31), (33, 32), (64, 101)]
    for h, w in sizes + [(n, 41 - n) for n in range(3, 30, 4)]:
        image = torch.rand(2, 3, h, w, generator=torch.Generator().manual_seed(h))
        prepared = blurs.before(image, whole(h), whole(w))
        for first, last in ((0, len(whole(h))), (16, 32)):
            light, stack = blurs.strip(prepared, torch.arange(first, last), whole(w))
            rows = slice(first, min(last, h))
            count = max(rows.stop - first, 0)
            assert torch.equal(light[:, :, :count], image[:, :, rows])
            for result, expected in zip(stack, blurred(image.double(), plan), strict=True):
                result = result[:, :, :count].double()
                torch.testing.assert_close(result, expected[:, :, rows], rtol=0, atol=2e-6)


@pytest.mark.parametrize(
    ("batch", "size"),
    [
        (1, (1, 1)),
        (1, (17, 3)),
        (3, (256, 256)),
        (1, (1, 70_001)),
        (1, (70_001, 1)),
        (2, (363, 517)),
        (1, (2160, 3840)),
        (1, (33, 40_000)),
    ],
)
def test_strips_cover_a_picture_once(batch, size) -> None:
    onnx = pytest.importorskip("onnx", minversion="1.17")
    ort = pytest.importorskip("onnxruntime")
    helper, kinds = onnx.helper, onnx.TensorProto
    names = ("down", "across", "strips", "places")
    picture = helper.make_tensor_value_info("image", kinds.UINT8, [None, 3, None, None])
    outputs = [helper.make_tensor_value_info(name, kinds.INT64, None) for name in names]
    graph = helper.make_graph(lengths(), "lengths", [picture], outputs)
    opset = helper.make_opsetid("", 18)
    model = helper.make_model(graph, opset_imports=[opset], ir_version=8)
    session = ort.InferenceSession(model.SerializeToString())
    image = torch.zeros(batch, 3, *size, dtype=torch.uint8)
    down, across, strips, places = map(
        torch.from_numpy, session.run(None, {"image": image.numpy()})
    )
    h, w = size
    assert torch.equal(down, whole(h))
    assert torch.equal(across, whole(w))
    count, height = strips.shape
    assert (count - 1) * height < h <= count * height
    assert height % 16 == 0
    # about as large as planned, where a period of rows is
    assert batch * height * w < 65_536 + 16 * batch * w
    number = torch.arange(batch * 3 * h).reshape(batch, 3, h)
    rows = torch.stack([number.index_select(2, strip.clamp(max=h - 1)) for strip in strips])
    assert torch.equal(rows.flatten()[places], number)


MEDIUM = Medium.from_water("7C", vertical_depth=10.0)
LAMP = Light.lamp((0.3, -0.2, 0.0), (-0.05, 0.05, 1.0), power=4.0, cone=40.0)
TWO = Light.lamp((0, 0, 0), (0, 0, 1), power=torch.ones(2))


@pytest.mark.parametrize(
    ("options", "choices", "message"),
    [
        ({"distance_range": None}, {}, "module has no distance_range"),
        ({"order": "source"}, {}, "must be 'line_of_sight'"),
        ({"medium": Medium.stack([MEDIUM] * 2)}, {}, "module holds 2 media"),
        ({"light": LAMP}, {"parameters": "inputs"}, r"must be .frozen. where module\.light"),
        ({"light": LAMP, "exposure": "auto"}, {}, "exposure is 'auto', which a file with a light"),
        ({"light": TWO}, {}, "light is for 2 pictures"),
        (
            {"sides": None, "medium": load_preset("survey").medium},
            {},
            r"module has no sides and .*: give Underwater\(…, sides=\(32, 2160\)\), so that",
        ),
    ],
)
def test_modules_that_cannot_be_exported(options, choices, message) -> None:
    options = {"medium": MEDIUM, "distance_range": (1.0, 5.0), "sides": (32, 64), **options}
    if options["distance_range"] is None:
        options["sides"] = None
    module = Underwater(**options, focal_px=70.0)
    with pytest.raises(ValueError, match=message):
        Graph(module, Options(**choices))


def test_what_is_no_module_is_refused() -> None:
    with pytest.raises(TypeError, match=r"module must be a uwaug\.Underwater, got Medium"):
        Graph(MEDIUM, Options())
