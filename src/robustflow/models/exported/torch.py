"""Optical-flow networks in files of TorchScript and torch.export. Needs the torch extra when one is loaded.

Neither kind is loaded as PyTorch would load it: see `torchscript_file` and `pt2_file` for what such files can hold and
what is refused. A module pickled by `torch.save` is never loaded. The conventions are those of `onnx`.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...errors import ModelError
from ..input_convention import parse_size
from ..option_checks import check_switch
from ..torch.network import require
from .base import Dim, batch_and_size, chosen_inputs, exported_convention, infer_layout, refuse_lost_frame

if TYPE_CHECKING:
    from ..torch.model import TorchModel


def torchscript(
    checkpoint: str | Path | None = None,
    *,
    order: str = "rgb",
    scaling: str = "0-1",
    multiple: int = 8,
    size: str | None = None,
    layout: str = "pair",
    output: str | int | None = None,
    batched: bool = False,
    sha256: str | None = None,
    device: str = "auto",
    precision: str = "fp32",
    threads: int = 1,
) -> TorchModel:
    """A TorchScript program: `torch.jit.trace` or `torch.jit.script`, then `save`.

    Args:
        checkpoint: the file.
        order, scaling, multiple: of the frames, see `OnnxModel`.
        size: HEIGHTxWIDTH of the frames it was traced for, where it takes no other; frames are padded to it.
        layout: "pair" (two inputs (N, 3, H, W)), "stacked" (N, 2, 3, H, W) or "concatenated" (N, 6, H, W).
        output: position or key of the flow among several outputs; the last by default.
        batched: it takes several pairs at once, each by itself; a trace does not say.
        sha256: the file's hash, or its first eight or more digits, to be checked.
        device, precision, threads: see `TorchModel`.

    Raises:
        UsageError: an option that cannot be meant.
        ModelError: no torch, or a file that is no TorchScript program.
    """
    check_switch("batched", batched)
    target: tuple[Dim, Dim] = (None, None) if size is None else parse_size(size, 1)
    convention = exported_convention(order=order, scaling=scaling, multiple=multiple, size=target)
    way_in = infer_layout([("", None)] * (2 if layout == "pair" else 1), layout)
    path = _file("torchscript", checkpoint)
    from ..torch.model import TorchModel
    from .net import ExportedNet
    from .torchscript_file import read_torchscript

    program, digest = read_torchscript(path, sha256)
    net = ExportedNet(program.eval(), lambda inputs: program(*inputs), way_in, output, batched)
    flow = "last" if output is None else str(output)
    settings = {"checkpoint": digest, "layout": way_in, "output": flow, "batched": batched}
    name = f"torchscript:{path.stem}"
    execution: dict[str, Any] = {"device": device, "precision": precision, "threads": threads}
    return TorchModel(name, net, convention, settings, **execution)


def torch_export(
    checkpoint: str | Path | None = None,
    *,
    order: str = "rgb",
    scaling: str = "0-1",
    multiple: int = 8,
    layout: str | None = None,
    inputs: str | None = None,
    output: str | int | None = None,
    sha256: str | None = None,
    device: str = "auto",
    precision: str = "fp32",
    compile: bool = False,
    threads: int = 1,
) -> TorchModel:
    """A program of `torch.export.export`, saved by `torch.export.save` as a `.pt2` file.

    Args:
        checkpoint: the file.
        order, scaling, multiple, layout, inputs: see `OnnxModel`; the sizes it takes are in the file.
        output: position or key of the flow among several outputs; the last by default.
        sha256: the file's hash, or its first eight or more digits, to be checked.
        device, precision, compile, threads: see `TorchModel`.

    Raises:
        UsageError: an option that cannot be meant.
        ModelError: no torch, a file that is no such program, or one that does not take two frames.
    """
    exported_convention(order=order, scaling=scaling, multiple=multiple)  # an option is refused before the file
    path = _file("torch_export", checkpoint)
    from torch.export.passes import move_to_device_pass
    from torch.utils import _pytree

    from ..torch.model import TorchModel, find_device
    from .net import ExportedNet
    from .pt2_file import read_exported_program

    exported, digest = read_exported_program(path, sha256)
    places = {node.name: node.meta.get("val") for node in exported.graph.nodes if node.op == "placeholder"}
    given = [(str(name), _shape(places.get(name))) for name in exported.graph_signature.user_inputs]
    chosen = chosen_inputs(given, inputs)
    shapes = [given[i] for i in chosen]
    way_in = infer_layout(shapes, layout)
    batched, size = batch_and_size(shapes)
    convention = exported_convention(order=order, scaling=scaling, multiple=multiple, size=size)
    refuse_lost_frame([name for name, _ in shapes], {node.name for node in exported.graph.nodes if node.users})
    # The sizes are checked by the operators as they run; what the file says about them was not read.
    program = move_to_device_pass(exported, find_device(device)).module(check_guards=False)
    structure = exported.call_spec.in_spec

    def call(images: list[Any]) -> Any:
        ordered = [image for _, image in sorted(zip(chosen, images, strict=True), key=lambda pair: pair[0])]
        positional, named = _pytree.tree_unflatten(ordered, structure)
        return program(*positional, **named)

    dtypes = [_dtype(name, places[name]) for name, _ in shapes]
    net = ExportedNet(program, call, way_in, output, batched, dtypes)
    flow = "last" if output is None else str(output)
    settings = {"checkpoint": digest, "layout": way_in, "inputs": [name for name, _ in shapes], "output": flow}
    name = f"torch_export:{path.stem}"
    execution: dict[str, Any] = {"device": device, "precision": precision, "compile": compile, "threads": threads}
    return TorchModel(name, net, convention, settings, **execution)


def _file(model: str, checkpoint: str | Path | None) -> Path:
    require("torch", "torch", model)
    if checkpoint is None:
        raise ModelError(f"model '{model}' needs its file: give its path as --checkpoint")
    return Path(checkpoint).expanduser()


def _shape(value: Any) -> tuple[Dim, ...] | None:
    """The sides of a traced tensor, None for a symbolic one; an empty shape for what is no tensor."""
    return tuple(side if type(side) is int else None for side in getattr(value, "shape", ()))


def _dtype(name: str, value: Any) -> Any:
    if not value.dtype.is_floating_point:
        kind = str(value.dtype).removeprefix("torch.")
        raise ModelError(f"the network's input {name} is {kind}; expected floating-point numbers: export it for those")
    return value.dtype
