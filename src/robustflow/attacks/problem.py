"""The optimisation problem of an attack: the loss of a pair, its gradient, and the cost so far."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..core.errors import UsageError
from ..core.rng import Rng
from ..core.types import Flow, Frame, Mask, described_array
from ..models.protocols import AnyModel
from .ball import Ball, Images, frames_of, images_of
from .evaluation import Answer, Evaluation, evaluate
from .loss import Loss
from .result import Verdict

_FEWEST = 8


@dataclass(frozen=True, eq=False)
class Pair:
    """A pair to attack, independent of the model and the attack."""

    frames: tuple[Frame, Frame]
    budget: float
    truth: Flow | None = None
    valid: Mask | None = None
    key: str = ""
    seed: int = 0
    severity: int = 0

    def stream(self, attack: str) -> Rng:
        """Return the random stream of an attack on this pair, the same inside a composite attack."""
        return Rng.of(self.seed, "attack", attack, self.severity, self.key)


@dataclass
class Problem:
    """A pair, a model, a loss and a ball.

    Args:
        model: the attacked model.
        ball: the ball around the clean pair.
        loss: the loss to maximise.
        pair: the clean pair.
        clean_flow: the model's flow on the clean pair, float32 (H, W, 2), pixels.
        from_clean: whether the loss is the distance to the clean flow, which has no gradient at the clean pair.
        whole: whether networks are differentiated through `detach`.

    Attributes:
        evaluations: number of flows computed for the attack and its checks, with and without gradient.
        gradients: number of evaluations with a gradient.
        trace: the loss of each evaluation, without CosPGD's weight.
        curves: for each start, the highest score so far after each of its evaluations.
        troubles: keys of `result.WARNINGS` for events that make the result doubtful.
        verdict: what the check of the gradient found; None without a check.
    """

    model: AnyModel
    ball: Ball
    loss: Loss
    pair: Pair
    clean_flow: Flow
    from_clean: bool = False
    whole: bool = True
    evaluations: int = 0
    gradients: int = 0
    trace: list[float] = field(default_factory=list)
    curves: list[list[float]] = field(default_factory=lambda: [[]])
    best_score: float = field(init=False)
    troubles: set[str] = field(default_factory=set)
    verdict: Verdict | None = None

    def __post_init__(self) -> None:
        score = self.loss.score(self.loss.of(self.clean_flow, weighted=False))
        self._keep(self.ball.clean, score if np.isfinite(score) else -np.inf)

    def _keep(self, images: Images, score: float) -> None:
        self._best, self._best_copy, self.best_score = images, images.copy(), score

    @property
    def best(self) -> Images:
        """The images inside the ball with the highest score so far, even if the attack overwrote the array since."""
        if not np.array_equal(self._best, self._best_copy):
            self._best = self._best_copy
        return self._best

    def loss_at(self, images: Images) -> float:
        """Return the loss of images without CosPGD's weight, which is not recorded."""
        if images is self.ball.clean:
            return self.loss.of(self.clean_flow, weighted=False)
        if images is self.best:
            return self.loss.score(self.best_score)
        return self.loss.of(self.flow(images), weighted=False)

    def score(self, images: Images) -> float:
        """Compute the score of images. Images inside the ball with a higher score than `best` replace it."""
        return self.note(images, self.loss.of(self.flow(images), weighted=False))

    def query(self, images: Images) -> float:
        """Compute the score of images after rounding to 8 bits, for attacks without gradients."""
        return self.score_of_frames(frames_of(self.ball.to_8_bits(images)))

    def score_of_frames(self, frames: tuple[Frame, Frame]) -> float:
        """Compute the score of 8-bit frames, for attacks without gradients."""
        flow = self.charged(Evaluation(self.model, self.pair.key, frames=frames)).flow
        return self.note(images_of(*frames), self.loss.of(flow))

    def flow(self, images: Images) -> Flow:
        """Predict the flow of images without rounding them to grey levels, float32 (H, W, 2)."""
        return self.charged(Evaluation(self.model, self.pair.key, images=images)).flow

    def charged(self, asked: Evaluation) -> Answer:
        """Evaluate the model, and count the cost."""
        self.evaluations += 1
        self.gradients += asked.loss is not None
        return evaluate(asked)

    def slope(self, images: Images) -> tuple[float, Images]:
        """Compute the score of images and its gradient, which includes CosPGD's weight if the loss does."""
        loss, flow, gradient = self.loss_and_gradient(images)
        plain = self.loss.of(flow, weighted=False) if self.loss.agreeing else loss
        return self.note(images, plain), -gradient if self.loss.towards else gradient

    def loss_and_gradient(self, images: Images) -> tuple[float, Flow, Images]:
        """Compute the loss, the flow (H, W, 2), and the gradient of the loss; not recorded."""
        answer = self.charged(Evaluation(self.model, self.pair.key, images=images, loss=self.loss, whole=self.whole))
        gradient = answer.gradient
        assert gradient is not None
        if not np.isfinite(gradient).all():
            self.troubles.add("gradient_not_finite")
            gradient = np.nan_to_num(gradient, nan=0.0, posinf=0.0, neginf=0.0)
        if not gradient.any():
            self.troubles.add("gradient_zero")
        return answer.value, answer.flow, gradient

    def checked(self, images: Any, attack: str) -> Images:
        """Project the images that an attack returned into the ball, after a check of their shape and values."""
        shape = self.ball.clean.shape
        if not isinstance(images, np.ndarray) or images.dtype != np.float32 or images.shape != shape:
            raise UsageError(attack, f"run returned {described_array(images)}, not a float32 array of shape {shape}")
        if not np.isfinite(images).all():
            raise UsageError(attack, "run returned values that are NaN or infinite")
        return images if self.ball.holds(images) else self.ball.project(images)

    def charge(self, other: Problem) -> None:
        """Add the cost of another problem to this one."""
        self.evaluations += other.evaluations
        self.gradients += other.gradients

    def adopt(self, other: Problem) -> None:
        """Take over what is known about the gradient that another problem's attack followed."""
        self.troubles, self.verdict, self.whole = other.troubles, other.verdict, other.whole

    @property
    def gradient(self) -> str | None:
        """The gradient that the attack followed: "whole", "as-written", or the verdict against it; None for none."""
        return self.verdict if self.whole or self.verdict is None else "as-written"

    def begin(self) -> None:
        """Begin a new start: later evaluations belong to a new curve."""
        if self.curves[-1]:
            self.curves.append([])

    def note(self, images: Images, loss: float) -> float:
        """Record a loss, update `best`, and return the score."""
        self.trace.append(loss)
        score, curve = self.loss.score(loss), self.curves[-1]
        highest = curve[-1] if curve else -np.inf
        if score > highest and self.ball.holds(images):
            highest = score
            if score > self.best_score:
                self._keep(images, score)
        curve.append(highest)
        return score

    @property
    def start_spread(self) -> float | None:
        """The difference between the highest scores of the best and of the worst start; None with a single start."""
        ends = [curve[-1] for curve in self.curves if curve]
        return _finite(max(ends) - min(ends)) if len(ends) > 1 else None

    @property
    def late_gain(self) -> float | None:
        """How much the last quarter of the evaluations raised the highest score of the best start; None for few."""
        curve = max(self.curves, key=lambda start: start[-1] if start else -np.inf)
        if len(curve) < _FEWEST:
            return None
        clean = self.loss.score(self.loss.of(self.clean_flow, weighted=False))
        return _finite(max(curve[-1], clean) - max(curve[-1 - len(curve) // 4], clean))


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
