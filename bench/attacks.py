"""Measure the cost of an attack relative to the model's own forward and backward passes, in CPU seconds per step.

    python bench/attacks.py [--steps 5] [--rounds 3]

The script uses one thread. The same gradients are computed once alone and once within PGD steps; the reported ratio is
that of the fastest rounds.
"""

from __future__ import annotations

import os

os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"))

import argparse
import time
from collections.abc import Callable
from typing import Any

import torch

from robustflow import load_model
from robustflow.attacks.ball import Ball
from robustflow.attacks.loss import Loss
from robustflow.attacks.problem import Pair, Problem
from robustflow.models.torch.network_model import reproducible
from robustflow.testing import TexturePairs

CASES = (("tiny", {}, (375, 1242)), ("raft_small", {"checkpoint": "random"}, (256, 320)))
"""A model, its options, and the frame size (H, W)."""


def passes(model: Any, ball: Ball, steps: int) -> None:
    """Run the forward and backward passes alone."""
    images = torch.from_numpy(ball.clean)
    with reproducible():
        for _ in range(steps):
            tensor = images.clone().requires_grad_()
            flow = model.differentiable(tensor[:1], tensor[1:])
            torch.autograd.grad(flow, tensor, torch.ones_like(flow))


def attack(problem: Problem, steps: int) -> None:
    """Run steps of PGD."""
    images = problem.ball.clean
    for _ in range(steps):
        _, gradient = problem.slope(images)
        images = problem.ball.step(images, gradient, 0.5)


def spent(call: Callable[..., None], *arguments: Any) -> float:
    """Measure the CPU seconds of a call."""
    start = time.process_time()
    call(*arguments)
    return time.process_time() - start


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=5)
    parser.add_argument("--rounds", type=int, default=3)
    given = parser.parse_args()
    for name, options, size in CASES:
        sample, model = TexturePairs(1, size).load("0"), load_model(name, device="cpu", **options)
        ball = Ball(*sample.frames, 4)
        pair = Pair(sample.frames, ball.budget, sample.flow, sample.valid)
        problem = Problem(model, ball, Loss(sample.flow, sample.valid), pair, sample.flow)
        rounds = [
            (spent(passes, model, ball, given.steps), spent(attack, problem, given.steps)) for _ in range(given.rounds)
        ]
        alone, attacked = (min(times) / given.steps for times in zip(*rounds, strict=True))
        share = 100 * (attacked / alone - 1)
        print(f"{name} {size[0]}x{size[1]}: passes {alone:.3f} s, PGD step {attacked:.3f} s, {share:+.1f} %")


if __name__ == "__main__":
    main()
