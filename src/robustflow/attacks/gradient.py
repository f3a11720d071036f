"""Check a model before a white-box attack: its gradient must be the slope of the loss, by finite differences."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from ..core.errors import ModelError
from ..core.rng import Rng
from ..core.types import Flow
from ..models.protocols import Differentiable, model_identity
from .ball import WHITE, Images
from .evaluation import Evaluation
from .result import Verdict

if TYPE_CHECKING:
    from .problem import Problem

TROUBLES: dict[Verdict, str] = {
    "partial": "gradient_partial",
    "noise": "gradient_misleading",
    "reversed": "gradient_reversed",
    "zero": "gradient_zero",
    "not-finite": "gradient_not_finite",
}
"""The warning for each verdict, see `result.WARNINGS`."""

_APART, _ROUNDING = 0.05, 0.01
"""Allowed mean distance of the flows of `predict` and `differentiable`: a share of their length, plus pixels."""
_STEP, _SHRINK = 1 / 64 / WHITE, 4
"""Root mean square of the first step of the finite differences, on the scale of `Images`, and the ratio of steps."""
_STEPS = {(True, True): (3, 11), (False, True): (0, 11), (True, False): (1, 6), (False, False): (-3, 4)}
"""Numbers of the first step and of the one after the last, by whether the direction is the gradient, along which the
loss bends most, and whether flows are in float64: rounding to float32 hides slopes over short steps."""
_AGREE, _DEVIATION = 0.03, 0.1
"""Largest difference of the slopes of two successive steps, and of the measured and the predicted slope, as shares of
the gradient's norm or of the slope."""
_DIRECTIONS, _FURTHER, _CORRELATED = 2, 4, 8.0
"""Number of random directions, how many more if the gradient is not the slope, and the smallest ratio of the slope
along the gradient to those along random directions of equal length: an unrelated gradient is a random direction."""

_Direction = npt.NDArray[np.float64]


def refuse_without_gradient(model: object, attack: str) -> None:
    """Check that a model provides the gradients that an attack needs."""
    if not isinstance(model, Differentiable):
        remedy = "use square, or add a method differentiable(images1, images2) (for tiny, install the extra torch)"
        raise ModelError(_name_of(model), f"it provides no gradient, which attack {attack} needs; {remedy}")


def _name_of(model: object) -> str:
    return model_identity(model).get("name") or type(model).__name__


def check_same_flow(model: object, differentiable: Flow, predicted: Flow, where: str) -> None:
    """Check that a model's `differentiable` computes the flow of its `predict`, both float32 (H, W, 2), in pixels."""
    usable = np.isfinite(predicted).all(axis=-1)
    if not usable.any():
        return
    lengths = np.linalg.norm(predicted[usable].astype(np.float64), axis=-1)
    apart = np.linalg.norm(differentiable[usable].astype(np.float64) - predicted[usable], axis=-1).mean()
    if not apart <= _APART * lengths.mean() + _ROUNDING:
        message = f"{where}, differentiable and predict differ by {apart:.3g} px on average"
        raise ModelError(_name_of(model), f"{message} (mean length {lengths.mean():.3g} px); return the same flow")


def check_gradient(problem: Problem, rng: Rng) -> None:
    """Compare the flows of `differentiable` and `predict`, and the gradient with measured slopes at a random pair.

    The verdict is stored in `problem.verdict`, its warning in `problem.troubles`; the cost is that of the attack.
    """
    where = f"on the clean pair of '{problem.pair.key}'" if problem.pair.key else "on the clean pair"
    check_same_flow(problem.model, problem.flow(problem.ball.clean), problem.clean_flow, where)
    problem.verdict = verdict = _verdict(problem, rng)
    if verdict in TROUBLES:
        problem.troubles.add(TROUBLES[verdict])


def _verdict(problem: Problem, rng: Rng) -> Verdict:
    images = problem.ball.random(rng)
    asked = Evaluation(problem.model, problem.pair.key, images=images, loss=problem.loss, whole=problem.whole)
    answer = problem.charged(asked)
    assert answer.gradient is not None
    gradient = answer.gradient.astype(np.float64)
    if not np.isfinite(gradient).all():
        return "not-finite"
    if not gradient.any():
        return "zero"
    norm, count = float(np.linalg.norm(gradient)), gradient.size
    along = gradient * (count**0.5 / norm)
    steps = _Steps(problem, images, problem.loss.slope(answer.flow)[1])
    predicted, measured = [], []
    for number, way in enumerate((along, *(_signs(rng, images) for _ in range(_DIRECTIONS)))):
        direction = steps.inside(way, along=not number)
        slope = float((gradient * direction).sum())
        scale = norm if number else slope or norm
        predicted.append(slope / scale)
        measured.append(steps.slope(direction, scale, along=not number) / scale)
    first, others, expected = measured[0], np.asarray(measured), np.asarray(predicted)
    allowed = _DEVIATION * np.maximum(np.abs(expected), 1)
    if (np.abs(others - expected) <= allowed).all():
        return "whole"
    if (np.abs(others + expected) <= allowed).all():
        return "reversed"
    further = [steps.once(_signs(rng, images)) / norm for _ in range(_FURTHER)]
    random = float(np.sqrt(np.square([*others[1:], *further]).mean()))
    return "partial" if abs(first) * count**0.5 >= _CORRELATED * random else "noise"


class _Steps:
    """Slopes of the loss along directions, by central differences, in float64 if the network can be evaluated so."""

    def __init__(self, problem: Problem, images: Images, above: Flow) -> None:
        self._problem, self._images, self._above = problem, images.astype(np.float64), above.astype(np.float64)
        self._exact = getattr(problem.model, "in_float64", None)

    def range(self, along: bool) -> tuple[int, int]:
        """Return the numbers of the first step and of the one after the last, along the gradient or not."""
        return _STEPS[along, self._exact is not None]

    def inside(self, way: _Direction, along: bool) -> _Direction:
        """Return a direction without the values at which the longest step would leave 0..1."""
        longest = _STEP / _SHRINK ** min(self.range(along)[0], 0)
        return np.where(np.minimum(self._images, 1 - self._images) > longest * np.abs(way), way, 0)

    def once(self, way: _Direction) -> float:
        """Return the slope along a random direction, over one step."""
        return self._difference(self.inside(way, along=False), _STEP / _SHRINK ** (self.range(along=False)[0] + 1))

    def slope(self, direction: _Direction, scale: float, along: bool) -> float:
        """Return the slope for which two successive steps agree, or else those of the two that differ least."""
        before, best, least = np.inf, np.nan, np.inf
        step = self.range(along)[0]
        while step < self.range(along)[1]:  # shorter once float64 has failed
            here = self._difference(direction, _STEP / _SHRINK**step)
            apart = abs(here - before) / max(abs(here), abs(scale))
            if not apart >= least:
                best, least = here, apart
            if least <= _AGREE:
                break
            before, step = here, step + 1
        return best

    def _difference(self, direction: _Direction, step: float) -> float:
        ends = [self._flow(self._images + sign * step * direction) for sign in (1, -1)]
        change = np.where(self._above == 0, 0, self._above * (ends[0].astype(np.float64) - ends[1]))
        return float(change.sum()) / (2 * step)

    def _flow(self, images: _Direction) -> Flow:
        asked = Evaluation(self._exact or self._problem.model, self._problem.pair.key, images=images)  # type: ignore[arg-type]
        if self._exact is not None:
            try:
                return self._problem.charged(asked).flow
            except ModelError:  # such as a network compiled for float32
                self._exact = None
        return self._problem.charged(replace(asked, model=self._problem.model, images=images.astype(np.float32))).flow


def _signs(rng: Rng, images: Images) -> _Direction:
    return np.where(rng.bits(images.size) & np.uint64(1), 1.0, -1.0).reshape(images.shape)
