"""A problem whose model and gradient are written in NumPy, so that attacks can be tested without PyTorch."""

import numpy as np

from robustflow.attacks import load_attack
from robustflow.attacks.ball import images_of
from robustflow.attacks.problem import Pair, Problem

WEIGHTS = np.random.default_rng(5).normal(0, 1, (2, 2, 3))
"""Weight of each frame's colours in u and v."""


class Curved:
    """u and v are 10 sin of weighted sums of the pixel's colours in both frames: attacks overshoot its maxima."""

    def predict(self, frame1, frame2):
        return curved_flow(images_of(frame1, frame2))[0]


def curved_flow(images):
    """The flow (H, W, 2) and the derivative of u and v by their sums."""
    sums = 4 * np.einsum("kfc,fchw->hwk", WEIGHTS, images.astype(np.float64))
    return (10 * np.sin(sums)).astype(np.float32), 10 * np.cos(sums)


class NumpyProblem(Problem):
    """A problem that keeps the images of which an attack asked the gradient or the flow."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self.asked = []

    def flow(self, images):
        self.evaluations += 1
        self.asked.append(images.copy())
        return curved_flow(images)[0]

    def loss_and_gradient(self, images):
        self.evaluations += 1
        self.gradients += 1
        self.asked.append(images.copy())
        flow, inner = curved_flow(images)
        loss, slope = self.loss.slope(flow)
        gradient = 4 * np.einsum("hwk,kfc->fchw", slope * inner, WEIGHTS)
        return loss, flow, gradient.astype(np.float32)


def numpy_problem(name: str, budget: float = 12, seed: int = 0, **options):
    """An attack, and its problem on a pair of random frames whose ground truth is zero flow."""
    attack = load_attack(name, **options)
    frames = tuple(np.random.default_rng(seed).integers(0, 256, (2, 5, 6, 3)).astype(np.uint8))
    pair = Pair(frames, budget, np.zeros((5, 6, 2), np.float32), seed=seed)
    made = attack.problem(Curved(), pair, Curved().predict(*frames))
    return attack, NumpyProblem(made.model, made.ball, made.loss, pair, made.clean_flow, made.from_clean)
