"""Determine the inputs and outputs of a network: how a pair is passed, at what size, and how the flow is returned.

Shared by ONNX files and user-defined modules. Importable without the torch extra.
"""

from __future__ import annotations

from collections.abc import Container, Iterable, Sequence
from typing import Any, Literal, cast

from ..core.errors import ModelError, unknown_name
from ..core.text import first_of

Layout = Literal["pair", "stacked", "concatenated"]
LAYOUTS = ("pair", "stacked", "concatenated")
"""Input layouts: two inputs (N, 3, H, W); one input (N, 2, 3, H, W); one input (N, 6, H, W)."""

Dim = int | None
"""A dimension of an input; None if it is dynamic."""


def infer_layout(inputs: Sequence[tuple[str, Sequence[Dim] | None]], layout: str | None) -> Layout:
    """Return the layout in which a pair is passed to a network.

    >>> infer_layout([("images", (None, 6, None, None))], None)
    'concatenated'
    """
    if layout is not None and layout not in LAYOUTS:
        raise unknown_name("layout", str(layout), LAYOUTS)
    fitting = [name for name in LAYOUTS if _fits(name, [shape for _, shape in inputs])]
    chosen = [name for name in fitting if layout in (None, name)]
    if len(chosen) == 1:
        return cast(Layout, chosen[0])
    if chosen:
        reason = f"several layouts are possible; set the option layout to one of {', '.join(chosen)}"
    elif fitting:
        reason = f"layout={layout} does not match; {fitting[0]} does"
    else:
        reason = (
            "expected two inputs (N, 3, H, W), or one input (N, 2, 3, H, W) or (N, 6, H, W); export it with such inputs"
        )
    raise ModelError(f"the network's inputs are {describe_arrays(inputs)}: {reason}")


def batch_and_size(inputs: Sequence[tuple[str, Sequence[Dim] | None]]) -> tuple[bool, tuple[Dim, Dim]]:
    """Return whether a network accepts several pairs per call, and the (height, width) of its input, None if dynamic.

    >>> batch_and_size([("a", (1, 3, 64, None)), ("b", (1, 3, 64, None))])
    (False, (64, None))
    """
    shapes = [tuple(shape) for _, shape in inputs if shape is not None]
    batches = {shape[0] for shape in shapes} - {None}
    sizes = [{shape[axis] for shape in shapes} - {None} for axis in (-2, -1)]
    if batches - {1} or any(len(side) > 1 for side in sizes):
        raise ModelError(
            f"the network's inputs are {describe_arrays(inputs)}: expected a dynamic batch size or a batch size "
            "of 1, and frames of one size; export it with such inputs"
        )
    height, width = (next(iter(side), None) for side in sizes)
    return not batches and bool(shapes), (height, width)


def chosen_inputs(inputs: Sequence[tuple[str, Sequence[Dim] | None]], names: str | None) -> list[int]:
    """Return the positions of the inputs in the order of the frames.

    >>> chosen_inputs([("next", None), ("previous", None)], "previous, next")
    [1, 0]
    """
    known = [name for name, _ in inputs]
    wanted = known if names is None else [name.strip() for name in str(names).split(",")]
    for name in wanted:
        if name not in known:
            raise unknown_name("input of the network", name, known)
    if sorted(wanted) != sorted(known):
        raise ModelError(
            f"the network's inputs are {describe_arrays(inputs)}, but only {', '.join(wanted)} would be used; export "
            "it without the other inputs"
        )
    return [known.index(name) for name in wanted]


def refuse_lost_frame(inputs: Iterable[str], read: Container[str]) -> None:
    """Raise an error if a network reads only one of its two frames."""
    inputs = list(inputs)
    unused = [name for name in inputs if name not in read]
    if 0 < len(unused) < len(inputs):
        raise ModelError(
            f"the network does not read its input {', '.join(unused)[:60]}: the same example tensor was passed to the "
            "exporter for both frames, which merged them into one input; export it with two different tensors"
        )


def flow_layout(shape: Sequence[int], pairs: int, height: int, width: int) -> Literal["nchw", "nhwc"]:
    """Return the axis of an output that contains (u, v), inferred from the shape; channels first if both are possible.

    >>> flow_layout((1, 40, 64, 2), 1, 40, 64)
    'nhwc'
    """
    if tuple(shape) == (pairs, 2, height, width):
        return "nchw"
    if tuple(shape) == (pairs, height, width, 2):
        return "nhwc"
    raise ModelError(
        f"the network's flow has the shape {tuple(shape)} for {pairs} inputs of {height}x{width}; expected "
        f"{(pairs, 2, height, width)} or {(pairs, height, width, 2)}; change the network, or choose a different "
        "output with -O output="
    )


def describe_arrays(arrays: Sequence[tuple[str, Sequence[Any] | None]]) -> str:
    """Format names and shapes for messages.

    >>> describe_arrays([("image1", (1, 3, None, None)), ("x", None)])
    'image1 (1, 3, ?, ?), x (unknown shape)'
    """
    described = []
    for name, shape in arrays:
        sides = None if shape is None else ", ".join("?" if side is None else str(side) for side in shape)
        described.append(f"{name[:60]!s} ({'unknown shape' if sides is None else sides})")
    return first_of(described, 8) or "none"


def _fits(layout: str, shapes: Sequence[Sequence[Dim] | None]) -> bool:
    """Return whether inputs of these shapes match a layout; an unknown side or shape matches any layout."""
    count, axes = {"pair": (2, (3,)), "stacked": (1, (2, 3)), "concatenated": (1, (6,))}[layout]
    return len(shapes) == count and all(
        shape is None
        or (
            len(shape) == len(axes) + 3
            and all(side in (None, axis) for side, axis in zip(shape[1:-2], axes, strict=True))
        )
        for shape in shapes
    )
