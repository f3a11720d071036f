"""The allowed perturbations of an attack: balls around the clean pair, in grey levels of the 8-bit frames."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from ..core.errors import UsageError, unknown_name
from ..core.rng import Rng
from ..core.types import Frame

Images = npt.NDArray[np.float32]
"""Both frames as one RGB array in 0..1, float32 (2, 3, H, W), or a gradient with respect to it."""

WHITE = 255


def images_of(frame1: Frame, frame2: Frame) -> Images:
    """Convert a pair to the array that an attack changes."""
    pair = np.stack([frame1, frame2]).transpose(0, 3, 1, 2)
    return np.ascontiguousarray(pair, np.float32) / np.float32(WHITE)


def grey_levels_of(images: Images) -> npt.NDArray[np.int16]:
    """Round images to grey levels 0..255, int16 (2, 3, H, W)."""
    return np.rint(np.clip(images, 0, 1) * np.float32(WHITE)).astype(np.int16)


def frames_of(levels: npt.NDArray[np.int16]) -> tuple[Frame, Frame]:
    """Convert grey levels (2, 3, H, W) to two frames, RGB uint8 (H, W, 3)."""
    first, second = np.ascontiguousarray(levels.transpose(0, 2, 3, 1), np.uint8)
    return first, second


NORMS = ("linf", "rms", "area")
"""`linf`: the largest change of any value; `rms`: the root mean square of the change over all perturbed frames;
`area`: the share of a frame's pixels that change, by any amount."""

GREY_LEVELS: dict[str, tuple[float, ...]] = {
    "linf": (1, 2, 4, 8, 16),
    "rms": (0.5, 1.25, 2.5, 5, 12.5),
    "area": (0.1, 0.5, 1, 2, 5),
}
"""The budgets of severities 1 to 5 by norm, in grey levels (0..255), or as a % of the pixels for "area". PCFA's bound
of 0.005 corresponds to 1.275 grey levels."""

MOVED = ("both", "first", "second", "joint")
"""Which frames are perturbed: both, independently; only one; or both by the same change."""

_SLACK = 1e-6
"""Relative tolerance for float images that lie on the surface of a ball."""
_HALVINGS = 30
"""Bisection steps in the search for the scale factor of 8-bit frames."""


@dataclass(frozen=True)
class Ball:
    """The pairs within a budget of the clean one."""

    frame1: Frame
    frame2: Frame
    budget: float
    norm: str = "linf"
    moved: str = "both"
    per_frame: bool = False

    def __post_init__(self) -> None:
        for what, value, choice in (("norm", self.norm, NORMS), ("moved", self.moved, MOVED)):
            if value not in choice:
                raise unknown_name(f"{what} of an attack", value, choice)
        most, unit = (100, "% of the pixels") if self.norm == "area" else (WHITE, "grey levels")
        number = isinstance(self.budget, int | float | np.number) and not isinstance(self.budget, bool)
        if not number or not 0 < self.budget <= most:
            raise UsageError("budget", f"must be more than 0 and at most {most} {unit}, not {self.budget!r}")

    @cached_property
    def clean(self) -> Images:
        """The clean pair."""
        return images_of(self.frame1, self.frame2)

    @property
    def radius(self) -> np.float32:
        """The radius on the scale of `Images` (0..1), or in % for "area"."""
        return np.float32(self.budget if self.norm == "area" else self.budget / WHITE)

    @property
    def perturbed(self) -> slice:
        """The frames that are perturbed."""
        return {"first": slice(0, 1), "second": slice(1, 2)}.get(self.moved, slice(0, 2))

    def size_of(self, change: npt.NDArray[np.float32]) -> float:
        """Compute the norm of a change, float32 (2, 3, H, W), in the units of the change."""
        moved = change[self.perturbed].astype(np.float64)
        if self.norm == "linf":
            return float(np.abs(moved).max())
        if self.norm == "area":
            changed = np.count_nonzero(moved.any(axis=1), axis=(1, 2)).max()
            return float(100 * changed / (moved.shape[2] * moved.shape[3]))
        means = (moved**2).mean(axis=(1, 2, 3))
        return float(np.sqrt(means.max() if self.per_frame else means.mean()))

    def holds(self, images: Images) -> bool:
        """Whether images are inside the ball, up to float32 rounding errors."""
        change = images - self.clean
        inside = images.min() >= 0 and images.max() <= 1
        together = self.moved != "joint" or np.abs(change[0] - change[1]).max() <= _SLACK
        still = not np.delete(change, np.r_[self.perturbed], axis=0).any()
        return bool(inside and together and still and self.size_of(change) <= float(self.radius) * (1 + _SLACK) + 1e-7)

    def project(self, images: Images) -> Images:
        """Project images: clip the change to the ball, then the values to 0..1."""
        change = np.zeros_like(images)
        change[self.perturbed] = (images - self.clean)[self.perturbed]
        if self.moved == "joint":
            change[:] = change.mean(axis=0)
        change = self._shortened(change)
        if self.moved == "joint":
            change = np.clip(change, -self.clean.min(axis=0), 1 - self.clean.max(axis=0))
        return np.clip(self.clean + change, 0, 1).astype(np.float32)

    def _shortened(self, change: Images) -> Images:
        if self.norm == "linf":
            return np.clip(change, -self.radius, self.radius)
        if self.norm == "area":
            sizes = np.abs(change).max(axis=1).reshape(2, -1)
            order = np.argsort(-sizes, axis=1, kind="stable")[:, : int(self.budget * sizes.shape[1] / 100)]
            changed = np.zeros_like(sizes, bool)
            np.put_along_axis(changed, order, True, axis=1)
            return change * changed.reshape(2, 1, *change.shape[2:])
        parts = change if self.per_frame else change[None]
        for part, moved in zip(parts, parts if self.per_frame else [change[self.perturbed]], strict=True):
            size = np.sqrt((moved.astype(np.float64) ** 2).mean())
            if size > self.radius:
                part *= np.float32(self.radius / size)
        return change

    def step(self, images: Images, gradient: Images, size: float) -> Images:
        """Take one gradient step and project the result into the ball."""
        if self.moved == "joint":
            gradient = np.broadcast_to(gradient.sum(axis=0), gradient.shape)
        length = np.float32(size / WHITE)
        if self.norm != "rms":
            return self.project(np.asarray(images + length * np.sign(gradient), np.float32))
        squares = (gradient[self.perturbed].astype(np.float64) ** 2).mean(axis=(1, 2, 3), keepdims=True)
        squares = squares if self.per_frame else squares.mean(axis=0, keepdims=True)
        norms = np.sqrt(squares)
        direction = np.zeros_like(gradient)
        np.divide(gradient[self.perturbed], norms, out=direction[self.perturbed], where=norms > 0, casting="unsafe")
        return self.project(images + length * direction)

    def random(self, rng: Rng) -> Images:
        """Draw a random start inside the ball: uniform values, or for "rms" a random direction of the full radius."""
        count = self.clean.size
        if self.norm != "rms":
            drawn = (2 * rng.uniforms(count) - 1) * (1 if self.norm == "area" else float(self.radius))
        else:
            drawn = rng.normals(count) * float(self.radius)
        change = drawn.astype(np.float32).reshape(self.clean.shape)
        if self.moved == "joint":
            change[1] = change[0]
        images: Images = self.clean + change
        size = self.size_of(images - self.clean)
        if self.norm == "rms" and size:  # scale the change to the surface, before values are clipped to 0..1
            images = self.clean + (images - self.clean) * np.float32(float(self.radius) / size)
        return self.project(images)

    def to_8_bits(self, images: Images) -> npt.NDArray[np.int16]:
        """Round images to 8 bits inside the budget, int16 (2, 3, H, W): the largest change, found by bisection."""
        clean = grey_levels_of(self.clean)
        if self.norm == "linf":
            most = int(np.floor(self.budget))
            change = np.clip(self._rounded(images, clean, 1.0), -most, most)
            return (clean + change).astype(np.int16)
        low, high, factor = 0.0, 1.0, 1.0
        for _ in range(_HALVINGS + 1):
            change = self._rounded(images, clean, factor)
            if self.size_of(change.astype(np.float32)) <= self.budget:
                low = factor
            else:
                high = factor
            if low == 1:
                break
            factor = (low + high) / 2
        return (clean + self._rounded(images, clean, low)).astype(np.int16)

    def _rounded(self, images: Images, clean: npt.NDArray[np.int16], factor: float) -> npt.NDArray[np.int16]:
        """Scale the change by `factor` and round it to integers, identically in both frames if they move together."""
        change, low, high = (images - self.clean).astype(np.float64), clean, clean
        if self.moved == "joint":
            change[:] = change.mean(axis=0)
            low, high = clean.min(axis=0), clean.max(axis=0)
        return np.asarray(np.clip(np.rint(change * WHITE * factor), -low, WHITE - high), np.int16)
