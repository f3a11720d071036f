"""PCFA: move the flow to a target with LBFGS and a penalty for exceeding the budget (Schmalfuss et al. 2022)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from ..core.errors import UsageError, unknown_name
from ..core.rng import Rng
from .ball import WHITE, Images
from .base import Attack
from .problem import Problem

if TYPE_CHECKING:
    from torch import Tensor

BOXES = ("change", "clipping")
_INSIDE = 1e-7
"""Margin of the change of variables at 0 and 1."""
_WEIGHT = 2500.0
"""Product of the penalty's weight and the bound; multiplied by 1.5 unless the target is zero flow."""
_SATURATED = 0.05
_ITERATIONS = 10
"""Number of LBFGS iterations per step."""


@dataclass(frozen=True, kw_only=True)
class Pcfa(Attack):
    """Minimise the distance to the target, plus a penalty on the mean square of the change over the budget."""

    name: ClassVar[str] = "pcfa"
    norms: ClassVar[tuple[str, ...]] = ("rms",)
    targets: ClassVar[tuple[str, ...]] = ("zero", "negative")
    variants: ClassVar[tuple[str, ...]] = ("default", "original")

    norm: str = "rms"
    target: str = "zero"
    steps: int = 20
    box: str = "change"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.box not in BOXES:
            raise unknown_name("box of attack pcfa", self.box, BOXES)
        if self.moved == "joint" and self.box != "clipping":
            raise UsageError("box", "pcfa with moved=joint requires box=clipping")

    def run(self, problem: Problem, rng: Rng) -> Images:
        from ..models.torch.network_model import reproducible

        if self.box == "change" and _saturated(problem.ball.clean) > _SATURATED:
            problem.troubles.add("saturated")
        with reproducible(getattr(problem.model, "threads", 1)):  # the sums in LBFGS depend on the number of threads
            search = _Search(self, problem)
            search.run(self.steps)
            return problem.best if self.variant == "default" else problem.ball.project(search.kept)


class _Search:
    """The optimisation variables, their objective, and the best pair so far."""

    def __init__(self, attack: Pcfa, problem: Problem) -> None:
        import torch

        self._problem = problem
        self._cut = attack.variant == "default"
        self._clean = torch.tensor(problem.ball.clean)
        self._bound = problem.ball.budget / WHITE
        self._weight = _WEIGHT / self._bound * (1.0 if attack.target == "zero" else 1.5)
        self._moved = range(2)[problem.ball.perturbed]
        frames = [self._clean[place].clone() for place in self._moved]
        if attack.moved == "joint":
            self.variables = [torch.zeros_like(frames[0])]
            self._pair: Callable[[], tuple[Tensor, Tensor]] = self._joint
        else:
            self._tanh, scale = attack.box == "change", 1 - _INSIDE
            self.variables = [torch.atanh(2 * scale * frame - scale) for frame in frames] if self._tanh else frames
            self._pair = self._separate
        for variable in self.variables:
            variable.requires_grad_()
        self.kept: Images = problem.ball.clean
        self._kept_size, self._kept_loss = np.inf, np.inf

    def run(self, steps: int) -> None:
        """Run LBFGS `steps` times, and check the pair before each step and after the last."""
        import torch

        optimizer = torch.optim.LBFGS(self.variables, max_iter=_ITERATIONS)
        for _ in range(steps):
            known: list[float] = [self.objective(keep=True)]
            optimizer.step(lambda known=known: known.pop() if known else self.objective())
        self.objective(keep=True)

    def objective(self, keep: bool = False) -> float:
        """Return the distance plus the penalty, and store its gradient; with `keep`, also update the best pair."""
        import torch

        for variable in self.variables:
            variable.grad = None
        with torch.enable_grad():
            images, change = self._pair()
            square = (change**2).sum() / change.numel()
            over = torch.clamp(square - self._bound**2, min=0)
        here = np.ascontiguousarray(images.detach().numpy())
        loss, _, gradient = self._problem.loss_and_gradient(here)
        self._problem.note(here, loss)
        if keep:
            self._keep(here, float(torch.sqrt(square.detach())), loss)
        total = images.mul(torch.from_numpy(gradient)).sum() + self._weight * over
        total.backward()
        return loss + self._weight * float(over.detach())

    def _keep(self, images: Images, size: float, loss: float) -> None:
        inside = size <= self._bound
        if self._cut and not (inside and self._problem.ball.holds(images)):
            self._problem.score(self._problem.ball.project(images))
        if self._kept_size <= self._bound:
            better = inside and loss < self._kept_loss
        else:
            better = inside or size < self._kept_size
        if better:
            self.kept, self._kept_size, self._kept_loss = images, size, loss

    def _separate(self) -> tuple[Tensor, Tensor]:
        """Compute the pair and its change from one variable per perturbed frame; the other frame stays clean."""
        import torch

        scale = 1 - _INSIDE
        frames = [
            (torch.tanh(values) + scale) / (2 * scale) if self._tanh else values.clamp(0, 1)
            for values in self.variables
        ]
        every = dict(zip(self._moved, frames, strict=True))
        change = torch.stack([frame - self._clean[place] for place, frame in every.items()])
        images = [every[place].clamp(0, 1) if place in every else self._clean[place] for place in (0, 1)]
        return torch.stack(images), change

    def _joint(self) -> tuple[Tensor, Tensor]:
        import torch

        (field,) = self.variables
        images = (self._clean + field).clamp(0, 1)
        low, high = self._clean.amin(dim=0), self._clean.amax(dim=0)
        change = ((field + high).clamp(0, 1) - high + low).clamp(0, 1) - low
        return images, torch.stack([change, change])


def _saturated(clean: Images) -> float:
    """Return the share of clean values that are 0 or 1."""
    return float(np.mean((clean == 0) | (clean >= np.float32((WHITE - 0.5) / WHITE))))
