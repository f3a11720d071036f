"""Attacks made of others: transfer from a different model, and the worst of several (as in AutoAttack, Croce and Hein
2020).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any, ClassVar, Self

from ..core.errors import ModelError, UsageError, unknown_name
from ..core.files import digest_of_value
from ..core.rng import Rng
from ..models.calls import predict_checked
from ..models.loading import ModelRef
from ..models.objects import as_model
from ..models.protocols import AnyModel, FlowModel
from .api import load_attack
from .ball import NORMS, Images, frames_of, images_of
from .base import VARIANTS, Attack, Learned, run_attack
from .problem import Problem
from .trained import Trained


def _common(attack: Attack) -> dict[str, Any]:
    """Return the options that every attack has."""
    return {option.name: getattr(attack, option.name) for option in fields(Attack)}


def _label(parts: Sequence[str], options: dict[str, Any]) -> str:
    return ":".join([*parts, *(f"{name}={value}" for name, value in options.items())])


@dataclass(frozen=True, kw_only=True)
class Transfer(Attack):
    """Attack the same pair on a different model (the surrogate), and evaluate the result on the model under test."""

    name: ClassVar[str] = "transfer"
    above: ClassVar[str] = "transfer_above_white_box"
    needs_gradients: ClassVar[bool] = False
    argument: ClassVar[str] = "on"
    norms: ClassVar[tuple[str, ...]] = NORMS
    variants: ClassVar[tuple[str, ...]] = VARIANTS

    on: Any = "tiny"
    attack: Attack
    model_options: tuple[tuple[str, Any], ...] = ()

    @classmethod
    def made(cls, **options: Any) -> Self:
        """Build the inner attack from its options; the others are those of the surrogate, checked when it is loaded."""
        on, name = options.pop("on", "tiny"), options.pop("attack", "apgd")
        of_inner = load_attack(name).known_options()
        inner = load_attack(name, **{option: value for option, value in options.items() if option in of_inner})
        if isinstance(inner, Transfer | WorstOf):
            raise UsageError("attack", f"transfer cannot contain {inner.name}; use worst_of:transfer+...")
        rest = tuple((option, value) for option, value in options.items() if option not in of_inner)
        if rest and not isinstance(on, str):
            raise UsageError(rest[0][0], f"not an option of {inner.name}, and the model of transfer is already built")
        return cls(on=on, attack=inner, model_options=rest, **_common(inner))

    def with_variant(self, variant: str) -> Self:
        inner = self.attack.with_variant(variant)
        return replace(self, attack=inner, **_common(inner))

    def training(self, model: AnyModel) -> dict[str, tuple[Attack, AnyModel]]:
        return {self.label: (self.attack, self._surrogate)} if self.attack.trains else {}

    def with_learned(self, learned: Learned) -> Self:
        inner = self.attack
        if not (isinstance(inner, Trained) and inner.train):
            return self
        return replace(self, attack=replace(inner, learned=learned.get(self.label, {})))

    def known_options(self) -> set[str]:
        return {"on", "attack", *self.attack.known_options()}

    def options(self) -> dict[str, Any]:
        if not isinstance(self.on, str):
            raise UsageError("on", "in a run, the attack transfer needs the name of its model: transfer:MODEL")
        options = {"on": self.on, "attack": self.attack.name}
        chosen = {option: value for option, value in options.items() if value not in ("tiny", "apgd")}
        return {**chosen, **self.attack.options(), **dict(self.model_options)}

    @property
    def label(self) -> str:
        options = self.options()
        return _label([self.name, options.pop("on", "tiny")], options)

    @property
    def source(self) -> str:
        assert self._ref is not None
        return digest_of_value([self._ref.identity(self._surrogate), self.attack.source])

    @cached_property
    def _ref(self) -> ModelRef | None:
        return ModelRef.parse(self.on, self.model_options) if isinstance(self.on, str) else None

    @cached_property
    def _surrogate(self) -> AnyModel:
        return self._ref.load() if self._ref else as_model(self.on, "the model of the attack transfer")

    def check(self, model: AnyModel) -> None:
        if not isinstance(self._surrogate, FlowModel):
            raise ModelError("on", "the attack transfer needs a two-frame model as its surrogate")
        self.attack.check(self._surrogate)

    def run(self, problem: Problem, rng: Rng) -> Images:
        pair = problem.pair
        clean_flow = predict_checked(self._surrogate, pair.frames, pair.key, "clean", 0)  # type: ignore[arg-type]
        inner = self.attack.begun(self._surrogate, pair, clean_flow)
        images = run_attack(self.attack, inner, pair.stream(self.attack.name))
        problem.charge(inner)
        problem.adopt(inner)
        problem.trace += inner.trace
        return images


@dataclass(frozen=True, kw_only=True)
class WorstOf(Attack):
    """Run each attack as usual, evaluate its 8-bit frames, and keep the pair with the largest error."""

    name: ClassVar[str] = "worst_of"
    needs_gradients: ClassVar[bool] = False
    argument: ClassVar[str] = "parts"
    norms: ClassVar[tuple[str, ...]] = NORMS
    variants: ClassVar[tuple[str, ...]] = VARIANTS

    parts: tuple[Attack, ...]

    @classmethod
    def made(cls, **options: Any) -> Self:
        """Build the parts; an option applies to every part that has it, so that the label gives the same attack."""
        given: str | Sequence[str] = options.pop("parts", "apgd+square")
        names = given.split("+") if isinstance(given, str) else list(given)
        if not names or not all(isinstance(name, str) for name in names):
            raise UsageError("parts", "give the parts of worst_of by their names, as in worst_of:apgd+square")
        of_parts = [load_attack(name).known_options() for name in names]
        for option in options:
            if not any(option in options_of_part for options_of_part in of_parts):
                raise unknown_name("option of the attacks in worst_of", option, sorted(set().union(*of_parts)))
        parts = [_part(name, options) for name in names]
        if any(isinstance(part, WorstOf) for part in parts):
            raise UsageError("parts", "worst_of cannot contain another worst_of; name all parts: worst_of:A+B+C")
        norms = {part.norm for part in parts}
        if len(norms) != 1:
            of_each = ", ".join(f"{part.name} has norm {part.norm}" for part in parts)
            raise UsageError("norm", f"the parts of worst_of share a budget and need the same norm: {of_each}")
        every = {option: value for part in parts for option, value in part.options().items()}
        for part in parts:
            if (same := _part(part.name, every).label) != part.label:
                raise UsageError(part.label, f"in worst_of it would be {same}; list these attacks separately")
        shared = {each.name for each in fields(Attack)} - {"norm"}
        chosen = {option: value for option, value in (options | every).items() if option in shared}
        return cls(parts=tuple(parts), norm=norms.pop(), **chosen)

    def with_variant(self, variant: str) -> Self:
        return replace(self, parts=tuple(part.with_variant(variant) for part in self.parts))

    def training(self, model: AnyModel) -> dict[str, tuple[Attack, AnyModel]]:
        return {label: trained for part in self.parts for label, trained in part.training(model).items()}

    def with_learned(self, learned: Learned) -> Self:
        return replace(self, parts=tuple(part.with_learned(learned) for part in self.parts))

    @property
    def label(self) -> str:
        common = {each.name for each in fields(Attack)} - {"norm"}
        options = {name: value for name, value in self.options().items() if name in common}
        options |= {name: value for part in self.parts for name, value in part.options().items()}
        return _label([self.name, "+".join(part.name for part in self.parts)], options)

    @property
    def source(self) -> str:
        sources = [part.source for part in self.parts]
        return digest_of_value(sources) if any(sources) else ""

    @property
    def needs(self) -> str:
        return "gradients" if any(part.needs == "gradients" for part in self.parts) else "any model"

    def check(self, model: AnyModel) -> None:
        for part in self.parts:
            part.check(model)

    def run(self, problem: Problem, rng: Rng) -> Images:
        best, highest, pair, curves = problem.best, problem.best_score, problem.pair, problem.curves
        for part in self.parts:
            inner = part.begun(problem.model, pair, problem.clean_flow)
            frames = frames_of(inner.ball.to_8_bits(run_attack(part, inner, pair.stream(part.name))))
            score = problem.score_of_frames(frames)
            problem.charge(inner)
            if score > highest:
                best, highest, curves = images_of(*frames), score, inner.curves
                problem.adopt(inner)
        problem.curves = curves
        return best


def _part(name: str, options: dict[str, Any]) -> Attack:
    of_part = load_attack(name).known_options()
    return load_attack(name, **{option: value for option, value in options.items() if option in of_part})
