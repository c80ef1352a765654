import copy
import multiprocessing
import pickle
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from exporting import Pictures, apart, bare, scene
from torch.utils.data import DataLoader

from uwaug import Medium, Underwater, form_image, load_preset
from uwaug.onnx import OnnxUnderwater
from uwaug.onnx.graph import Options

# by its version: without the package, "onnx" would be the folder of these tests
pytest.importorskip("onnx", minversion="1.17")
pytest.importorskip("onnxruntime")


def test_a_file_of_surfaces_with_spectra_takes_media_whose_channels_do_not_mix(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mixing = Medium.from_water("II", vertical_depth=2.0, surfaces="spectral")
    plain = Medium.from_water("9C", vertical_depth=30.0, surfaces="spectral")
    assert mixing.is_spectral
    assert not plain.is_spectral
    module = Underwater(mixing, (0.5, 5.0), sides=(16, 64))
    run = OnnxUnderwater(bare(tmp_path / "a.onnx", module, Options("inputs")))
    given: dict[str, torch.Tensor] = {}
    monkeypatch.setattr(run, "session", lambda rows: given.update(rows) or rows["image"])
    image, distance, _ = scene(1)
    run(image, distance, medium=plain)
    again = Medium.of({name: given[name] for name in plain.parameters()}, mixing)
    assert again.is_spectral
    expected = form_image(image, distance, plain).image
    torch.testing.assert_close(form_image(image, distance, again).image, expected)
    grey = Underwater(plain, (0.5, 5.0), sides=(16, 64))
    run = OnnxUnderwater(bare(tmp_path / "b.onnx", grey, Options("inputs")))
    with pytest.raises(ValueError, match="grey surfaces, got one of surfaces with spectra"):
        run(image, distance, medium=mixing)


def test_runner_refuses_what_the_file_does_not_take(frozen, waters) -> None:
    image, distance, field = scene(2)
    run, serve = OnnxUnderwater(frozen[0]), OnnxUnderwater(waters[0])
    medium = load_preset("survey").medium
    message = "field: the file takes none, as it was exported with field='none'"
    with pytest.raises(ValueError, match=message):
        run(image, distance, field)
    with pytest.raises(ValueError, match="medium: the file takes none"):
        run(image, distance, medium=medium)
    with pytest.raises(ValueError, match="field: the file needs one"):
        serve(image, distance, medium=medium)
    message = "medium: the file needs one, as it was exported with parameters='inputs'"
    with pytest.raises(ValueError, match=message):
        serve(image, distance, field)
    law = replace(medium.point_spread, reference_size=None)
    message = r"medium: its point spread is .* but the file is for shape"
    with pytest.raises(ValueError, match=message):
        serve(image, distance, field, replace(medium, point_spread=law))
    message = r"its point spread is exponential .* but the file is for shape 'gaussian'"
    with pytest.raises(ValueError, match=message):
        serve(image, distance, field, load_preset("calibrated").medium)
    message = r"image must be torch\.float32 for this file, got torch\.uint8"
    with pytest.raises(TypeError, match=message):
        run(image.to(torch.uint8), distance)
    with pytest.raises(ValueError, match=r"distance is \(45, 61\) but image is \(45, 62\)"):
        run(image, distance[..., 1:])
    with pytest.raises(ValueError, match="image must have shape"):
        run(image[:, :2], distance)
    with pytest.raises(ValueError, match="distance is NaN at 5580 and negative at 0 of 5580"):
        run(image, distance * torch.nan)
    with pytest.raises(ValueError, match="batch sizes must agree or be 1"):
        run(torch.cat([image, image[:1]]), distance)


# the lens itself and open water are among the cases
@pytest.mark.filterwarnings("ignore:.* of the pixels lie:UserWarning")
def test_runner_refuses_what_the_module_refuses(waters, lamp) -> None:
    path, module = waters
    image, distance, field = scene(1)
    bad = {"NaN": torch.nan, "negative": -1.0, "infinite": torch.inf}
    cases = []
    for value in bad.values():
        for name in ("distance", "field"):
            given = {"image": image, "distance": distance, "field": field}
            given[name] = given[name].clone()
            given[name][..., 3, 4] = value
            cases.append(given)
    cases.append({"image": image, "distance": distance.int(), "field": field})
    cases.append({"image": image, "distance": distance, "field": field.long()})
    cases.append({"image": image, "distance": 0 * distance, "field": field})
    cases.append({"image": image, "distance": distance, "field": torch.cat([field] * 2)})
    run, alone = OnnxUnderwater(path), module.medium[0]
    eager = Underwater(alone, module.distance_range, color_space="linear", sides=module.sides)
    refused = 0
    for given in cases:
        said = []
        for call in (eager, lambda **kw: run(**kw, medium=alone)):
            try:
                call(**given)
                said.append(None)
            except (TypeError, ValueError) as error:
                said.append((type(error), str(error)))
        assert said[0] == said[1]
        refused += said[0] is not None
    # open water and the lens itself are no mistakes, nor is a field for each image of a batch
    assert refused == len(cases) - 3
    # values of a file's own type, but of another scale
    of_bytes = OnnxUnderwater(lamp[0])
    message = r"image must be torch\.uint8 for this file, got torch\.float32"
    with pytest.raises(TypeError, match=message):
        of_bytes(image, distance, field)
    with pytest.raises(TypeError, match=r"image must be .* for this file, got ndarray"):
        of_bytes(image.numpy(), distance, field)


def test_a_picture_of_0_to_255_is_refused(frozen) -> None:
    image, distance, _ = scene(1)
    with pytest.raises(ValueError, match=r"image reaches 2.*divide a 0…255 image by 255"):
        OnnxUnderwater(frozen[0])(255 * image, distance)


def test_runner_has_the_shapes_of_the_module(frozen) -> None:
    path, module = frozen
    run = OnnxUnderwater(path)
    image, distance, _ = scene(2)
    for i, d in (
        (image, distance),
        (image[:1], distance),
        (image, distance[0]),
        (image[0], distance[0]),
        (image[0], distance),
        (image[0], distance[:1]),
        (image[:0], distance[:0]),
        (image[..., :0], distance[..., :0]),
    ):
        assert run(i, d).shape == module(i, d).shape
    assert str(module.medium) in repr(run)


@pytest.mark.parametrize(
    "copied", [copy.deepcopy, lambda r: pickle.loads(pickle.dumps(r))], ids=["deepcopy", "pickle"]
)
def test_runner_copies_after_use(frozen, copied) -> None:
    image, distance, _ = scene(1)
    run = OnnxUnderwater(frozen[0], threads=1)
    before = run(image, distance)
    again = copied(run)
    assert again.session._opened is None
    assert torch.equal(again(image, distance), before)


def test_runner_in_a_worker(frozen) -> None:
    run = OnnxUnderwater(frozen[0], threads=1)
    options = {"batch_size": 2, "num_workers": 1, "multiprocessing_context": "spawn"}
    loader = DataLoader(Pictures(run), **options)
    image, distance, _ = scene(4)
    assert apart(torch.cat(list(loader)), run(image, distance)) == 0


def test_waiting_threads_do_not_spin(frozen) -> None:
    """They would take half the speed of what runs beside them."""
    options = OnnxUnderwater(frozen[0], threads=2).session.opened.get_session_options()
    assert options.get_session_config_entry("session.intra_op.allow_spinning") == "0"


def test_a_forked_process_opens_its_own(frozen) -> None:
    """What it inherits has no threads."""
    run, (image, distance, _) = OnnxUnderwater(frozen[0], threads=2), scene(1)
    wanted = run(image, distance)
    found: Any = multiprocessing.get_context("fork").Queue()
    work = multiprocessing.get_context("fork").Process(
        target=lambda: found.put(run(image, distance).numpy())
    )
    work.start()
    assert apart(torch.from_numpy(found.get(timeout=60)), wanted) == 0
    work.join(60)
    assert work.exitcode == 0
