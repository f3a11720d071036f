"""Attacks that are trained once on held-out samples and then applied to the measured samples; among them, one
perturbation for all samples (Moosavi-Dezfooli et al. 2017; for optical flow, Schmalfuss et al. 2022).
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, ClassVar, Self

import numpy as np

from ..core.errors import DataError, UsageError
from ..core.files import digest_of_bytes
from ..core.paths import user_path
from ..core.rng import Rng
from ..core.types import Flow
from ..models.protocols import AnyModel
from .ball import Ball, Images
from .base import Attack, Learned, Pattern
from .evaluation import in_lockstep
from .gradient import check_gradient, refuse_without_gradient
from .problem import Pair, Problem

_MOMENTUM = 0.75
"""Weight of earlier gradients in the running mean."""
_SMALLEST = 1e-30
_LARGEST = 2**28
"""Maximum size of a perturbation file, in bytes."""


@dataclass(frozen=True, kw_only=True)
class Trained(Attack):
    """Apply the same pattern to every sample."""

    moves: ClassVar[bool] = False
    """Whether every training step places the pattern at a different position."""

    train: str = ""
    file: str = ""
    steps: int = 10
    learned: Mapping[int, Pattern] = field(default_factory=dict, compare=False, repr=False)

    @classmethod
    def made(cls, **options: Any) -> Self:
        if "train" in options:
            options["train"] = str(options["train"])
        attack = super().made(**options)
        if attack.train and attack.file:
            raise UsageError("file", f"give {attack.name} training samples or a file, not both")
        if attack.train.isdecimal() and not int(attack.train):
            raise UsageError("train", "train=0 leaves nothing to train on")
        return attack

    @property
    def trains(self) -> str:
        return self.train

    def training(self, model: AnyModel) -> dict[str, tuple[Attack, AnyModel]]:
        return {self.label: (self, model)} if self.train else {}

    def with_learned(self, learned: Learned) -> Self:
        return replace(self, learned=learned.get(self.label, {}))

    @property
    def source(self) -> str:
        """A digest of the file; a run adds a digest of the training samples."""
        return digest_of_bytes(read_file(self.file), size=8) if self.file else ""

    @property
    def needs(self) -> str:
        return "any model"

    def check(self, model: AnyModel) -> None:
        """Check that the model has gradients if the attack needs training."""
        if self.train:
            refuse_without_gradient(model, self.name)

    def learn(self, model: AnyModel, pairs: Sequence[tuple[Pair, Flow]], rng: Rng, batch_size: int = 1) -> Pattern:
        """Train the pattern: gradient ascent with momentum and falling steps on the mean score of all samples."""
        problems = [self.problem(model, pair, clean_flow) for pair, clean_flow in pairs]
        check_gradient(problems[0], rng.spawn("gradient"))
        pattern = self.first(problems, rng)
        best, highest, mean = pattern, -np.inf, np.zeros_like(pattern)
        for step in range(self.steps + (not self.moves)):
            score, pull = 0.0, np.zeros_like(pattern)
            for start in range(0, len(problems), batch_size):
                chunk = list(enumerate(problems))[start : start + batch_size]
                tasks = [partial(self._slope, problem, pattern, rng.spawn(step, number)) for number, problem in chunk]
                for (number, problem), (here, gradient) in zip(chunk, in_lockstep(tasks), strict=True):
                    score += here
                    pull += self.pulled(problem, gradient, pattern, rng.spawn(step, number))
            if score > highest:
                best, highest = pattern, score
            mean = _MOMENTUM * mean + pull / max(float(np.abs(pull).mean()), _SMALLEST)
            pattern = self.stepped(problems[0], pattern, mean, 2 * (1 - step / self.steps) / self.steps)
        return pattern if self.moves else best

    def _slope(self, problem: Problem, pattern: Pattern, rng: Rng) -> tuple[float, Images]:
        return problem.slope(self.placed(problem, pattern, rng))

    def pattern(self, problem: Problem) -> Pattern | None:
        """Return the pattern for a pair, from the file or from training; None if the attack uses neither."""
        if self.file:
            return self.checked_pattern(read_array(self.file), problem)
        if not self.train:
            return None
        if problem.pair.severity not in self.learned:
            raise UsageError("train", f"only a run trains {self.name} (--attacks {self.label}); else, give file=")
        return self.learned[problem.pair.severity]

    @abstractmethod
    def first(self, problems: Sequence[Problem], rng: Rng) -> Pattern:
        """Return the initial pattern of the training."""

    @abstractmethod
    def placed(self, problem: Problem, pattern: Pattern, rng: Rng) -> Images:
        """Return the pair with the pattern, inside the ball; `rng` determines the position."""

    @abstractmethod
    def pulled(self, problem: Problem, gradient: Images, pattern: Pattern, rng: Rng) -> Pattern:
        """Compute the gradient of a pair's score with respect to the pattern; `rng` determines the position."""

    @abstractmethod
    def stepped(self, problem: Problem, pattern: Pattern, pull: Pattern, share: float) -> Pattern:
        """Take one training step; `share` is its share of the total step size."""

    @classmethod
    @abstractmethod
    def fits(cls, array: Pattern) -> bool:
        """Whether an array has the shape of a trained pattern."""

    @abstractmethod
    def checked_pattern(self, array: Pattern, problem: Problem) -> Pattern:
        """Check an array from a file and return it as a pattern for this pair."""


def read_file(path: str) -> bytes:
    """Read the bytes of a perturbation file."""
    file = user_path(path)
    try:
        if not file.is_file() or file.stat().st_size > _LARGEST:
            expected = f"a NumPy array (.npy) of at most {_LARGEST >> 20} MB, written by PCFA or by a run"
            raise DataError(path, f"not a file, or too large for a perturbation; give {expected}")
        return file.read_bytes()
    except (OSError, ValueError) as error:
        raise DataError(path, f"cannot be read: {getattr(error, 'strerror', None) or error}") from error


def read_array(path: str) -> Pattern:
    """Read a perturbation file as float32, without unpickling."""
    content, array = read_file(path), None
    with suppress(Exception):  # NumPy's parser can raise any exception on a manipulated header
        array = np.lib.format.open_memmap(user_path(path), mode="r") if content[:6] == b"\x93NUMPY" else None
    if array is None or array.dtype.kind != "f" or array.ndim not in (3, 4) or not 0 < array.size <= _LARGEST // 2:
        what = "damaged, or not a NumPy array (.npy)" if array is None else f"an array {array.dtype} {array.shape}"
        raise DataError(path, f"{what}; expected a floating-point array (3, H, W), (1, 3, H, W) or (2, 3, H, W)")
    values = np.array(array, np.float32)
    if not np.isfinite(values).all():
        raise DataError(path, "it contains NaN or infinite values")
    return values


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
        attack = super().made(**options)
        if attack.second and not attack.file:
            raise UsageError("second", "the perturbation of frame 2 needs file=, the perturbation of frame 1")
        return attack

    @property
    def source(self) -> str:
        """A digest of the files."""
        files = [read_file(path) for path in (self.file, self.second) if path]
        return digest_of_bytes(*files, size=8) if files else ""

    def check(self, model: AnyModel) -> None:
        if not self.train and not self.file:
            raise UsageError(
                "universal", "give training samples (universal:train=8) or a perturbation (universal:file=D.npy)"
            )
        super().check(model)

    def run(self, problem: Problem, rng: Rng) -> Images:
        pattern = self.pattern(problem)
        assert pattern is not None
        return self.placed(problem, pattern, rng)

    def first(self, problems: Sequence[Problem], rng: Rng) -> Pattern:
        shapes = [problem.ball.clean.shape[2:] for problem in problems]
        height, width = (max(sizes) for sizes in zip(*shapes, strict=True))
        ball = self._around_grey(problems[0], (height, width))
        return ball.random(rng) - ball.clean

    def placed(self, problem: Problem, pattern: Pattern, rng: Rng) -> Images:
        ball = problem.ball
        height, width = ball.clean.shape[2:]
        missing = [(0, 0), (0, 0), (0, max(height - pattern.shape[2], 0)), (0, max(width - pattern.shape[3], 0))]
        change = np.pad(pattern, missing, mode="wrap")[..., :height, :width]
        return ball.project(ball.clean + change)

    def pulled(self, problem: Problem, gradient: Images, pattern: Pattern, rng: Rng) -> Pattern:
        pull = np.zeros_like(pattern)
        height, width = gradient.shape[2:]
        pull[..., :height, :width] = gradient
        return pull

    def stepped(self, problem: Problem, pattern: Pattern, pull: Pattern, share: float) -> Pattern:
        ball = self._around_grey(problem, pattern.shape[2:])
        return ball.step(ball.clean + pattern, pull, _REACH * ball.budget * share) - ball.clean

    @classmethod
    def fits(cls, array: Pattern) -> bool:
        return array.ndim == 4 and array.shape[:2] == (2, 3) and array.size > 0

    def checked_pattern(self, array: Pattern, problem: Problem) -> Pattern:
        first, second = self._frames(array, self.file), None
        if self.second:
            second = self._frames(read_array(self.second), self.second)
            if len(first) != 1 or len(second) != 1 or first.shape != second.shape:
                raise DataError(self.second, f"{self.file} and it are not perturbations of two frames of equal size")
        shape, frames = first.shape[2:], problem.ball.clean.shape[2:]
        if shape != frames:
            sizes = f"{shape[0]}x{shape[1]} pixels, but sample '{problem.pair.key}' has {frames[0]}x{frames[1]}"
            raise DataError(self.file, f"it is for frames of {sizes}; give a file for this size")
        return np.concatenate([first, first if second is None else second]) if len(first) == 1 else first

    @staticmethod
    def _frames(array: Pattern, path: str) -> Pattern:
        whole = array[None] if array.ndim == 3 else array
        if whole.shape[1] != 3 or len(whole) > 2:
            raise DataError(path, f"an array {array.shape}; expected (3, H, W), (1, 3, H, W) or (2, 3, H, W)")
        return whole

    def _around_grey(self, problem: Problem, shape: tuple[int, ...]) -> Ball:
        """Return the ball around grey frames, where no value of a perturbation is clipped."""
        grey = np.full((*shape, 3), 128, np.uint8)
        return Ball(grey, grey, problem.ball.budget, self.norm, self.moved, problem.ball.per_frame)
