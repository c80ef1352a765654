"""Each equation stands once."""

from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch import Tensor

import uwaug
import uwaug.formation.scene
import uwaug.optics.curves
from uwaug import fused
from uwaug.onnx.graph import Graph, Options
from uwaug.optics.point_spread import PointSpread


def doubled(function: Callable[..., Tensor]) -> Callable[..., Tensor]:
    return lambda *arguments: 2 * function(*arguments)


@pytest.mark.parametrize(
    "owner, name",
    [
        (uwaug.optics.curves, "decay"),  # e^(−rate·z), of all three curves
        (PointSpread, "sigma"),  # the width law
        (uwaug.formation.scene, "node_weights"),  # the weights of the blurs
    ],
)
def test_eager_and_graph_share_each_equation(
    owner: Any, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    module = uwaug.load_preset("survey", water="7C").module(sides=(32, 1024))
    plan = module.plan((40, 56))
    image, distance = torch.rand(1, 3, 40, 56), torch.linspace(1, 5, 40 * 56).reshape(1, 1, 40, 56)

    def eager_and_graph() -> tuple[Tensor, Tensor]:
        graph = Graph(module, Options())
        with torch.no_grad(), fused.use(False):
            eager = module.formed(image, distance, None, module.medium, plan)
            return eager, graph(image, distance)

    before, _ = eager_and_graph()
    monkeypatch.setattr(owner, name, doubled(getattr(owner, name)))
    eager, graph = eager_and_graph()
    assert (eager - before).abs().max() > 0.01
    torch.testing.assert_close(graph, eager, rtol=0, atol=2e-6)
