"""An ONNX model that loops over strips of rows.

ONNX Runtime runs one operator after the other, each on all of its data, and a picture of 1024²
leaves the caches between any two of them. A file therefore does what is done once on the whole
picture, and then strips of rows in the body of a loop (Scan). The two parts are traced side by side
and taken apart here: with torch's own `scan` to export takes three times as long.
"""

from typing import Any

from uwaug.blur.kernels import PERIOD

_STRIP = 65_536
"""Pixels of a strip of a whole batch, about; with twice or half as many, 512² and 1024² take as
long within the noise, and with one strip for all, 1024² takes 1.5 times as long.
"""


STRIP = "strip_"
"""Begins the names of what the second part takes."""


def join(model: Any, prepared: list[str]) -> None:
    """Make one function of an ONNX model of two parts, in place.

    Args:
        model: its first part takes the picture, `down` and `across`, and gives `prepared`. Its
            second takes the rows of a strip and values of the first by their names, each name after
            `STRIP`, and gives a strip as `output`.
        prepared: names of the outputs of the first part.
    """
    from onnx import helper

    graph = model.graph
    first = _made_for(graph, prepared)
    # what both need, such as constants, a loop sees from without
    body = [node for node in _made_for(graph, ["output"]) if node not in first]
    for node in body:
        for i, name in enumerate(node.input):
            if name != f"{STRIP}rows":
                node.input[i] = name.removeprefix(STRIP)
    rows = [value for value in graph.input if value.name == f"{STRIP}rows"]
    strip = [value for value in graph.output if value.name == "output"]
    kind = strip[0].type.tensor_type.elem_type
    loop = helper.make_graph(body, "strip", rows, strip)
    last = [
        helper.make_node("Scan", ["strips"], ["stack"], body=loop, num_scan_inputs=1),
        helper.make_node("Flatten", ["stack"], ["lines"], axis=4),
        helper.make_node("Gather", ["lines", "places"], ["output"], axis=0),
    ]
    inputs = [
        value
        for value in graph.input
        if value.name not in ("down", "across") and not value.name.startswith(STRIP)
    ]
    del graph.node[:], graph.input[:], graph.output[:]
    graph.node.extend([*lengths(), *first, *last])
    graph.input.extend(inputs)
    graph.output.append(helper.make_tensor_value_info("output", kind, [None, 3, None, None]))


def _made_for(graph: Any, names: list[str]) -> list[Any]:
    """The nodes that lead to some values, in order."""
    wanted, nodes = set(names), []
    for node in reversed(graph.node):
        if wanted.intersection(node.output):
            wanted.update(node.input)
            nodes.append(node)
    return nodes[::-1]


def lengths() -> list[Any]:
    """The ONNX nodes that measure `image` (B×3×H×W).

    They give `down` and `across`, numbers of rows and of columns in whole periods; `strips` (N×R),
    the rows of each strip: whole periods, which may go beyond the picture's end; and `places`
    (B×3×H), where the picture's rows are among those of all strips (N×B×3×R).
    """
    from onnx import helper

    nodes: list[Any] = []

    def op(kind: str, *inputs: str | int, name: str | None = None, **attributes: Any) -> str:
        """A node's only result, of names or numbers."""
        names = [x if isinstance(x, str) else op("Constant", value_int=x) for x in inputs]
        name = name or f"length_{len(nodes)}"  # after those of its inputs
        nodes.append(helper.make_node(kind, names, [name], **attributes))
        return name

    def up(n: str, to: str | int) -> str:
        """How many of a length cover n."""
        return op("Div", op("Add", n, op("Sub", to, 1)), to)

    def count(n: str | int, name: str | None = None) -> str:
        """0…n − 1."""
        return op("Range", 0, n, 1, name=name)

    shape = op("Shape", "image")
    batch, height, width = (op("Gather", shape, axis) for axis in (0, 2, 3))
    count(op("Mul", up(height, PERIOD), PERIOD), "down")
    count(op("Mul", up(width, PERIOD), PERIOD), "across")
    about = up(op("Mul", op("Mul", batch, height), width), _STRIP)
    tall = op("Mul", up(height, op("Mul", about, PERIOD)), PERIOD)
    first = op("Mul", count(up(height, tall)), tall)  # none lies beyond the end
    column = op("Constant", value_ints=[-1, 1])
    op("Add", op("Reshape", first, column), count(tall), name="strips")
    planes, row = op("Mul", batch, 3), count(height)
    within = op("Mod", row, tall)
    line = op("Add", op("Mul", op("Sub", row, within), planes), within)
    planes = op("Mul", count(planes), tall)
    planes = op("Reshape", planes, op("Constant", value_ints=[-1, 3, 1]))
    op("Add", planes, line, name="places")
    return nodes
