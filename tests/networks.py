"""Tiny ONNX files that stand for depth networks."""

import onnx
from onnx import TensorProto, helper


def save(path, nodes, shape, output_rank=3, kind=TensorProto.FLOAT, constants=()) -> str:
    """Save a network that maps input "x" of the given shape to output "y"."""
    x = helper.make_tensor_value_info("x", kind, shape)
    y = helper.make_tensor_value_info("y", TensorProto.FLOAT, [None] * output_rank)
    axis = helper.make_tensor("axis", TensorProto.INT64, [1], [1])
    graph = helper.make_graph(nodes, "network", [x], [y], [axis, *constants])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=9)
    onnx.checker.check_model(model)
    onnx.save(model, path)
    return str(path)


def mean_of_channels(path, shape=(1, 3, "h", "w"), keepdims=0) -> str:
    mean = helper.make_node("ReduceMean", ["x", "axis"], ["y"], keepdims=keepdims)
    return save(path, [mean], shape, 3 + keepdims)
