"""`uwaug export` and `uwaug check`."""

import re

import numpy as np
import pytest
import torch
from exporting import stored_tensors

import uwaug


def test_export_and_check(run, tmp_path):
    pytest.importorskip("onnxruntime")
    out = tmp_path / "7C.onnx"
    options = ("--preset", "survey", "--water", "7C", "--image", "uint8", "--sides", "32", "700")
    code, stdout, stderr = run("export", *options, "--out", str(out))
    assert (code, stderr) == (0, "")
    report = rf"{re.escape(str(out))}  \(\d+ KiB\)\n    Medium\(7C: .*\n    \d blurs for σ "
    assert re.match(report, stdout)
    assert [path.name for path in tmp_path.iterdir()] == ["7C.onnx"]

    code, stdout, stderr = run("check", str(out))
    assert (code, stderr) == (0, "")
    report = rf"{re.escape(str(out))}: 102 cases, largest difference [01] of 255 \(.*×.*×.*\)\n"
    assert re.fullmatch(report, stdout)
    from uwaug.onnx import read_module

    assert read_module(out).sides == (32, 700)
    import onnx

    model = onnx.load(out)
    # weights of T_β
    wrong = next(tensor for tensor in stored_tensors(model) if list(tensor.dims)[:2] == [1, 3])
    values = onnx.numpy_helper.to_array(wrong) * np.float32(1.05)
    wrong.CopyFrom(onnx.numpy_helper.from_array(values, wrong.name))
    onnx.save(model, out)
    code, stdout, stderr = run("check", str(out))
    assert (code, stdout) == (1, "")
    assert re.fullmatch(r"Error: .*differs from float64 eager by \d+ \(limit 1\) at .*\n", stderr)


def test_export_of_a_fit(run, tmp_path):
    pytest.importorskip("onnxruntime")
    rng = torch.Generator().manual_seed(0)
    clean = 0.1 + 0.8 * torch.rand(3, 60, 80, generator=rng)
    z = torch.linspace(1, 6, 4800).reshape(1, 60, 80)
    water = uwaug.Medium.from_coefficients((0.5, 0.2, 0.3), (0.5, 0.2, 0.3), (0.1, 0.3, 0.4))
    fit = uwaug.fit(clean, uwaug.Underwater(water)(clean, z), z, model="haze")
    fit.save(tmp_path / "fit.json")
    out = tmp_path / "a.onnx"
    files = ("--fit", str(tmp_path / "fit.json"), "--out", str(out))
    code, stdout, stderr = run("export", *files, "--sides", "32", "200")
    assert (code, stderr) == (0, "")
    assert stdout.startswith(f"{out}  (")
    from uwaug.onnx import OnnxUnderwater, read_module

    module = read_module(out)
    # of distances spread over 1…6 m: .2 × the median, 1.5 × the farthest
    assert module.distance_range == pytest.approx((0.7, 1.5 * 5.75), rel=0.02)
    torch.testing.assert_close(module.medium.beta, fit.medium.beta.float(), check_dtype=False)
    expected = uwaug.Underwater(fit.medium)(clean, z)
    result = OnnxUnderwater(out)(clean[None], z[None])
    np.testing.assert_allclose(np.asarray(result)[0], expected.numpy(), atol=1e-4)
