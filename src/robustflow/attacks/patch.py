"""Patch: a disc pasted into both frames at the same position (Ranjan et al. 2019; stripes: Schrodi et al. 2022)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from ..core.errors import DataError, unknown_name
from ..core.rng import Rng
from .ball import Images
from .base import Pattern
from .problem import Problem
from .trained import Trained

_STRIPE = 4
"""Width of a stripe, pixels."""
_ANGLE, _SCALE = 10.0, 0.05
"""Maximum rotation of a trained pattern, in degrees, and maximum relative change of its scale (Ranjan et al.)."""
_REACH = 5.0
"""Sum of all training step sizes, for values in 0..1."""


@dataclass(frozen=True, kw_only=True)
class Patch(Trained):
    """Paste a disc into both frames at the same random position."""

    name: ClassVar[str] = "patch"
    needs_gradients: ClassVar[bool] = False
    norms: ClassVar[tuple[str, ...]] = ("area",)

    moves: ClassVar[bool] = True

    norm: str = "area"
    steps: int = 100

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.moved == "joint":  # pasting the same colours changes each frame differently
            raise unknown_name("moved of attack patch", self.moved, ("both", "first", "second"))

    def run(self, problem: Problem, rng: Rng) -> Images:
        pattern = self.pattern(problem)
        disc = Disc.of(problem, problem.pair.stream("patch"))
        return paste(problem, stripes(problem), disc) if pattern is None else paste(problem, pattern, disc.turned())

    def first(self, problems: Sequence[Problem], rng: Rng) -> Pattern:
        size = max(diameter(problem) for problem in problems)
        return rng.uniforms(3 * size * size).astype(np.float32).reshape(3, size, size)

    def placed(self, problem: Problem, pattern: Pattern, rng: Rng) -> Images:
        return paste(problem, pattern, Disc.of(problem, rng).turned())

    def pulled(self, problem: Problem, gradient: Images, pattern: Pattern, rng: Rng) -> Pattern:
        place = Disc.of(problem, rng).turned()
        there = (gradient[place.frames][(..., *place.where)] * place.mask).sum(axis=0)
        pull, (rows, columns) = np.zeros_like(pattern), place.taken_from(pattern)
        for channel, values in zip(pull, there, strict=True):
            np.add.at(channel, (rows, columns), values)
        return pull

    def stepped(self, problem: Problem, pattern: Pattern, pull: Pattern, share: float) -> Pattern:
        return np.clip(pattern + np.float32(_REACH * share) * np.sign(pull), 0, 1).astype(np.float32)

    @classmethod
    def fits(cls, array: Pattern) -> bool:
        return array.ndim == 3 and array.shape[0] == 3 and array.shape[1] == array.shape[2] > 0

    def checked_pattern(self, array: Pattern, problem: Problem) -> Pattern:
        if not self.fits(array):
            raise DataError(self.file, f"an array {array.shape}; expected (3, N, N) with values in 0..1")
        return np.clip(array, 0, 1)


@dataclass(frozen=True)
class Disc:
    """The position of a disc in a pair, and the orientation of the pattern in the disc."""

    frames: slice
    where: tuple[slice, slice]
    mask: npt.NDArray[np.bool_]
    rng: Rng
    angle: float = 0.0
    scale: float = 1.0

    @classmethod
    def of(cls, problem: Problem, rng: Rng) -> Disc:
        """Place a disc with the budgeted area at a random position."""
        size = diameter(problem)
        height, width = problem.ball.clean.shape[2:]
        top, left = rng.integer(0, height - size + 1), rng.integer(0, width - size + 1)
        return cls(problem.ball.perturbed, (slice(top, top + size), slice(left, left + size)), _disc(size), rng)

    def turned(self) -> Disc:
        """Return the disc with a random rotation and scale."""
        angle, scale = self.rng.uniform(-_ANGLE, _ANGLE), self.rng.uniform(1 - _SCALE, 1 + _SCALE)
        return replace(self, angle=angle, scale=scale)

    def taken_from(self, pattern: Pattern) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
        """Return the row and column of the nearest pattern pixel for each pixel of the square."""
        size, side = len(self.mask), pattern.shape[1]
        down, right = np.indices(self.mask.shape) - (size - 1) / 2
        along, across = (turn(np.deg2rad(self.angle)) * side / (size * self.scale) for turn in (np.cos, np.sin))
        both = np.stack([along * down - across * right, across * down + along * right]) + (side - 1) / 2
        rows, columns = np.clip(np.rint(both), 0, side - 1).astype(np.intp)
        return rows, columns


def diameter(problem: Problem) -> int:
    """Compute the diameter of the largest disc within the budget, in pixels."""
    height, width = problem.ball.clean.shape[2:]
    most = problem.ball.budget / 100 * height * width
    size = int(2 * np.sqrt(most / np.pi)) + 2
    while size and np.count_nonzero(_disc(size)) > most:
        size -= 1
    if not 0 < size <= min(height, width):
        what = f"the diameter of a patch of {problem.ball.budget:g} % of {height}x{width} pixels"
        raise DataError("budget", f"{what} would be {size} pixels; choose a different severity, budget or frame size")
    return size


def stripes(problem: Problem) -> Pattern:
    """Draw vertical black and white stripes, float32 (3, N, N)."""
    size = diameter(problem)
    white = (np.arange(size) // _STRIPE % 2).astype(np.float32)
    return np.broadcast_to(white, (3, size, size)).copy()


def paste(problem: Problem, pattern: Pattern, place: Disc) -> Images:
    """Paste a pattern into the clean pair."""
    images = problem.ball.clean.copy()
    rows, columns = place.taken_from(pattern)
    square = images[place.frames][(..., *place.where)]
    square[..., place.mask] = pattern[:, rows, columns][:, place.mask]
    return images


def _disc(size: int) -> npt.NDArray[np.bool_]:
    distances = np.arange(size) - (size - 1) / 2
    return np.hypot(distances[:, None], distances) <= size / 2
