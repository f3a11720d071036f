"""Universal: one perturbation for all samples (Moosavi-Dezfooli et al. 2017; for optical flow, Schmalfuss et al.
2022)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np

from ..core.errors import DataError, UsageError
from ..core.files import digest_of_bytes
from ..core.rng import Rng
from ..models.base import AnyModel
from .ball import Ball, Images
from .base import Pattern
from .problem import Problem
from .trained import Trained, read_array, read_file

_REACH = 2.5
"""Sum of all training step sizes, as a multiple of the budget."""


@dataclass(frozen=True, kw_only=True)
class Universal(Trained):
    """Add the same perturbation to every pair, projected to the budget and clipped to 0..255."""

    name: ClassVar[str] = "universal"
    needs_gradients: ClassVar[bool] = False

    second: str = ""

    @classmethod
    def made(cls, **options: Any) -> Self:
        """See `Trained.made`."""
        attack = super().made(**options)
        if attack.second and not attack.file:
            raise UsageError(f"attack universal: second={attack.second} without file=, the perturbation of frame 1")
        return attack

    @property
    def source(self) -> str:
        """A digest of the files."""
        files = [read_file(each) for each in (self.file, self.second) if each]
        return digest_of_bytes(*files, size=8) if files else ""

    def check(self, model: AnyModel) -> None:
        """See `Trained.check`."""
        if not self.train and not self.file:
            raise UsageError(
                "attack universal needs training samples (universal:train=8 or universal:train=KEYS.txt) or a stored "
                "perturbation (universal:file=PERTURBATION.npy)"
            )
        super().check(model)

    def run(self, problem: Problem, rng: Rng) -> Images:
        """See `Attack.run`; the model is not queried."""
        pattern = self.pattern(problem)
        assert pattern is not None
        return self.placed(problem, pattern, rng)

    def first(self, problems: Sequence[Problem], rng: Rng) -> Pattern:
        """See `Trained.first`; a random perturbation of the size of the largest frame."""
        shapes = [problem.ball.clean.shape[2:] for problem in problems]
        height, width = (max(sizes) for sizes in zip(*shapes, strict=True))
        ball = self._around_grey(problems[0], (height, width))
        return ball.random(rng) - ball.clean

    def placed(self, problem: Problem, pattern: Pattern, rng: Rng) -> Images:
        """See `Trained.placed`; the perturbation covers the whole frame."""
        ball = problem.ball
        height, width = ball.clean.shape[2:]
        missing = [(0, 0), (0, 0), (0, max(height - pattern.shape[2], 0)), (0, max(width - pattern.shape[3], 0))]
        change = np.pad(pattern, missing, mode="wrap")[..., :height, :width]
        return ball.project(ball.clean + change)

    def pulled(self, problem: Problem, gradient: Images, pattern: Pattern, rng: Rng) -> Pattern:
        """See `Trained.pulled`."""
        pull = np.zeros_like(pattern)
        height, width = gradient.shape[2:]
        pull[..., :height, :width] = gradient
        return pull

    def stepped(self, problem: Problem, pattern: Pattern, pull: Pattern, share: float) -> Pattern:
        """See `Trained.stepped`."""
        ball = self._around_grey(problem, pattern.shape[2:])
        return ball.step(ball.clean + pattern, pull, _REACH * ball.budget * share) - ball.clean

    @classmethod
    def fits(cls, array: Pattern) -> bool:
        """See `Trained.fits`."""
        return array.ndim == 4 and array.shape[:2] == (2, 3) and array.size > 0

    def checked_pattern(self, array: Pattern, problem: Problem) -> Pattern:
        """See `Trained.checked_pattern`."""
        first, second = self._frames(array, self.file), None
        if self.second:
            second = self._frames(read_array(self.second), self.second)
            if len(first) != 1 or len(second) != 1 or first.shape != second.shape:
                raise DataError(f"{self.file} and {self.second} are not perturbations of two frames of equal size")
        shape, frames = first.shape[2:], problem.ball.clean.shape[2:]
        if shape != frames:
            raise DataError(
                f"{self.file} is for frames of {shape[0]}x{shape[1]} pixels, but the frames of sample "
                f"'{problem.pair.key}' are {frames[0]}x{frames[1]}; give a file for this size"
            )
        return np.concatenate([first, first if second is None else second]) if len(first) == 1 else first

    @staticmethod
    def _frames(array: Pattern, path: str) -> Pattern:
        whole = array[None] if array.ndim == 3 else array
        if whole.shape[1] != 3 or len(whole) > 2:
            raise DataError(f"{path} is an array {array.shape}; expected (3, H, W), (1, 3, H, W) or (2, 3, H, W)")
        return whole

    def _around_grey(self, problem: Problem, shape: tuple[int, ...]) -> Ball:
        """Return the ball around grey frames, where no value of a perturbation is clipped."""
        grey = np.full((*shape, 3), 128, np.uint8)
        return Ball(grey, grey, problem.ball.budget, self.norm, self.moved, self.per_frame)
