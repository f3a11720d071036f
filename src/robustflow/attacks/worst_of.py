"""Worst of: the strongest of several attacks on each pair, as in AutoAttack (Croce and Hein 2020)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, ClassVar, Self

from ..core.errors import UsageError, unknown_name
from ..core.files import digest_of_value
from ..core.rng import Rng
from ..models.base import AnyModel
from .api import load_attack
from .ball import NORMS, Images, frames_of, images_of
from .base import VARIANTS, Attack, Learned
from .problem import Problem

_PLUS = "+"


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
        """See `Attack.made`."""
        given: str | Sequence[str] = options.pop("parts", "apgd+square")
        names = given.split(_PLUS) if isinstance(given, str) else list(given)
        if not names or not all(isinstance(name, str) for name in names):
            raise UsageError("attack worst_of: give its parts by their names, as in worst_of:apgd+square")
        known = [load_attack(name).known_options() for name in names]
        for option in options:
            if not any(option in each for each in known):
                raise unknown_name("option of the attacks in worst_of", option, sorted(set().union(*known)))
        parts = [
            load_attack(name, **{option: value for option, value in options.items() if option in each})
            for name, each in zip(names, known, strict=True)
        ]
        if any(isinstance(part, WorstOf) for part in parts):
            raise UsageError("attack worst_of cannot contain another worst_of; name all parts: worst_of:A+B+C")
        norms = {part.norm for part in parts}
        if len(norms) != 1:
            raise UsageError(
                f"attack worst_of: {', '.join(f'{part.name} has norm {part.norm}' for part in parts)}; "
                "all parts share a budget, so they must have the same norm"
            )
        every = {option: value for part in parts for option, value in part.options().items()}
        for part in parts:
            takes = part.known_options()
            same = load_attack(part.name, **{option: value for option, value in every.items() if option in takes})
            if same.label != part.label:
                raise UsageError(
                    f"attack worst_of: {part.label} would have to be {same.label}, because options apply to every part "
                    "that has them; list these attacks separately"
                )
        shared = {each.name for each in fields(Attack)} - {"norm"}
        chosen = {option: value for option, value in (options | every).items() if option in shared}
        return cls(parts=tuple(parts), norm=norms.pop(), **chosen)

    def with_variant(self, variant: str) -> Self:
        """See `Attack.with_variant`; applies to every part that supports the variant."""
        return replace(self, parts=tuple(part.with_variant(variant) for part in self.parts))

    def training(self, model: AnyModel) -> dict[str, tuple[Attack, AnyModel]]:
        """See `Attack.training`."""
        return {label: one for part in self.parts for label, one in part.training(model).items()}

    def with_learned(self, learned: Learned) -> Self:
        """See `Attack.with_learned`."""
        return replace(self, parts=tuple(part.with_learned(learned) for part in self.parts))

    @property
    def label(self) -> str:
        """See `Attack.label`."""
        own_fields = {each.name for each in fields(Attack)} - {"norm"}
        options = {name: value for name, value in self.options().items() if name in own_fields}
        options |= {name: value for part in self.parts for name, value in part.options().items()}
        names = _PLUS.join(part.name for part in self.parts)
        return ":".join([self.name, names, *(f"{name}={value}" for name, value in options.items())])

    @property
    def source(self) -> str:
        """A digest of the parts' sources."""
        sources = [part.source for part in self.parts]
        return digest_of_value(sources) if any(sources) else ""

    @property
    def needs(self) -> str:
        """See `Attack.needs`."""
        return "gradients" if any(part.needs == "gradients" for part in self.parts) else "any model"

    def check(self, model: AnyModel) -> None:
        """Check that every part works with the model."""
        for part in self.parts:
            part.check(model)

    def run(self, problem: Problem, rng: Rng) -> Images:
        """See `Attack.run`."""
        best, highest, pair, curves = problem.best, problem.best_score, problem.pair, problem.curves
        for part in self.parts:
            inner = part.begun(problem.model, pair, problem.clean_flow)
            frames = frames_of(inner.ball.to_8_bits(part.run(inner, pair.stream(part.name))))
            score = problem.score_of_frames(frames)
            problem.charge(inner)
            if score > highest:
                best, highest, problem.troubles = images_of(*frames), score, inner.troubles
                curves = inner.curves
        problem.curves = curves
        return best
