"""ONNX networks whose flow is a known function of their inputs."""

import onnx
from onnx import TensorProto, helper

WAYS_IN = {"pair": ("n", 3), "stacked": ("n", 2, 3), "concatenated": ("n", 6)}


def channels(
    path,
    *,
    layout="pair",
    batch="n",
    size=("h", "w"),
    flip=False,
    channels_last=False,
    kind=TensorProto.FLOAT,
    names=("image1", "image2"),
    more_outputs=(),
):
    """Save a network whose u is the first channel of frame 1, and whose v is the third channel of frame 2.

    Args:
        path: file to write.
        layout: input layout of the pair.
        batch, size: input dimensions, as numbers or as names of dynamic dimensions.
        flip: whether to flip the flow vertically and horizontally, so that padding errors are visible after cropping.
        channels_last: whether the output is (N, H, W, 2).
        kind: element type of the tensors.
        names: names of the two inputs.
        more_outputs: names of additional outputs before the flow, each of which is a copy of frame 1.
    """
    shape = [batch, *WAYS_IN[layout][1:], *size]
    pair = layout == "pair"
    inputs = [helper.make_tensor_value_info(name, kind, shape) for name in (names if pair else ("images",))]
    nodes, constants = [], []

    def constant(name, values):
        constants.append(helper.make_tensor(name, TensorProto.INT64, [len(values)], values))
        return name

    if layout == "stacked":
        both = [helper.make_node("Gather", ["images", constant(f"i{i}", [i])], [f"f{i}"], axis=1) for i in range(2)] + [
            helper.make_node("Squeeze", [f"f{i}", constant(f"a{i}", [1])], [f"frame{i}"]) for i in range(2)
        ]
        nodes += both
        first, second, third = "frame0", "frame1", 2
    elif layout == "concatenated":
        first, second, third = "images", "images", 5
    else:
        first, second, third = *names, 2
    nodes += [
        helper.make_node("Gather", [first, constant("u_channel", [0])], ["u"], axis=1),
        helper.make_node("Gather", [second, constant("v_channel", [third])], ["v"], axis=1),
        helper.make_node("Concat", ["u", "v"], ["uv"], axis=1),
    ]
    last = "uv"
    if flip:
        ends = [
            constant(name, values)
            for name, values in (
                ("starts", [-1, -1]),
                ("ends", [-(2**31), -(2**31)]),
                ("axes", [2, 3]),
                ("steps", [-1, -1]),
            )
        ]
        nodes.append(helper.make_node("Slice", [last, *ends], ["flipped"]))
        last = "flipped"
    nodes.append(helper.make_node("Transpose", [last], ["flow"], perm=[0, 2, 3, 1] if channels_last else [0, 1, 2, 3]))
    flow_shape = [batch, *size, 2] if channels_last else [batch, 2, *size]
    outputs = [helper.make_tensor_value_info(name, kind, shape) for name in more_outputs]
    nodes += [helper.make_node("Identity", [inputs[0].name], [name]) for name in more_outputs]
    outputs.append(helper.make_tensor_value_info("flow", kind, flow_shape))
    return save(path, inputs, nodes, outputs, constants)


def save(path, inputs, nodes, outputs, constants=()):
    graph = helper.make_graph(nodes, "network", inputs, outputs, list(constants))
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9)
    onnx.save(model, str(path))
    return path


def with_weights_beside(path, location):
    """Save a network with two inputs whose flow is a 4x4 weight that is stored in the file `location` in the same
    folder.
    """
    inputs = [helper.make_tensor_value_info(name, TensorProto.FLOAT, ["n", 3, 4, 4]) for name in ("image1", "image2")]
    weight = TensorProto(name="weight", data_type=TensorProto.FLOAT, dims=[1, 2, 4, 4])
    weight.data_location = TensorProto.EXTERNAL
    for key, value in (("location", location), ("length", "128")):
        weight.external_data.add(key=key, value=value)
    outputs = [helper.make_tensor_value_info("flow", TensorProto.FLOAT, [1, 2, 4, 4])]
    graph = helper.make_graph([helper.make_node("Identity", ["weight"], ["flow"])], "n", inputs, outputs, [weight])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9)
    path.write_bytes(model.SerializeToString())
    return path


def _two_frames_to(path, nodes, constants):
    inputs = [
        helper.make_tensor_value_info(name, TensorProto.FLOAT, ["n", 3, "h", "w"]) for name in ("image1", "image2")
    ]
    return save(path, inputs, nodes, [helper.make_tensor_value_info("flow", TensorProto.FLOAT, None)], constants)


def endless(path):
    """Save a network of less than 500 bytes that loops 2^62 times."""

    def value(name, kind, shape):
        return helper.make_tensor_value_info(name, kind, shape)

    body = helper.make_graph(
        [helper.make_node("Identity", [f"{name}_in"], [name]) for name in ("more", "flow")],
        "body",
        [
            value("i", TensorProto.INT64, []),
            value("more_in", TensorProto.BOOL, []),
            value("flow_in", TensorProto.FLOAT, None),
        ],
        [value("more", TensorProto.BOOL, []), value("flow", TensorProto.FLOAT, None)],
    )
    constants = [
        helper.make_tensor("n", TensorProto.INT64, [], [2**62]),
        helper.make_tensor("go", TensorProto.BOOL, [], [1]),
    ]
    nodes = [
        helper.make_node("Add", ["image1", "image2"], ["sum"]),
        helper.make_node("Loop", ["n", "go", "sum"], ["flow"], body=body),
    ]
    return _two_frames_to(path, nodes, constants)


def hungry(path):
    """Save a network of less than 500 bytes that requests 1.6 GB twice."""
    constants = [helper.make_tensor("size", TensorProto.INT64, [1], [400_000_000])]
    nodes = [
        helper.make_node("Add", ["image1", "image2"], ["sum"]),
        helper.make_node("ConstantOfShape", ["size"], ["big"]),
        helper.make_node("Add", ["big", "big"], ["flow"]),
    ]
    return _two_frames_to(path, nodes, constants)
