"""Square: random search with squares, which only queries flows (Andriushchenko et al. 2020)."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ..core.rng import Rng
from .ball import WHITE, Images, frames_of, grey_levels_of
from .base import Attack
from .problem import Problem

_LARGEST = 0.8
"""Initial area of a square, as a fraction of the frame."""
_HALVED = (10, 50, 200, 500, 1000, 2000, 4000, 6000, 8000)
"""Numbers of queries, out of 10,000, after which the area of a square is halved."""
_Levels = np.typing.NDArray[np.int16]


@dataclass(frozen=True, kw_only=True)
class Square(Attack):
    """Random search: each query tries a random square in one frame and keeps it if the loss rises."""

    name: ClassVar[str] = "square"
    above: ClassVar[str] = "square_above_white_box"
    needs_gradients: ClassVar[bool] = False
    norms: ClassVar[tuple[str, ...]] = ("linf",)

    queries: int = 1000

    def run(self, problem: Problem, rng: Rng) -> Images:
        ball = problem.ball
        clean, budget = grey_levels_of(ball.clean), int(ball.budget)
        _, channels, height, width = clean.shape
        moved = range(2)[ball.perturbed]
        joint = self.moved == "joint"
        signs = np.zeros_like(clean)
        count = len(moved) * channels * width
        stripes = _signs(rng, count).reshape(len(moved), channels, 1, width)
        signs[list(moved)] = stripes[:1] if joint else stripes
        score = problem.score_of_frames(frames_of(self._inside(clean, signs * budget, joint)))
        for query in range(1, self.queries):
            part = _LARGEST / 2 ** bisect_right(_HALVED, query * 10_000 // self.queries)
            side = min(max(round(float(np.sqrt(part * height * width))), 1), height, width)
            top, left = rng.integer(0, height - side + 1), rng.integer(0, width - side + 1)
            chosen = [moved[rng.integer(0, len(moved))]] if not joint else list(moved)
            candidate = signs.copy()
            candidate[chosen, :, top : top + side, left : left + side] = _signs(rng, channels)[:, None, None]
            now = problem.score_of_frames(frames_of(self._inside(clean, candidate * budget, joint)))
            if now > score:
                score, signs = now, candidate
        return problem.best

    @staticmethod
    def _inside(clean: _Levels, change: _Levels, joint: bool) -> _Levels:
        if joint:
            change = np.clip(change, -clean.min(axis=0), WHITE - clean.max(axis=0))
        return np.clip(clean + change, 0, WHITE)


def _signs(rng: Rng, count: int) -> _Levels:
    """Draw -1 or 1 at random, int16 (count,)."""
    return 2 * (rng.bits(count) & np.uint64(1)).astype(np.int16) - 1
