"""What the file of an exported network leaves open: colours, range, padding, how a pair goes in and a flow comes out.

Shared by ONNX, TorchScript and torch.export files. Importable without the torch extra.
"""

from __future__ import annotations

from collections.abc import Container, Iterable, Sequence
from typing import Any, Literal, cast

from ...errors import ModelError, UsageError, unknown_name
from ..input_convention import InputConvention
from ..option_checks import check_count

Layout = Literal["pair", "stacked", "concatenated"]
LAYOUTS = ("pair", "stacked", "concatenated")
"""Two inputs (N, 3, H, W); one input (N, 2, 3, H, W); one input (N, 6, H, W)."""

Dim = int | None
"""A dimension of an input; None where it is dynamic."""

_PerChannel = tuple[float, float, float]
# Of ImageNet, RGB in 0..1, as torchvision documents them.
_MEAN: _PerChannel = (255 * 0.485, 255 * 0.456, 255 * 0.406)
_STD: _PerChannel = (255 * 0.229, 255 * 0.224, 255 * 0.225)
_SMALLEST, _LARGEST = 4, 2**15
"""Pixels along a side that an input fixes. Less is a number of channels, more asks for more memory than there is."""


def exported_convention(
    *, order: str, scaling: str, multiple: int, size: tuple[Dim, Dim] = (None, None)
) -> InputConvention:
    """The way in that the options of an exported network describe.

    Args:
        order: of the colours, "rgb" or "bgr".
        scaling: of the values: "0-1", "-1-1", "0-255", or "imagenet" (0..1, less ImageNet's mean, over its deviation).
        multiple: of height and width, reached by repeating the border.
        size: (height, width) the network takes, where it takes one only; None for a dynamic side.

    Raises:
        UsageError: an unknown order or scaling, or a multiple below 1 or larger than any frame.
        ModelError: a size no frame has.

    >>> exported_convention(order="bgr", scaling="0-255", multiple=8).fitted_size(375, 1242)
    (376, 1248)
    """
    if order not in ("rgb", "bgr"):
        raise unknown_name("order", str(order), ("rgb", "bgr"))
    check_count("multiple", multiple)
    if multiple > _LARGEST:
        raise UsageError(f"multiple must be {_LARGEST} pixels at most, not {multiple}")
    if not all(side is None or _SMALLEST <= side <= _LARGEST for side in size):
        asked = "x".join("?" if side is None else str(side) for side in size)
        raise ModelError(f"the network asks for frames of {asked}; export it for (N, 3, H, W), H and W dynamic")
    mean, deviation = (_MEAN, _STD) if order == "rgb" else (_MEAN[::-1], _STD[::-1])
    ranges: dict[str, tuple[_PerChannel, float | _PerChannel]] = {
        "0-1": ((0.0, 0.0, 0.0), 1 / 255),
        "-1-1": ((127.5, 127.5, 127.5), 2 / 255),
        "0-255": ((0.0, 0.0, 0.0), 1.0),
        "imagenet": (mean, (1 / deviation[0], 1 / deviation[1], 1 / deviation[2])),
    }
    if scaling not in ranges:
        raise unknown_name("scaling", str(scaling), ranges)
    subtracted, scale = ranges[scaling]
    return InputConvention(
        mean=subtracted,
        scale=scale,
        order=cast(Literal["rgb", "bgr"], order),
        fit="pad",
        multiple=multiple,
        size=size if any(size) else None,
    )


def infer_layout(inputs: Sequence[tuple[str, Sequence[Dim] | None]], layout: str | None) -> Layout:
    """How a pair goes into a network.

    Args:
        inputs: names and shapes of what the network takes; the shape is None where the file does not say.
        layout: one of `LAYOUTS`, or None to tell it from the inputs.

    Raises:
        UsageError: an unknown layout.
        ModelError: inputs that no layout fits, or several do.

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
        reason = f"several are possible; give the option layout, one of {', '.join(chosen)}"
    elif fitting:
        reason = f"layout={layout} does not fit; {fitting[0]} does"
    else:
        reason = "expected two of (N, 3, H, W), one of (N, 2, 3, H, W) or one of (N, 6, H, W); export it with such"
    raise ModelError(f"the network's inputs are {describe_arrays(inputs)}: {reason}")


def batch_and_size(inputs: Sequence[tuple[str, Sequence[Dim] | None]]) -> tuple[bool, tuple[Dim, Dim]]:
    """Whether a network takes several pairs at once, and the (height, width) it takes, None where that is dynamic.

    Raises:
        ModelError: a batch fixed at more than one pair, or inputs of two sizes.

    >>> batch_and_size([("a", (1, 3, 64, None)), ("b", (1, 3, 64, None))])
    (False, (64, None))
    """
    shapes = [tuple(shape) for _, shape in inputs if shape is not None]
    batches = {shape[0] for shape in shapes} - {None}
    sizes = [{shape[axis] for shape in shapes} - {None} for axis in (-2, -1)]
    if batches - {1} or any(len(side) > 1 for side in sizes):
        raise ModelError(
            f"the network's inputs are {describe_arrays(inputs)}: expected a dynamic batch or a batch of 1, and frames "
            "of one size; export it with such"
        )
    height, width = (next(iter(side), None) for side in sizes)
    return not batches and bool(shapes), (height, width)


def chosen_inputs(inputs: Sequence[tuple[str, Sequence[Dim] | None]], names: str | None) -> list[int]:
    """Positions of the inputs in the order in which the frames go into them.

    Args:
        inputs: names and shapes of what the network takes.
        names: of its inputs, first frame first, separated by a comma; None for the file's order.

    Raises:
        UsageError: a name the network does not have.
        ModelError: inputs that would get nothing.

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
            f"the network's inputs are {describe_arrays(inputs)}, and only {', '.join(wanted)} would be given; export "
            "it without the others"
        )
    return [known.index(name) for name in wanted]


def refuse_lost_frame(inputs: Iterable[str], read: Container[str]) -> None:
    """Refuse a network that reads one of its two frames only.

    That is what `torch.export` makes, and `torch.onnx.export` with dynamo, of one example tensor given twice.

    Args:
        inputs: names of what the network takes.
        read: those that it reads.

    Raises:
        ModelError: it reads some and not others.
    """
    inputs = list(inputs)
    lost = [name for name in inputs if name not in read]
    if 0 < len(lost) < len(inputs):
        raise ModelError(
            f"the network does not read its input {', '.join(lost)[:60]}: given one tensor as both frames, the "
            "exporter took them for one input; export it with two tensors"
        )


def flow_layout(shape: Sequence[int], pairs: int, height: int, width: int) -> Literal["nchw", "nhwc"]:
    """Which axis of an output holds (u, v): told by its shape, channels first where both would fit.

    Args:
        shape: of the output.
        pairs: that went in.
        height, width: of the network's input.

    Raises:
        ModelError: an output that is no flow at the input's resolution.

    >>> flow_layout((1, 40, 64, 2), 1, 40, 64)
    'nhwc'
    """
    if tuple(shape) == (pairs, 2, height, width):
        return "nchw"
    if tuple(shape) == (pairs, height, width, 2):
        return "nhwc"
    raise ModelError(
        f"the network's flow has the shape {tuple(shape)} for {pairs} inputs of {height}x{width}; expected "
        f"{(pairs, 2, height, width)} or {(pairs, height, width, 2)}; export it so, or choose another with -O output="
    )


def describe_arrays(arrays: Sequence[tuple[str, Sequence[Any] | None]]) -> str:
    """Names and shapes, for messages.

    >>> describe_arrays([("image1", (1, 3, None, None)), ("x", None)])
    'image1 (1, 3, ?, ?), x (unknown shape)'
    """
    described = []
    for name, shape in list(arrays)[:8]:
        sides = None if shape is None else ", ".join("?" if side is None else str(side) for side in shape)
        described.append(f"{name[:60]!s} ({'unknown shape' if sides is None else sides})")
    more = len(arrays) - len(described)
    return (", ".join(described) or "none") + (f" and {more} more" if more > 0 else "")


def _fits(layout: str, shapes: Sequence[Sequence[Dim] | None]) -> bool:
    """Whether inputs of these shapes can be this layout; an unknown side or shape fits everywhere."""
    count, axes = {"pair": (2, (3,)), "stacked": (1, (2, 3)), "concatenated": (1, (6,))}[layout]
    return len(shapes) == count and all(
        shape is None
        or (
            len(shape) == len(axes) + 3
            and all(side in (None, axis) for side, axis in zip(shape[1:-2], axes, strict=True))
        )
        for shape in shapes
    )
