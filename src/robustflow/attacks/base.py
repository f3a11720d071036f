"""What an attack is: it moves a pair of frames inside a ball so that a loss of the model's flow grows.

An attack has options and no state: what it asks and what it found are in the `Problem`, its random choices come from
the stream that it is given. So the same pair, model, options and seed give the same frames.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, fields
from typing import Any, ClassVar

from ..errors import UsageError, unknown_name
from ..random.rng import Rng
from ..severity import check_severity
from .ball import GREY_LEVELS, MOVED, NORMS
from .images import Images
from .loss import LOSSES
from .problem import Problem

FAMILY = "adversarial"
"""The family of every attack, and of no corruption: it is never part of the paper's means."""

VARIANTS = ("default", "flowbench", "original")
"""`default`: as docs/attacks.md defines it; `flowbench`: what FlowBench's code does where that differs; `original`:
what the code of an attack's authors does."""

TARGETS = ("none", "zero", "negative")
"""What the flow is to become: anything that is far from the reference, zero everywhere, or minus the clean flow."""

REFERENCES = ("auto", "truth", "clean")
"""What an untargeted attack moves the flow away from; `auto` is the ground truth where there is one."""


@dataclass(frozen=True, kw_only=True)
class Attack(ABC):
    """One attack with its options.

    Subclasses set `name` and `norm`, add options as fields with defaults, and implement `run`.

    Args:
        variant: one of `VARIANTS`.
        target: one of `TARGETS`.
        loss: one of `loss.LOSSES`.
        reference: one of `REFERENCES`, for an attack without a target.
        moved: one of `ball.MOVED`.

    Raises:
        UsageError: an option that there is not.
    """

    name: ClassVar[str]
    needs_gradients: ClassVar[bool] = True
    control: ClassVar[bool] = False
    """Random noise that asks the model nothing, beside which an attack is judged."""
    agreeing: ClassVar[bool] = False
    """Whether pixels count by CosPGD's weight."""
    variants: ClassVar[tuple[str, ...]] = ("default",)
    norms: ClassVar[tuple[str, ...]] = NORMS
    targets: ClassVar[tuple[str, ...]] = TARGETS

    variant: str = "default"
    norm: str = "linf"
    target: str = "none"
    loss: str = "epe"
    reference: str = "auto"
    moved: str = "both"

    def __post_init__(self) -> None:
        choices = {
            "variant": self.variants,
            "norm": self.norms,
            "target": self.targets,
            "reference": REFERENCES,
            "loss": LOSSES,
            "moved": MOVED,
        }
        for option, choice in choices.items():
            if getattr(self, option) not in choice:
                raise unknown_name(f"{option} of attack {self.name}", str(getattr(self, option)), choice)
        for each in fields(self):
            value = getattr(self, each.name)
            if isinstance(each.default, int) and (not isinstance(value, int) or isinstance(value, bool) or value < 1):
                raise UsageError(f"{each.name} of attack {self.name} is a whole number from 1, not {value!r}")

    @property
    def masked(self) -> bool:
        """Whether only pixels with valid ground truth count; FlowBench's code counts all, with flow 0 where there is
        no truth."""
        return self.variant != "flowbench"

    @property
    def per_frame(self) -> bool:
        """Whether a budget of the norm "rms" holds for each frame by itself, as in FlowBench's code."""
        return self.variant == "flowbench"

    def budget(self, severity: int) -> float:
        """The budget of a severity in grey levels.

        Raises:
            UsageError: no such severity.
        """
        return GREY_LEVELS[self.norm][check_severity(severity) - 1]

    def options(self) -> dict[str, Any]:
        """The options that are not the default ones."""
        return {each.name: value for each in fields(self) if (value := getattr(self, each.name)) != each.default}

    @abstractmethod
    def run(self, problem: Problem, rng: Rng) -> Images:
        """The attacked pair, inside the ball.

        Args:
            problem: model, ball, loss.
            rng: every random choice; spawned by the number of the start where there are several.

        Returns:
            float32 (2, 3, H, W).
        """
