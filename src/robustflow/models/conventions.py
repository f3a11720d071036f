"""The input that a network expects: colour order, value range, size."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, cast

from ..core.arguments import check_count
from ..core.errors import ModelError, unknown_name

MOST_THREADS = 1024
"""Maximum number of CPU threads of a network. Libraries crash with many more threads than processors."""


RAFT_SMALLEST = 121
"""Minimum side length in pixels of frames for RAFT's correlation: the last level of smaller frames has one pixel, and
dividing by this width minus one results in NaN. The authors do not evaluate such frames.
"""

ORDERS = ("rgb", "bgr")
_PerChannel = tuple[float, float, float]
# ImageNet's mean and standard deviation for RGB in 0..1, from torchvision's documentation.
_MEAN: _PerChannel = (255 * 0.485, 255 * 0.456, 255 * 0.406)
_STD: _PerChannel = (255 * 0.229, 255 * 0.224, 255 * 0.225)
_NONE: _PerChannel = (0.0, 0.0, 0.0)
SCALINGS: dict[str, tuple[_PerChannel, float | _PerChannel]] = {
    "0-1": (_NONE, 1 / 255),
    "-1-1": ((127.5, 127.5, 127.5), 2 / 255),
    "0-255": (_NONE, 1.0),
    "imagenet": (_MEAN, (1 / _STD[0], 1 / _STD[1], 1 / _STD[2])),
}
"""Input scalings: the mean subtracted from RGB values 0..255, and the factor applied to the difference."""
_SMALLEST, _LARGEST = 4, 2**15
"""Valid side lengths of a fixed input, in pixels; a smaller one is a channel count, a larger one exhausts memory."""
_LARGEST_MULTIPLE = 1024
"""Maximum multiple in pixels: frames are padded to it, and a larger one would require too much memory."""


@dataclass(frozen=True)
class InputConvention:
    """The conversion of uint8 RGB frames to the kind of input that a network was trained on."""

    mean: tuple[float, float, float] = (0.0, 0.0, 0.0)
    scale: float | tuple[float, float, float] = 1 / 255
    order: Literal["rgb", "bgr"] = "rgb"
    fit: Literal["none", "pad", "stretch"] = "none"
    multiple: int = 1
    size: tuple[int | None, int | None] | None = None
    padding: Literal["replicate", "zeros"] = "replicate"
    vertical: Literal["both", "bottom"] = "both"
    smallest: int = 1

    def fitted_size(self, height: int, width: int) -> tuple[int, int]:
        """Return the (height, width) of the network's input for a frame of this size."""
        if min(height, width) < self.smallest:
            message = f"below {self.smallest} pixels per side, the network returns NaN or fails; use larger frames"
            raise ModelError(f"{height}x{width}", message)
        if self.fit == "none":
            return height, width
        fixed_height, fixed_width = self.size or (None, None)
        fitted = (
            fixed_height or height + -height % self.multiple,
            fixed_width or width + -width % self.multiple,
        )
        if self.fit == "pad" and (fitted[0] < height or fitted[1] < width):
            most = f"{fitted[0]}x{fitted[1]}"
            message = f"the network accepts frames of up to {most}: export it with dynamic height and width"
            raise ModelError(f"{height}x{width}", f"{message}, or predict in tiles with -O tile={most}")
        return fitted

    def padding_sides(self, height: int, width: int) -> tuple[int, int, int, int]:
        """Return the numbers of columns on the left and right, and of rows at the top and bottom, that "pad" adds."""
        fitted_height, fitted_width = self.fitted_size(height, width)
        rows, columns = fitted_height - height, fitted_width - width
        above = rows // 2 if self.vertical == "both" else 0
        return columns // 2, columns - columns // 2, above, rows - above

    def describe(self) -> dict[str, Any]:
        """Return the convention's entry in a run's manifest, without fields that have no effect."""
        about: dict[str, Any] = {"order": self.order, "mean": list(self.mean), "fit": self.fit}
        about["scale"] = list(self.scale) if isinstance(self.scale, tuple) else self.scale
        if self.fit != "none":
            about["multiple"] = self.multiple
        if self.fit == "pad":
            about |= {"padding": self.padding, "vertical": self.vertical}
        if self.fit == "stretch" or self.size:
            about["size"] = list(self.size) if self.size else "next multiple"
        return about


def named_convention(
    *, order: str, scaling: str, multiple: int, size: tuple[int | None, int | None] = (None, None)
) -> InputConvention:
    """Build a convention from options, for an exported network or a user-defined module.

    >>> named_convention(order="bgr", scaling="0-255", multiple=8).fitted_size(375, 1242)
    (376, 1248)
    """
    if order not in ORDERS:
        raise unknown_name("order", str(order), ORDERS)
    if scaling not in SCALINGS:
        raise unknown_name("scaling", str(scaling), SCALINGS)
    check_count("multiple", multiple, most=_LARGEST_MULTIPLE)
    if not all(side is None or _SMALLEST <= side <= _LARGEST for side in size):
        text = "x".join("?" if side is None else str(side) for side in size)
        raise ModelError(text, "the network expects such frames; export it for (N, 3, H, W), with dynamic H and W")
    mean, scale = SCALINGS[scaling]
    if order == "bgr":
        mean, scale = mean[::-1], scale[::-1] if isinstance(scale, tuple) else scale
    return InputConvention(
        mean=mean,
        scale=scale,
        order=cast(Literal["rgb", "bgr"], order),
        fit="pad",
        multiple=multiple,
        size=size if any(size) else None,
    )
