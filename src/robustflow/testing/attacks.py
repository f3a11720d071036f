"""Check a user-defined attack before using it in a benchmark."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..attacks.api import load_attack
from ..attacks.images import Images, images_of
from ..attacks.problem import Pair
from ..sample import Flow, Frame
from ..severity import SEVERITIES
from .contract import frames_of, require

_SHAPES = ((32, 40), (17, 23))
"""An even and an odd frame size."""


class _Smooth:
    """A model whose u and v are the tanh of weighted sums of a pixel's values in both frames; it has a gradient
    everywhere, and is implemented in NumPy and in PyTorch.
    """

    _weights = np.array([[[3, -2, 1], [-1, 2, -3]], [[-1, 1, 2], [2, -3, 1]]], np.float32) / 4

    def predict(self, frame1: Frame, frame2: Frame) -> Flow:
        return self.flow(images_of(frame1, frame2))

    def flow(self, images: Images) -> Flow:
        values = images - np.float32(0.5)
        return np.asarray(10 * np.tanh(np.einsum("kfc,fchw->hwk", self._weights, values)), np.float32)

    def differentiable(self, images1: Any, images2: Any) -> Any:
        import torch

        values = torch.cat([images1, images2]) - 0.5
        return 10 * torch.tanh(torch.einsum("kfc,fchw->khw", torch.from_numpy(self._weights), values))[None]


def check_attack(attack: Any, seed: int = 0) -> str:
    """Check an attack on a small differentiable model at all five severities, and return the attack's name.

    The result must be float32, have the pair's shape, and lie within the budget both before and after rounding to 8
    bits. No other pair that the attack evaluated within the budget may score higher. The attack must not modify the
    given frames, and must return the same bytes for the same seed, even from a second instance of the class. It must
    work with and without ground truth, and on textured, black and white frames of even and odd sizes.

    Args:
        attack: the attack, as a class, an instance or a name; see docs/add-your-attack.md.
        seed: the seed for the random choices.

    Raises:
        UsageError: a check failed; the message states the problem, the severity and the frame size.

    >>> class Flip:
    ...     needs_gradients = False
    ...     def run(self, problem, rng):
    ...         ball = problem.ball
    ...         return ball.project(ball.clean + (2 * (ball.clean < 0.5) - 1) * ball.radius)
    >>> check_attack(Flip)
    'flip'
    """
    first, second = load_attack(attack), load_attack(attack)
    model = _Smooth()
    for shape in _SHAPES:
        for severity in SEVERITIES:
            where = f"attack '{first.name}' at severity {severity} on {shape[0]}x{shape[1]} pixels"
            texture, shifted, black, white = frames_of(shape)
            for frames in ((texture, shifted), (black, white)):
                truth = np.zeros((*shape, 2), np.float32) if severity % 2 else None
                pair = Pair(frames, first.budget(severity), truth, None, "check", seed, severity)
                before = [frame.copy() for frame in frames]
                problem = first.problem(model, pair, model.predict(*frames))
                images = first.run(problem, pair.stream(first.name))
                inside = problem.checked(images, first.name)
                require(inside is images, f"{where} exceeds its budget: end with problem.ball.project(images)")
                require(all(map(np.array_equal, frames, before)), f"{where} modifies its input frames: copy them first")
                found = problem.loss.score(problem.loss.of(model.flow(images), weighted=False))
                require(
                    not problem.trace or found >= problem.best_score - 1e-4,
                    f"{where} returns a pair with score {found:.4g} but evaluated one with score "
                    f"{problem.best_score:.4g}: return problem.best",
                )
                again = second.problem(model, pair, model.predict(*frames))
                require(
                    np.array_equal(images, second.run(again, pair.stream(second.name))),
                    f"{where} returns different bytes on the second call: draw all random numbers from `rng`",
                )
    return first.name
