"""Strips of rows inside a graph, so that what a pixel does by itself stays in the caches.

ONNX Runtime runs one operator after the other, each on all of its data, and a picture of 1024²
leaves the caches between any two of them. A file therefore has two graphs: one of what is done once
on the whole picture, and the body of a loop (Scan) over strips. They are traced one by one: with
torch's own `scan` to export takes three times as long.
"""

from typing import Any, NamedTuple

import torch
from torch import Tensor

from uwaug.blur.kernels import PERIOD, reflect

__all__ = ["PICTURE", "Rows", "joined", "strips_of"]

_STRIP = 65_536
"""Pixels of a strip of a whole batch, about; with twice or half as many, 512² and 1024² take as
long within the noise, and with one strip for all, 1024² takes 1.5 times as long.
"""


class Rows(NamedTuple):
    """The rows of a tensor that a strip is made of.

    Attributes:
        each: so many for a period of the strip.
        above: where they begin, before the strip's first, ≤ 0.
        below: so many beyond those of its periods.
    """

    each: int
    above: int
    below: int

    def of(self, x: Tensor, strip: Tensor) -> Tensor:
        """Those of x (BxCxHxW) for a strip of whole periods of rows, given by their numbers (R);
        beyond its edges half-sample symmetric, where a pixel needs them.
        """
        count = strip.shape[0] // PERIOD * self.each
        first = strip[:1] // PERIOD * self.each
        wanted = first + torch.arange(self.above, count + self.below)
        if self.above < 0:
            return x.index_select(2, reflect(wanted, x.shape[2]))
        # what lies beyond the end is no pixel's
        return x.index_select(2, wanted.clamp(max=x.shape[2] - 1))


PICTURE = Rows(PERIOD, 0, 0)
"""Those of the picture itself."""


def strips_of(batch: int, size: tuple[int, int]) -> tuple[Tensor, Tensor]:
    """A picture of (height, width) `size` in strips of whole periods, which may go beyond its end.

    Returns:
        the rows of each strip (NxR); and where, among the rows of all strips (NxBx3xR), those of
        the pictures (Bx3xH) are.
    """
    h, w = size
    count = (batch * h * w + _STRIP - 1) // _STRIP
    count = torch.sym_max(count, 1)  # type: ignore[no-untyped-call]
    height = (h + PERIOD * count - 1) // (PERIOD * count) * PERIOD
    count = (h + height - 1) // height  # none lies beyond the end
    rows = torch.arange(count)[:, None] * height + torch.arange(height)
    row, tall = torch.arange(h), torch.full((1,), height, dtype=torch.int64)
    within = torch.remainder(row, tall)
    planes = (torch.arange(3 * batch) * height).reshape(batch, 3, 1)
    return rows, (row - within) * (3 * batch) + within + planes


def joined(whole: Any, strip: Any) -> Any:
    """Two ONNX models as one, which is `whole`, changed.

    Args:
        whole: gives the two tensors of `strips_of`, then all that `strip` takes but its rows.
        strip: makes a strip of its rows (R) and the rest.
    """
    from onnx import compose, helper

    strip = compose.add_prefix(strip, "strip_")
    known = [entry.domain for entry in whole.opset_import]
    whole.opset_import.extend(one for one in strip.opset_import if one.domain not in known)
    whole.functions.extend(strip.functions)
    body = strip.graph
    rows, places, *shared = (value.name for value in whole.graph.output)
    names = {one.name: name for one, name in zip(body.input[1:], shared, strict=True)}
    for node in body.node:
        for i, name in enumerate(node.input):
            node.input[i] = names.get(name, name)
    for node in list(whole.graph.node):
        # the exporter hands on an input as an Identity of the same name, which ONNX forbids
        if list(node.input) == list(node.output):
            whole.graph.node.remove(node)
    del body.input[1:]
    scan = helper.make_node("Scan", [rows], ["strips"], body=body, num_scan_inputs=1)
    flat = helper.make_node("Flatten", ["strips"], ["lines"], axis=4)
    result = helper.make_node("Gather", ["lines", places], ["output"], axis=0)
    whole.graph.node.extend([scan, flat, result])
    kind = body.output[0].type.tensor_type.elem_type
    del whole.graph.output[:]
    whole.graph.output.append(helper.make_tensor_value_info("output", kind, [None, 3, None, None]))
    return whole
