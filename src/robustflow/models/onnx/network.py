"""Load an ONNX network in this process and run it with onnxruntime; requires the onnx extra.

An ONNX file contains no code, only a graph of known operators and their weights. External weights are only read from
the folder of the ONNX file.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ...core.errors import ModelError, first_line, unknown_name
from ...core.files import sha256_of_file
from ...core.types import Flow, Frame
from ..conventions import InputConvention, named_convention
from ..model_file import damaged, opened
from ..pair_network import PairNetwork, describe_arrays, flow_layout

_DTYPES = {"tensor(float)": np.float32, "tensor(float16)": np.float16, "tensor(double)": np.float64}
_CUDA = "CUDAExecutionProvider"
_LAYOUTS = {"pair": (2, (3,)), "stacked": (1, (2, 3)), "concatenated": (1, (6,))}
"""Number of inputs, and their sides between N and (H, W), for each input layout."""
_Inputs = Sequence[tuple[str, tuple[int | None, ...] | None]]
"""Names and shapes of inputs; a dynamic side, or a shape of unknown rank, is None."""


class OnnxNetwork(PairNetwork):
    """A network in an ONNX file; the arguments and errors are those of `OnnxModel`."""

    def __init__(
        self,
        path: Path,
        *,
        order: str,
        scaling: str,
        multiple: int,
        layout: str | None,
        inputs: str | None,
        output: str | None,
        sha256: str | None,
        device: str,
        threads: int,
    ) -> None:
        self.device = device
        with opened(path, sha256) as (file, digest):
            model = _parse(path, file.read())
        weight_files = _external_files(path, model)
        self._session = _session(path, self.device, threads)
        nodes = self._session.get_inputs()
        self._inputs = [nodes[i] for i in _chosen_inputs(path, [node.name for node in nodes], inputs)]
        self._output = _chosen_output(path, self._session.get_outputs(), output)
        shapes = [(node.name, _shape(node.shape)) for node in self._inputs]
        self._layout = _layout_of(path, shapes, layout)
        self._batched, size = _batch_and_size(path, shapes)
        self.convention = named_convention(order=order, scaling=scaling, multiple=multiple, size=size)
        _refuse_lost_frame(path, model, [node.name for node in self._inputs])
        self._dtypes = [_dtype(path, node) for node in self._inputs]
        self._settings = {
            "name": f"onnx:{path.stem}",
            "checkpoint": digest,
            **({"external_data": weight_files} if weight_files else {}),
            "layout": self._layout,
            "inputs": [node.name for node in self._inputs],
            "output": self._output,
            "threads": threads,
        }

    def identity(self) -> dict[str, Any]:
        """Return what affects the results: the files' hashes, the input convention, and the execution settings."""
        import onnxruntime

        return {
            **self._settings,
            "input": self.convention.describe(),
            "device": self.device.partition(":")[0],
            "library": f"onnxruntime {onnxruntime.__version__}",
        }

    @property
    def _batches_pairs(self) -> bool:
        return self._batched and self.device != "cpu"

    def run(self, frames1: list[Frame], frames2: list[Frame]) -> list[Flow]:
        """Call the network once for pairs of equal size; the result is the same as from `predict_batch`."""
        flows = self._flows(*(_images(frames, self.convention) for frames in (frames1, frames2)))
        height, width = frames1[0].shape[:2]
        left, _, above, _ = self.convention.padding_sides(height, width)
        return [np.ascontiguousarray(flow[above : above + height, left : left + width]) for flow in flows]

    def _flows(self, image1: npt.NDArray[np.float32], image2: npt.NDArray[np.float32]) -> list[Flow]:
        if self._layout == "pair":
            arrays = [image1, image2]
        elif self._layout == "stacked":
            arrays = [np.stack([image1, image2], axis=1)]
        else:
            arrays = [np.concatenate([image1, image2], axis=1)]
        given = {
            node.name: np.ascontiguousarray(array, dtype)
            for node, array, dtype in zip(self._inputs, arrays, self._dtypes, strict=True)
        }
        try:
            (flow,) = self._session.run([self._output], given)
        except Exception as error:  # onnxruntime has a separate class for each kind of failure
            what = describe_arrays([(name, array.shape) for name, array in given.items()])
            advice = "set -O multiple= or -O memory_limit=GIB, or export it again"
            message = f"the network failed on {what}: {first_line(error)[:200]}; {advice}"
            raise ModelError(self._settings["name"], message) from None
        flow = np.asarray(flow)
        if flow.dtype.kind != "f":
            advice = "export it with a floating-point flow, or choose a different output with -O output="
            raise ModelError(self._output, f"this output of the network is {flow.dtype}; {advice}")
        pairs, _, height, width = image1.shape
        channels_last = flow_layout(flow.shape, pairs, height, width) == "nhwc"
        return list((flow if channels_last else flow.transpose(0, 2, 3, 1)).astype(np.float32))


def _images(frames: list[Frame], convention: InputConvention) -> npt.NDArray[np.float32]:
    """Convert frames of equal size to (N, 3, H, W) in the same way as `NetworkModel`."""
    values = np.stack(frames).astype(np.float32)
    if convention.order == "bgr":
        values = values[..., ::-1]
    images = (values - np.asarray(convention.mean, np.float32)) * np.asarray(convention.scale, np.float32)
    left, right, above, below = convention.padding_sides(*images.shape[1:3])
    padded = np.pad(images, ((0, 0), (above, below), (left, right), (0, 0)), mode="edge")
    return padded.transpose(0, 3, 1, 2)


def _session(path: Path, device: str, threads: int) -> Any:
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    options.use_deterministic_compute = True
    options.log_severity_level = 4  # errors are raised as exceptions; any other log output would clutter the terminal
    provider: Any = "CPUExecutionProvider"
    if device != "cpu":
        provider = (_CUDA, {"device_id": device.partition(":")[2] or "0", "use_tf32": "0"})
        if _CUDA not in onnxruntime.get_available_providers():
            raise ModelError(device, "this onnxruntime has no CUDA: install onnxruntime-gpu instead, or use cpu")
    try:
        session = onnxruntime.InferenceSession(str(path), options, providers=[provider])
    except Exception as error:  # onnxruntime has a separate class for each kind of failure
        what = f"onnxruntime {onnxruntime.__version__} cannot load it ({first_line(error)[:300]})"
        raise ModelError(path, f"{what}; update onnxruntime, or export with a lower opset") from None
    if device != "cpu" and _CUDA not in session.get_providers():
        raise ModelError(device, "onnxruntime cannot load its CUDA libraries; use cpu")
    session.disable_fallback()
    return session


def _shape(shape: Any) -> tuple[int | None, ...] | None:
    """Convert a shape from onnxruntime: a dynamic side is a string or None, an unknown rank is an empty shape."""
    return tuple(side if isinstance(side, int) and side > 0 else None for side in shape) or None


def _layout_of(path: Path, inputs: _Inputs, layout: str | None) -> str:
    """Return the layout in which a pair is passed: the only one that the shapes allow, or else the declared one."""
    if layout is not None and layout not in _LAYOUTS:
        raise unknown_name("layout", str(layout), _LAYOUTS)
    fitting = [name for name in _LAYOUTS if _fits(name, [shape for _, shape in inputs])]
    chosen = [name for name in fitting if layout in (None, name)]
    if len(chosen) == 1:
        return chosen[0]
    expected = "two inputs (N, 3, H, W), or one (N, 2, 3, H, W) or (N, 6, H, W)"
    layouts = f"layouts that match: {', '.join(fitting) or 'none'}; set the option layout, or export it with {expected}"
    raise ModelError(path, f"its inputs are {describe_arrays(inputs)}: {layouts}")


def _fits(layout: str, shapes: Sequence[tuple[int | None, ...] | None]) -> bool:
    """Return whether inputs of these shapes match a layout; an unknown side or shape matches any layout."""
    count, sides = _LAYOUTS[layout]
    return len(shapes) == count and all(
        shape is None
        or (
            len(shape) == len(sides) + 3
            and all(declared in (None, side) for declared, side in zip(shape[1:], sides, strict=False))
        )
        for shape in shapes
    )


def _batch_and_size(path: Path, inputs: _Inputs) -> tuple[bool, tuple[int | None, int | None]]:
    """Return whether several pairs can be passed per call, and the (height, width) of the input, None if dynamic."""
    shapes = [shape for _, shape in inputs if shape is not None]
    batches = {shape[0] for shape in shapes} - {None}
    heights, widths = ({shape[axis] for shape in shapes} - {None} for axis in (-2, -1))
    if batches - {1} or len(heights) > 1 or len(widths) > 1:
        expected = "a batch size that is dynamic or 1, and frames of one size"
        raise ModelError(path, f"its inputs are {describe_arrays(inputs)}; export it with {expected}")
    return not batches and bool(shapes), (next(iter(heights), None), next(iter(widths), None))


def _chosen_inputs(path: Path, inputs: list[str], names: str | None) -> list[int]:
    """Return the positions of the inputs in the order of the frames."""
    wanted = inputs if names is None else [name.strip() for name in str(names).split(",")]
    for name in wanted:
        if name not in inputs:
            raise unknown_name("input of the network", name, inputs)
    if sorted(wanted) != sorted(inputs):
        raise ModelError(path, f"its inputs are {', '.join(inputs)[:300]}, but only {', '.join(wanted)} would be used")
    return [inputs.index(name) for name in wanted]


def _refuse_lost_frame(path: Path, model: Any, inputs: list[str]) -> None:
    """Raise if a network reads only one of its two frames, also in the branches of its graph."""
    import onnx

    read = {name for node in _messages(model, onnx.NodeProto) for name in node.input}
    unused = [name for name in inputs if name not in read | {entry.name for entry in model.graph.output}]
    if 0 < len(unused) < len(inputs):
        raise ModelError(
            path,
            f"it does not read its input {unused[0][:60]}: the exporter got one example tensor for both frames and "
            "merged them; export it with two different tensors",
        )


def _chosen_output(path: Path, nodes: list[Any], name: str | None) -> str:
    names = [str(node.name) for node in nodes]
    if not names:
        raise ModelError(path, "the network has no outputs; export it with its flow as an output")
    chosen = names[-1] if name is None else str(name)  # the command line parses a name like 1234 as a number
    if chosen not in names:
        raise unknown_name("output of the network", chosen, names)
    return chosen


def _dtype(path: Path, node: Any) -> Any:
    if node.type not in _DTYPES:
        raise ModelError(path, f"its input {node.name} is {node.type}; expected one of {', '.join(_DTYPES)}")
    return _DTYPES[node.type]


def _parse(path: Path, content: bytes) -> Any:
    """Parse an ONNX file into its protobuf message."""
    import onnx

    try:
        model = onnx.load_from_string(content)
    except Exception as error:  # protobuf's own exceptions, and any others that a malicious file causes
        raise damaged(path, error) from None
    if not model.graph.node:
        raise ModelError(path, "not an ONNX network (it has no operators); export it with torch.onnx.export")
    return model


def _external_files(path: Path, model: Any) -> dict[str, str]:
    """Return the SHA-256 of every external weight file of an ONNX file, keyed by the name used in the ONNX file."""
    import onnx

    names = {
        entry.value
        for tensor in _messages(model, onnx.TensorProto)
        if tensor.data_location == onnx.TensorProto.EXTERNAL
        for entry in tensor.external_data
        if entry.key == "location"
    }
    return {name: _weights_sha256(path, name) for name in sorted(names)}


def _messages(message: Any, kind: type) -> Iterator[Any]:
    """Yield all messages of a type nested in a message: tensors in initializers and attributes, nodes in branches."""
    if isinstance(message, kind):
        yield message
    for field, value in message.ListFields():
        if field.message_type is not None:
            for part in value if field.is_repeated else (value,):
                yield from _messages(part, kind)


def _weights_sha256(path: Path, name: str) -> str:
    folder = path.resolve().parent
    try:
        file = (folder / name).resolve()
        pipe = file.exists() and not file.is_file()  # reading a pipe or a device could block forever
        if not name or pipe or not file.is_relative_to(folder):
            what = f"its weights '{name[:200]}' are not a regular file in its own folder"
            raise ModelError(path, f"{what}; get the original file, or save it again with its weights beside it")
        return sha256_of_file(file)
    except (OSError, ValueError) as error:  # ValueError: a name with a null character
        reason = getattr(error, "strerror", None) or error
        raise ModelError(
            path, f"its weights '{name[:200]}' cannot be read ({reason}); put that file in the same folder"
        ) from None
