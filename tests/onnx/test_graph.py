import numpy as np
import pytest
import torch
from exporting import FAR, NEAR, PAPERS, apart, eager, scene

from uwaug import JERLOV_TYPES, Medium, PointSpread, Underwater, Water, list_presets, load_preset
from uwaug.blur.plan import BlurPlan
from uwaug.blur.stack import blurred
from uwaug.onnx import OnnxUnderwater, check_onnx, export_onnx, read_metadata, read_module
from uwaug.onnx.blurs import blur_of
from uwaug.onnx.graph import Graph, parameters_of
from uwaug.onnx.metadata import plan_of

# by its version: without the package, "onnx" would be the folder of these tests
pytest.importorskip("onnx", minversion="1.17")
onnxruntime = pytest.importorskip("onnxruntime")


@pytest.mark.parametrize("name", JERLOV_TYPES)
def test_one_file_serves_every_type(waters, name) -> None:
    path, module = waters
    image, distance, field = scene()
    medium = load_preset("survey", water=name).medium
    got = OnnxUnderwater(path, threads=1)(image, distance, field, medium)
    expected = eager(path, module, image, distance, field=field, medium=medium)
    assert apart(got, expected) <= 1e-5
    assert apart(got, image) > 0.05


@pytest.mark.parametrize("name", PAPERS)
def test_one_file_serves_every_preset(waters, name) -> None:
    path, module = waters
    preset = load_preset(name)
    image, _, field = scene(1, 40, 53)
    generator = torch.Generator().manual_seed(1)
    distance = preset.distance(torch.rand(1, 1, 40, 53, generator=generator))
    got = OnnxUnderwater(path, threads=1)(image, distance, field, preset.medium)
    expected = eager(path, module, image, distance, field=field, medium=preset.medium)
    assert apart(got, expected) <= 1e-5


def test_a_medium_for_each_image(waters) -> None:
    path, module = waters
    image, distance, field = scene(3)
    media = Medium.stack([load_preset("survey", water=name).medium for name in ("I", "3C", "9C")])
    run = OnnxUnderwater(path)
    got = run(image, distance, field, media)
    expected = eager(path, module, image, distance, field=field, medium=media)
    assert apart(got, expected) <= 1e-5
    for i in range(3):
        row = slice(i, i + 1)
        alone = run(image[row], distance[row], field[row], media[i])
        assert apart(got[row], alone) == 0
    one = run(image[0], distance[0], field[0], media)
    assert one.shape == image.shape
    assert run(image[0], distance[0], field[0], media[0]).shape == image[0].shape


SIDES = [(33, 57), (150, 131), (420, 700)]


@pytest.mark.parametrize("name", list_presets())
def test_module_and_graph_are_one_function(name) -> None:
    preset = load_preset(name)
    module = preset.module(sides=(32, 2160), focal_px=60.0)
    graph = Graph(module, plan_of(module), frozen=True, field=False, quantised=False)
    for size in SIDES:
        image = scene(1, *size)[0]
        distance = preset.distance(torch.linspace(0, 1, size[0] * size[1]).reshape(1, 1, *size))
        with torch.no_grad():
            assert apart(graph(image, distance), module(image, distance)) <= 2e-5


# beyond the planned distances too
@pytest.mark.filterwarnings("ignore:.* that the blur is planned for")
@pytest.mark.parametrize("name", ["frozen", "calibrated", "quantised"])
def test_module_and_file_are_one_function(request, name) -> None:
    path, module = request.getfixturevalue(name)
    run, again = OnnxUnderwater(path), read_module(path)
    for size in SIDES:
        image, distance, field = scene(1, *size)
        maps: tuple[torch.Tensor, ...] = (distance,)
        if name == "quantised":
            image, maps = (image * 255).round().to(torch.uint8), (distance, field)
        expected = module(image, *maps)
        assert apart(run(image, *maps), expected) <= (1 if name == "quantised" else 2e-5)
        assert torch.equal(again(image, *maps), expected)


@pytest.mark.parametrize("exposure", ["auto", 1.5])
def test_an_exposure_is_one_function_with_its_graph(exposure) -> None:
    medium = Medium.from_water(Water.jerlov("1C"), vertical_depth=10.0)
    module = Underwater(medium, (NEAR, FAR), exposure=exposure, sides=(32, 2160))
    graph = Graph(module, plan_of(module), frozen=True, field=False, quantised=False)
    for size in SIDES:
        image, distance, _ = scene(2, *size)
        with torch.no_grad():
            assert apart(graph(image, distance), module(image, distance)) <= 2e-5


def test_what_is_learned_is_one_function_with_its_file(folder) -> None:
    medium = Medium.from_water(Water.jerlov("3C"), point_spread=PointSpread.paper())
    module = Underwater(medium, (NEAR, FAR), learnable=True, sides=(32, 160))
    with torch.no_grad():
        for parameter in module.parameters():
            parameter += 0.1
        # beyond what was planned at the start
        module.coefficients.raw_scale += 8.0
    path = export_onnx(module, folder / "learned-graph.onnx", verify=False)
    image, distance, _ = scene(1, 150, 131)
    expected = module(image, distance).detach()
    assert apart(OnnxUnderwater(path)(image, distance), expected) <= 2e-5
    assert apart(read_module(path)(image, distance), expected) <= 2e-5
    assert apart(expected, Underwater(medium, (NEAR, FAR))(image, distance)) > 0.01


def test_a_field_of_any_numbers_gives_a_picture(quantised) -> None:
    # the graph cannot raise: what is negative counts as 0, as in distances
    path, module = quantised
    session = onnxruntime.InferenceSession(path)
    image, distance, field = scene(1)
    levels = (image * 255).round().to(torch.uint8)
    field[..., :9], distance[..., 5:20], field[..., 15:30] = -1.0, torch.inf, torch.inf
    distance[..., 25:40] = 0.0
    given = {"image": levels.numpy(), "distance": distance.numpy(), "field": field.numpy()}
    (got,) = session.run(None, given)
    z = distance.clamp(max=1e9) * field.clamp(0, 1e9)
    assert apart(torch.from_numpy(got), module(levels, z)) <= 1


@pytest.mark.parametrize("size", [(1, 1), (1, 7), (200, 3), (64, 64), (99, 131)])
def test_frozen_file_at_other_sizes(frozen, size) -> None:
    path, module = frozen
    image, distance, _ = scene(1, *size)
    got = OnnxUnderwater(path, threads=1)(image, distance)
    assert apart(got, eager(path, module, image, distance)) <= 1e-5
    assert apart(got, module(image, distance)) <= 2e-5


@pytest.mark.parametrize("size", [(1, 70_001), (363, 517)])
def test_strips_are_one_picture(waters, size) -> None:
    """Two strips and more, the last of which goes beyond the end; a batch at once too."""
    path, module = waters
    image, distance, field = scene(2, *size)
    media = Medium.stack([load_preset("survey", water=name).medium for name in ("II", "9C")])
    run = OnnxUnderwater(path, threads=1)
    wanted = eager(path, module, image, distance, field=field, medium=media)
    got = run(image, distance, field, media)
    assert apart(got, wanted) <= 1e-5
    given = {"image": image, "distance": distance, "field": field, **parameters_of(media)}
    assert apart(run.session(given), wanted) <= 1e-5


def test_uint8(quantised, encoded) -> None:
    image, distance, field = scene(2)
    levels = (image * 255).round().to(torch.uint8)
    path, module = quantised
    got = OnnxUnderwater(path)(levels, distance, field)
    assert got.dtype == torch.uint8
    assert apart(got, eager(path, module, levels, distance, field=field)) <= 1
    path, module = encoded
    medium = Medium.from_water(Water.jerlov("9C"), point_spread=PointSpread(1.0, 0.8))
    got = OnnxUnderwater(path)(levels, distance, medium=medium)
    assert apart(got, eager(path, module, levels, distance, medium=medium)) <= 1
    assert apart(got, levels) > 20


def test_singular_distances(frozen) -> None:
    path, module = frozen
    image, distance, _ = scene(1, 40, 40)
    run = OnnxUnderwater(path)
    far = torch.full_like(distance, torch.inf)
    open_water = module.medium.veil_weights.sum(-1).float()[..., None, None].expand_as(image)
    assert apart(run(image, far), open_water) < 1e-6
    at_lens = run(image, torch.zeros_like(distance))
    assert apart(at_lens, eager(path, module, image, 0 * distance)) < 1e-6
    # beyond the planned range widths stop growing, curves stay exact: the same in both
    for z in (1e-3, 0.1, 20.0, 1e3):
        z = torch.full_like(distance, z)
        assert apart(run(image, z), eager(path, module, image, z)) <= 1e-5
    # the graph cannot raise
    session = onnxruntime.InferenceSession(path)
    below, unknown = distance.clone(), distance.clone()
    below[..., :20, :], unknown[..., 3, 4] = -1.0, torch.nan
    (got,) = session.run(None, {"image": image.numpy(), "distance": below.numpy()})
    assert apart(torch.from_numpy(got), eager(path, module, image, below.clamp(min=0))) <= 1e-5
    (got,) = session.run(None, {"image": image.numpy(), "distance": unknown.numpy()})
    assert np.argwhere(np.isnan(got)).tolist() == [[0, c, 3, 4] for c in range(3)]


def test_no_blur_and_one_blur(folder) -> None:
    beta, G, veil = (1.0, 0.8, 0.9), (0.4, 0.3, 0.5), (0.1, 0.3, 0.4)
    for law, sigmas in ((PointSpread.none(), (0.0,)), (PointSpread(4.0, 1e-3), None)):
        medium = Medium.from_coefficients(beta, G, veil, b_mean=0.5, point_spread=law)
        module = Underwater(medium, (1.0, 4.0))
        plan = module.plan((512, 512))
        if sigmas:
            assert plan.sigmas == sigmas
        else:
            assert min(plan.sigmas) > 1
            assert len(plan.sigmas) <= 2
        path = export_onnx(module, folder / "few.onnx")
        assert read_metadata(path)["uwaug_plan"] == str(plan)
        assert check_onnx(path, read_module(path)).worst < 1e-5


CELLS = [1.0, 16 / 9, 2.0, 16 / 7, 16 / 5, 4.0, 8.0, 16.0, 32.0, 48.0, 400.0]
SIZES = [(1, 1), (2, 40), (15, 16), (17, 31), (33, 32), (64, 101)]
SIZES += [(n, 41 - n) for n in range(3, 30, 4)]


@pytest.mark.parametrize("cell", CELLS)
def test_blurs_of_the_graph_are_those_of_the_stack(cell) -> None:
    sigma = 1.3 if cell == 1 else 1.2 * cell
    plan = BlurPlan(sigma, sigma, (sigma,), (cell,), ((1.0,),), 3.0, 1e-3)
    for h, w in SIZES:
        image = torch.rand(2, 3, h, w, generator=torch.Generator().manual_seed(h))
        got = blur_of(sigma, cell, 3.0)(image).double()
        (expected,) = blurred(image.double(), plan)
        torch.testing.assert_close(got, expected, rtol=0, atol=2e-6)
