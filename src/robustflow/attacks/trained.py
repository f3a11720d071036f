"""Attacks trained once, on samples that are not measured, and then applied to others."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
import numpy.typing as npt

from ..digest import digest_of_bytes
from ..errors import DataError, UsageError
from ..models.base import AnyModel
from ..random.rng import Rng
from ..sample import Flow
from .base import Attack
from .images import Images
from .problem import Pair, Problem, refuse_without_gradient

Pattern = npt.NDArray[np.float32]
"""What is trained: the change of all pairs, or the patch."""

_MOMENTUM = 0.75
"""Weight of the gradients before this step's."""
_SMALLEST = 1e-30
_LARGEST = 2**28
"""Bytes of a perturbation file."""


@dataclass(frozen=True, kw_only=True)
class Trained(Attack):
    """A pattern that is the same for every sample.

    Args:
        train: samples for training in a run: their number, drawn by the run's seed from those that are not measured, or
            a file of their keys. Each severity has its own pattern.
        file: a pattern that is stored as a NumPy array (.npy), instead of training.
        steps: of the training, each with a gradient for every sample.
        learned: pattern of each severity that was trained; a run fills it in.
    """

    moves: ClassVar[bool] = False
    """Whether it is put at a different place in every step of the training."""

    train: str = ""
    file: str = ""
    steps: int = 10
    learned: Mapping[int, Pattern] = field(default_factory=dict, compare=False, repr=False)

    @classmethod
    def made(cls, **options: Any) -> Self:
        """See `Attack.made`.

        Raises:
            UsageError: both a file and samples to train on.
        """
        if "train" in options:
            options["train"] = str(options["train"])
        attack = super().made(**options)
        if attack.train and attack.file:
            raise UsageError(f"attack {attack.name}: give samples to train on or a file, not both")
        if attack.train.isdecimal() and not int(attack.train):
            raise UsageError(f"attack {attack.name}: train=0 leaves nothing to train on")
        return attack

    @property
    def trains(self) -> str:
        """See `Attack.trains`."""
        return self.train

    @property
    def source(self) -> str:
        """A digest of the file; what it is trained on is added by a run."""
        return digest_of_bytes(read_file(self.file), size=8) if self.file else ""

    @property
    def needs(self) -> str:
        """See `Attack.needs`."""
        return "any model"

    def check(self, model: AnyModel) -> None:
        """Raise if it is to be trained and the model has no gradients.

        Raises:
            ModelError: it has none.
        """
        if self.train:
            refuse_without_gradient(model, self.name)

    def learn(self, model: AnyModel, pairs: Sequence[tuple[Pair, Flow]], rng: Rng) -> Pattern:
        """Train the pattern: ascent on the mean score of all samples along a running mean of the gradients, in steps
        that become shorter.

        The best pattern is kept; the last one, where a pattern is put at a different place in every step (`moves`), so
        that the scores of two steps cannot be compared.

        Args:
            model: with gradients.
            pairs: each with the model's flow of its clean frames, all of one budget.
            rng: of the first pattern and of the places.
        """
        problems = [self.problem(model, pair, clean_flow) for pair, clean_flow in pairs]
        pattern = self.first(problems, rng)
        best, highest, mean = pattern, -np.inf, np.zeros_like(pattern)
        for step in range(self.steps + (not self.moves)):
            score, pull = 0.0, np.zeros_like(pattern)
            for number, problem in enumerate(problems):
                here, gradient = problem.slope(self.placed(problem, pattern, rng.spawn(step, number)))
                score += here
                pull += self.pulled(problem, gradient, pattern, rng.spawn(step, number))
            if score > highest:
                best, highest = pattern, score
            mean = _MOMENTUM * mean + pull / max(float(np.abs(pull).mean()), _SMALLEST)
            pattern = self.stepped(problems[0], pattern, mean, 2 * (1 - step / self.steps) / self.steps)
        return pattern if self.moves else best

    def pattern(self, problem: Problem) -> Pattern | None:
        """The pattern for a pair: from the file or from training; None without either.

        Raises:
            UsageError: it was not trained at this severity.
        """
        if self.file:
            return self.checked_pattern(read_array(self.file), problem)
        if not self.train:
            return None
        if problem.pair.severity not in self.learned:
            raise UsageError(
                f"attack {self.name} is trained in a run (robustflow run --attacks {self.label}); here give file="
            )
        return self.learned[problem.pair.severity]

    @abstractmethod
    def first(self, problems: Sequence[Problem], rng: Rng) -> Pattern:
        """The pattern that training begins with."""

    @abstractmethod
    def placed(self, problem: Problem, pattern: Pattern, rng: Rng) -> Images:
        """The pair with the pattern, inside the ball; the stream says where it is."""

    @abstractmethod
    def pulled(self, problem: Problem, gradient: Images, pattern: Pattern, rng: Rng) -> Pattern:
        """The gradient of a pair's score with respect to the pattern, which is where the stream says."""

    @abstractmethod
    def stepped(self, problem: Problem, pattern: Pattern, pull: Pattern, share: float) -> Pattern:
        """The pattern one step uphill; the shares of all steps have the sum 1."""

    @abstractmethod
    def checked_pattern(self, array: Pattern, problem: Problem) -> Pattern:
        """The array of a file as a pattern for this pair.

        Raises:
            DataError: it has another shape.
        """


def read_file(path: str) -> bytes:
    """The bytes of a perturbation file.

    Raises:
        DataError: no such file, or one that is too large.
    """
    file = Path(path).expanduser()
    try:
        if not file.is_file():
            raise DataError(f"{path} is not a file; give a NumPy array (.npy), as PCFA or a run wrote it")
        if file.stat().st_size > _LARGEST:
            raise DataError(f"{path} has more than {_LARGEST >> 20} MB: no perturbation is as large")
        return file.read_bytes()
    except (OSError, ValueError) as error:
        raise DataError(f"{path} cannot be read: {getattr(error, 'strerror', None) or error}") from error


def read_array(path: str) -> Pattern:
    """A perturbation file as float32; nothing in it is run.

    Raises:
        DataError: not a NumPy array of finite floating-point numbers with three or four axes.
    """
    content = read_file(path)
    file = Path(path).expanduser()
    try:
        array = np.lib.format.open_memmap(file, mode="r") if content[:6] == b"\x93NUMPY" else None
    except Exception as error:  # whatever a hostile header makes NumPy's parser raise
        raise DataError(f"{path} is damaged, or no array of numbers ({' '.join(str(error).split())[:100]})") from error
    if array is None or array.dtype.kind != "f" or array.ndim not in (3, 4) or not 0 < array.size <= _LARGEST // 2:
        what = "no NumPy array (.npy)" if array is None else f"an array {array.dtype} {array.shape}"
        raise DataError(f"{path} is {what}; a perturbation is floating-point, (3, H, W) or (1 or 2, 3, H, W)")
    values = np.array(array, np.float32)
    if not np.isfinite(values).all():
        raise DataError(f"{path} has values that are NaN or infinite")
    return values
