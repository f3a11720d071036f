"""The result of an attack on a pair: frames, flows, cost and warnings."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from ..core.types import Flow, Frame
from .ball import Images

Verdict = Literal["whole", "partial", "noise", "reversed", "zero", "not-finite"]
"""What a gradient is: the slope of the loss; correlated with it, but different in size or direction; unrelated; its
negative; zero everywhere; NaN or infinite somewhere."""

FOLLOWED = (*get_args(Verdict), "as-written")
"""What a row says of the gradient that its attack followed."""

WARNINGS = {
    "answers_differ": "the model is not deterministic: it predicts different flows for the same frames",
    "gradient_not_finite": "the gradient contained NaN or infinite values",
    "gradient_misleading": "the gradient is unrelated to the measured slope of the loss: it is masked or wrong",
    "gradient_reversed": "the gradient is the negative of the measured slope of the loss",
    "gradient_partial": "the gradient differs from the measured slope of the loss: parts of the network are cut off",
    "gradient_zero": "the gradient was zero everywhere: the model may be masking it",
    "nothing_gained": "the attacked pair has no larger error than the clean pair: the attack failed",
    "rounding": "rounding to 8 bits changes the effect by more than 5 %",
    "saturated": "more than 5 % of the values are 0 or 255, which the change of variables cannot move",
}
"""Warnings about the result of a single attack, by key."""

LOWER_BOUND = ("gradient_partial", "nothing_gained", "rounding", "saturated")
"""Warnings that a stronger attack may exist; with any other, the result says little about the robustness."""

BESIDE_OTHERS = {
    "fgsm_above_iterative": "FGSM is stronger: the gradient is masked, or the step size is unsuitable",
    "square_above_white_box": "Square, which uses no gradient, is stronger: the gradient is masked or wrong",
    "transfer_above_white_box": "frames attacked on a different model increase the error more",
}
"""Warnings based on a comparison with the other attacks of the run."""

EXPLAINED = {**WARNINGS, **BESIDE_OTHERS}
"""All warnings by key."""


@dataclass(frozen=True, eq=False)
class Attacked:
    """The result of an attack on a pair.

    Attributes:
        attack: name of the attack.
        budget: the budget in grey levels, or in % of the pixels for "area".
        norm: norm of the budget, "linf", "rms" or "area".
        frames: the attacked pair, RGB uint8 (H, W, 3), inside the budget.
        flow: the model's flow on the attacked frames, float32 (H, W, 2), pixels.
        clean_flow: the model's flow on the clean frames, float32 (H, W, 2), pixels.
        images: the attacked pair before rounding to 8 bits, float32 (2, 3, H, W) in 0..1.
        loss, clean_loss: loss of the attacked 8-bit frames and of the clean frames.
        float_loss: loss of `images`; None if the attack works on 8-bit frames.
        linf, rms: norms of the change over both 8-bit frames, grey levels.
        changed: share of the values that changed, 0..1.
        way_gone: share of the distance from the clean flow to the target that was covered, negative if the flow moved
            away from the target; None without a target.
        late_gain: how much the last quarter of the evaluations raised the highest score of the best start, in units of
            the loss, before rounding; None for fewer than eight evaluations.
        start_spread: difference between the highest scores of the best and of the worst start, before rounding; None
            with a single start.
        trace: the loss at each evaluation, in order.
        evaluations, gradients: number of flows computed by the attack and its checks, and number of those with a
            gradient.
        gradient: the gradient that the attack followed: "whole", "as-written", or what it was found to be instead
            ("partial", "noise", "reversed", "zero", "not-finite"); None if it followed none.
        warnings: keys of `WARNINGS`.
    """

    attack: str
    budget: float
    norm: str
    frames: tuple[Frame, Frame]
    flow: Flow
    clean_flow: Flow
    images: Images
    loss: float
    clean_loss: float
    float_loss: float | None
    linf: float
    rms: float
    changed: float
    way_gone: float | None
    late_gain: float | None
    start_spread: float | None
    trace: tuple[float, ...]
    evaluations: int
    gradients: int
    gradient: str | None
    warnings: tuple[str, ...]

    @property
    def moved(self) -> float:
        """Mean distance between the flows on the attacked and on the clean frames, over all pixels, in pixels
        (RCRE)."""
        difference = self.flow.astype(np.float64) - self.clean_flow
        return float(np.hypot(difference[..., 0], difference[..., 1]).mean())


def norms_of(frames: tuple[Frame, Frame], clean: tuple[Frame, Frame]) -> tuple[float, float, float]:
    """Return the largest change and its root mean square, in grey levels, and the share of changed values."""
    change = np.stack(frames).astype(np.int16) - np.stack(clean)
    squares = np.square(change, dtype=np.float64)
    return float(np.abs(change).max()), float(np.sqrt(squares.mean())), float(np.count_nonzero(change) / change.size)
