"""The base class of attacks, which search inside a ball around a pair of frames for a high loss of the model's flow.

An attack has options but no state: the `Problem` records evaluations and results, and random numbers come from a stream
that is passed in, so the same pair, model, options and seed give the same frames.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import Field, dataclass, fields, replace
from functools import partial
from typing import Any, ClassVar, Self

import numpy as np
import numpy.typing as npt

from ..core.arguments import check_severity
from ..core.errors import UsageError, unknown_name
from ..core.plugins import called
from ..core.rng import Rng
from ..core.source_digest import source_digest
from ..core.types import Flow, Mask, read_only
from ..models.protocols import AnyModel
from .ball import GREY_LEVELS, MOVED, Ball, Images
from .gradient import check_gradient, refuse_without_gradient
from .loss import LOSSES, Loss
from .problem import Pair, Problem
from .registry import attack_spec

_PACKAGE = __name__.partition(".")[0] + "."

Pattern = npt.NDArray[np.float32]
"""A trained array: a perturbation for all pairs, or a patch."""

Learned = Mapping[str, Mapping[int, Pattern]]
"""Trained arrays by label (see `Attack.training`) and severity."""

VARIANTS = ("default", "flowbench", "original")
"""`default`: as in docs/attacks.md; `flowbench`: as in FlowBench's code; `original`: as in the authors' code."""

TARGETS = ("none", "zero", "negative")
"""The target flow: none (any flow far from the reference), zero everywhere, or the negated clean flow."""

REFERENCES = ("auto", "truth", "clean")
"""What an untargeted attack moves away from; `auto` is the ground truth if there is any, else the clean flow."""

GRADIENTS = ("auto", "whole", "as-written")
"""Which gradient of a network is followed: through its `detach` calls, or as autograd gives it; `auto` is `whole`,
except in variants, which repeat published code."""


@dataclass(frozen=True, kw_only=True)
class Attack(ABC):
    """One attack with its options.

    Subclasses set `name` and `norm`, add options as fields with defaults, and implement `run`.

    Args:
        variant: one of `VARIANTS`.
        target: one of `TARGETS`.
        loss: one of `loss.LOSSES`.
        reference: one of `REFERENCES`, for untargeted attacks.
        moved: one of `ball.MOVED`.
        gradient: one of `GRADIENTS`.

    Raises:
        UsageError: an unknown option.
    """

    name: ClassVar[str]
    needs_gradients: ClassVar[bool] = True
    control: ClassVar[bool] = False
    """Whether the attack is a control: random noise with which attacks are compared, and which needs no model."""
    agreeing: ClassVar[bool] = False
    """Whether the loss weights pixels as in CosPGD."""
    variants: ClassVar[tuple[str, ...]] = ("default",)
    norms: ClassVar[tuple[str, ...]] = ("linf", "rms")
    targets: ClassVar[tuple[str, ...]] = TARGETS
    above: ClassVar[str] = ""
    """The warning (`result.BESIDE_OTHERS`) about an iterative white-box attack that is weaker than this one."""
    argument: ClassVar[str] = ""
    """The option that can follow the attack's name without a key: `transfer:tiny` is `transfer` with `on="tiny"`."""

    variant: str = "default"
    norm: str = "linf"
    target: str = "none"
    loss: str = "epe"
    reference: str = "auto"
    moved: str = "both"
    gradient: str = "auto"

    def __post_init__(self) -> None:
        choices = {"variant": self.variants, "norm": self.norms, "target": self.targets}
        choices |= {"reference": REFERENCES, "loss": LOSSES, "moved": MOVED, "gradient": GRADIENTS}
        for option, choice in choices.items():
            if getattr(self, option) not in choice:
                raise unknown_name(f"{option} of attack {self.name}", str(getattr(self, option)), choice)
        for option_field in fields(self):
            value = getattr(self, option_field.name)
            if isinstance(option_field.default, int) and (
                not isinstance(value, int) or isinstance(value, bool) or value < 1
            ):
                raise UsageError(option_field.name, f"must be an integer of at least 1 for {self.name}, not {value!r}")

    def __getstate__(self) -> dict[str, Any]:
        return {each.name: getattr(self, each.name) for each in fields(self)}  # without models that it has loaded

    def budget(self, severity: int) -> float:
        """Return the budget of a severity, in grey levels or in % of the pixels."""
        return GREY_LEVELS[self.norm][check_severity(severity) - 1]

    @classmethod
    def made(cls, **options: Any) -> Self:
        """Build the attack with options; strings are converted if the option is a number."""
        defaults = {option_field.name: option_field.default for option_field in cls._option_fields()}
        for option, value in options.items():
            if option not in defaults:
                raise unknown_name(f"option of attack {cls.name}", option, defaults)
            if isinstance(defaults[option], int) and isinstance(value, str) and value.isdecimal():
                options[option] = int(value)
            if isinstance(defaults[option], float):
                with suppress(ValueError):  # refused in `__post_init__`
                    options[option] = float(value)
        return cls(**options)

    def with_variant(self, variant: str) -> Self:
        """Return the attack in a variant, or unchanged if it does not support the variant or already has one."""
        chosen = self.variant == "default" and variant in self.variants
        return replace(self, variant=variant) if chosen else self

    def known_options(self) -> set[str]:
        """The names of all options."""
        return {option.name for option in self._option_fields()}

    def options(self) -> dict[str, Any]:
        """The options that differ from their defaults."""
        values = ((option, getattr(self, option.name)) for option in self._option_fields())
        return {option.name: value for option, value in values if value != option.default}

    @classmethod
    def _option_fields(cls) -> list[Field[Any]]:
        return [option for option in fields(cls) if option.compare]

    @property
    def label(self) -> str:
        """The name with all options that differ from their defaults, as accepted by `load_attack`: `pgd:steps=40`."""
        text = ":".join([self.name, *(f"{option}={value}" for option, value in self.options().items())])
        return text if attack_spec(text).norm == self.norm else f"{text}:norm={self.norm}"

    @property
    def source(self) -> str:
        """A digest of what affects the frames beside the label: a second model, the user's code; empty for most."""
        return "" if is_of_package(type(self)) else source_digest(type(self))

    @property
    def trains(self) -> str:
        """The training samples: their number, or a file that lists them; empty for attacks without training."""
        return ""

    def training(self, model: AnyModel) -> dict[str, tuple[Attack, AnyModel]]:
        """Return the attacks that a run has to train for this one, and the model of each, keyed by label."""
        return {}

    def with_learned(self, learned: Learned) -> Self:
        """Return the attack with perturbations that were trained by a run."""
        return self

    @property
    def needs(self) -> str:
        """What the attack needs from a model: "gradients", "any model" (only flows) or "nothing"."""
        return "gradients" if self.needs_gradients else "nothing" if self.control else "any model"

    def check(self, model: AnyModel) -> None:
        """Raise a ModelError if the model lacks something that the attack needs."""
        if self.needs_gradients:
            refuse_without_gradient(model, self.name)

    def problem(self, model: AnyModel, pair: Pair, clean_flow: Flow) -> Problem:
        """Build the optimisation problem for a pair, given the model's flow on the clean frames (H, W, 2), pixels."""
        first, second = map(read_only, pair.frames)
        clean_flow = read_only(clean_flow)
        truth, valid = (None if array is None else read_only(array) for array in (pair.truth, pair.valid))
        pair = replace(pair, frames=(first, second), truth=truth, valid=valid)
        ball = Ball(first, second, pair.budget, self.norm, self.moved, per_frame=self.variant == "flowbench")
        ball.clean.flags.writeable = False
        loss, from_clean = self._loss(clean_flow, pair)
        whole = self.gradient == "whole" or (self.gradient == "auto" and self.variant == "default")
        return Problem(model, ball, loss, pair, clean_flow, from_clean, whole)

    def begun(self, model: AnyModel, pair: Pair, clean_flow: Flow) -> Problem:
        """Build the problem (see `problem`), and check the model's gradient if the attack needs one."""
        problem = self.problem(model, pair, clean_flow)
        if self.needs_gradients:
            check_gradient(problem, pair.stream("gradient"))
        return problem

    def _loss(self, clean_flow: Flow, pair: Pair) -> tuple[Loss, bool]:
        """Return the loss, and whether the loss is the distance to the clean flow."""
        if self.target != "none":
            target = -clean_flow if self.target == "negative" else np.zeros_like(clean_flow)
            return Loss(target, _counted(None, clean_flow), self.loss, towards=True, agreeing=self.agreeing), False
        if pair.truth is None or self.reference == "clean":
            if self.reference == "truth":
                raise UsageError("reference", "the pair has no ground truth; pass flow=, or omit reference=truth")
            return Loss(clean_flow, _counted(None, clean_flow), self.loss, agreeing=self.agreeing), True
        truth, valid = pair.truth, pair.valid
        if self.variant == "flowbench" and valid is not None:  # its code counts unknown pixels, with flow 0
            truth, valid = np.where(valid[..., None], truth, np.float32(0)), None
        return Loss(truth, _counted(valid, clean_flow), self.loss, agreeing=self.agreeing), False

    @abstractmethod
    def run(self, problem: Problem, rng: Rng) -> Images:
        """Run the attack and return the attacked pair, which lies inside the ball.

        Args:
            problem: the model, the ball and the loss.
            rng: the source of all random numbers; each random start spawns a separate generator.

        Returns:
            float32 (2, 3, H, W).
        """


def _counted(valid: Mask | None, clean_flow: Flow) -> Mask | None:
    """Return the valid pixels at which the clean flow is finite; all valid pixels if it is finite at none of them."""
    counted = np.asarray(np.isfinite(clean_flow).all(axis=-1))
    counted = counted if valid is None else counted & valid
    return counted if counted.any() else valid


def is_of_package(kind: type[Attack]) -> bool:
    """Whether a class of attacks is part of this package."""
    return kind.__module__.startswith(_PACKAGE)


def run_attack(attack: Attack, problem: Problem, rng: Rng) -> Images:
    """Run an attack; convert exceptions of a user's subclass to a `UsageError`."""
    run = partial(attack.run, problem, rng)
    return run() if is_of_package(type(attack)) else called(attack.name, "run", run, read_only="the pair")
