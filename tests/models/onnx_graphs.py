"""ONNX networks whose flow is a known function of their inputs."""

import onnx
from onnx import TensorProto, parser

WAYS_IN = {"pair": "3", "stacked": "2,3", "concatenated": "6"}
"""The dimensions of an input between the batch and the height, for each layout."""


def save(path, inputs, outputs, nodes, constants=""):
    head = f'<ir_version: 9, opset_import: ["" : 17]> network ({inputs}) => ({outputs}) <{constants}>'
    onnx.save(parser.parse_model(f"{head} {{ {nodes} }}"), str(path))
    return path


def channels(
    path,
    *,
    layout="pair",
    batch="n",
    size=("h", "w"),
    flip=False,
    channels_last=False,
    kind="float",
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
    height, width = size
    shape = f"{kind}[{batch},{WAYS_IN[layout]},{height},{width}]"
    inputs = names if layout == "pair" else ("images",)
    first, second, third = *inputs[:1], inputs[-1], 5 if layout == "concatenated" else 2
    nodes = [f'"{name}" = Identity ({first})' for name in more_outputs]
    if layout == "stacked":
        nodes += [f"frame{i} = Gather <axis=1> (images, index{i})" for i in range(2)]
        first, second = "frame0", "frame1"
    nodes += [
        f"u = Gather <axis=1> ({first}, u_channel)",
        f"v = Gather <axis=1> ({second}, v_channel)",
        "uv = Concat <axis=1> (u, v)",
        "turned = Slice (uv, starts, ends, axes, starts)" if flip else "turned = Identity (uv)",
        "flow = Transpose <perm=[0, 2, 3, 1]> (turned)" if channels_last else "flow = Identity (turned)",
    ]
    constants = (
        f"int64[1] u_channel = {{0}}, int64[1] v_channel = {{{third}}}, int64 index0 = {{0}}, int64 index1 = {{1}}"
    )
    constants += f", int64[2] starts = {{-1, -1}}, int64[2] ends = {{{-(2**31)}, {-(2**31)}}}, int64[2] axes = {{2, 3}}"
    flow = f"{kind}[{batch},{height},{width},2] flow" if channels_last else f"{kind}[{batch},2,{height},{width}] flow"
    outputs = ", ".join([*(f'{shape} "{name}"' for name in more_outputs), flow])
    return save(path, ", ".join(f"{shape} {name}" for name in inputs), outputs, "\n".join(nodes), constants)


def with_weights_beside(path, location):
    """Save a network with two inputs whose flow is a 4x4 weight that is stored in the file `location` in the same
    folder.
    """
    inputs = "float[n,3,4,4] image1, float[n,3,4,4] image2"
    save(path, inputs, "float[1,2,4,4] flow", "flow = Identity (weight)")
    model = onnx.load(path)
    weight = TensorProto(name="weight", data_type=TensorProto.FLOAT, dims=[1, 2, 4, 4])
    weight.data_location = TensorProto.EXTERNAL
    for key, value in (("location", location), ("length", "128")):
        weight.external_data.add(key=key, value=value)
    model.graph.initializer.append(weight)
    path.write_bytes(model.SerializeToString())
    return path


FRAMES = "float[n,3,h,w] image1, float[n,3,h,w] image2"


def endless(path):
    """Save a network of less than 500 bytes that loops 2^62 times."""
    body = "body = body (int64 i, bool go_in, float[] flow_in) => (bool go_out, float[] flow_out)"
    body += " { go_out = Identity (go_in) flow_out = Identity (flow_in) }"
    nodes = f"total = Add (image1, image2) flow = Loop <{body}> (n, go, total)"
    return save(path, FRAMES, "float[] flow", nodes, f"int64 n = {{{2**62}}}, bool go = {{1}}")


def hungry(path):
    """Save a network of less than 500 bytes that requests 1.6 GB twice."""
    nodes = "total = Add (image1, image2) big = ConstantOfShape (size) flow = Add (big, big)"
    return save(path, FRAMES, "float[] flow", nodes, "int64[1] size = {400000000}")
