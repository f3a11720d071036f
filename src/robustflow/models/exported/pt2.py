"""Optical-flow networks in files of `torch.export.save`. Needs the torch extra when one is loaded.

Such a file is not loaded as PyTorch would load it: see `pt2_file` for what it can hold and what is refused. A module
pickled by `torch.save` is never loaded, nor is a TorchScript file (see `loading`). The conventions are those of `onnx`.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...errors import ModelError
from ..execution import Execution, with_execution
from ..extras import require
from ..input_convention import named_convention
from ..model_file import require_file
from ..signature import Dim, batch_and_size, chosen_inputs, infer_layout, refuse_lost_frame

if TYPE_CHECKING:
    from ..torch.model import NetworkModel


@with_execution
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
    execution: Execution,
) -> NetworkModel:
    """A program of `torch.export.export`, saved by `torch.export.save` as a `.pt2` file.

    Args:
        checkpoint: the file.
        order, scaling, multiple, layout, inputs: see `OnnxModel`; the sizes it takes are in the file.
        output: position or key of the flow among several outputs; the last by default.
        sha256: the file's hash, or its first eight or more digits, to be checked.
        execution: see `Execution`; its fields are options.

    Raises:
        UsageError: an option that cannot be meant.
        ModelError: no torch, a file that is not such a program, or one that does not take two frames.
    """
    named_convention(order=order, scaling=scaling, multiple=multiple)  # an option is refused before the file
    if checkpoint is None:
        raise ModelError("model 'torch_export' needs its file: give its path as --checkpoint")
    path = Path(checkpoint).expanduser()
    require_file(path)
    require("torch", "torch", "torch_export")
    from torch.export.passes import move_to_device_pass
    from torch.utils import _pytree

    from ..torch.model import NetworkModel, find_device
    from ..torch.module_net import ModuleNet
    from .pt2_file import read_exported_program

    exported, digest = read_exported_program(path, sha256)
    places = {node.name: node.meta.get("val") for node in exported.graph.nodes if node.op == "placeholder"}
    given = [(str(name), _shape(places.get(name))) for name in exported.graph_signature.user_inputs]
    chosen = chosen_inputs(given, inputs)
    shapes = [given[i] for i in chosen]
    way_in = infer_layout(shapes, layout)
    batched, size = batch_and_size(shapes)
    convention = named_convention(order=order, scaling=scaling, multiple=multiple, size=size)
    refuse_lost_frame([name for name, _ in shapes], {node.name for node in exported.graph.nodes if node.users})
    # The sizes are checked by the operators as they run; what the file says about them was not read.
    program = move_to_device_pass(exported, find_device(execution.device)).module(check_guards=False)
    structure = exported.call_spec.in_spec

    def call(images: list[Any]) -> Any:
        ordered = [image for _, image in sorted(zip(chosen, images, strict=True), key=lambda pair: pair[0])]
        positional, named = _pytree.tree_unflatten(ordered, structure)
        return program(*positional, **named)

    dtypes = [_dtype(name, places[name]) for name, _ in shapes]
    net = ModuleNet(program, call, way_in, output, batched, dtypes)
    flow = "last" if output is None else str(output)
    settings = {"checkpoint": digest, "layout": way_in, "inputs": [name for name, _ in shapes], "output": flow}
    name = f"torch_export:{path.stem}"
    return NetworkModel(name, net, convention, settings, execution)


def _shape(value: Any) -> tuple[Dim, ...] | None:
    """The sides of a traced tensor, None for a symbolic one; an empty shape for what is not a tensor."""
    return tuple(side if type(side) is int else None for side in getattr(value, "shape", ()))


def _dtype(name: str, value: Any) -> Any:
    if not value.dtype.is_floating_point:
        kind = str(value.dtype).removeprefix("torch.")
        raise ModelError(f"the network's input {name} is {kind}; expected floating-point numbers: export it for those")
    return value.dtype
