"""Transfer: frames that were attacked on a different model."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any, ClassVar, Self

from ..core.errors import ModelError, UsageError
from ..core.files import digest_of_value
from ..core.rng import Rng
from ..models.base import AnyModel, FlowModel, predict_checked
from ..models.loading import ModelSpec, as_model
from .api import load_attack
from .ball import NORMS, Images
from .base import VARIANTS, Attack, Learned
from .problem import Problem
from .trained import Trained


@dataclass(frozen=True, kw_only=True)
class Transfer(Attack):
    """Attack the same pair on a different model (the surrogate), and evaluate the result on the model under test."""

    name: ClassVar[str] = "transfer"
    needs_gradients: ClassVar[bool] = False
    argument: ClassVar[str] = "on"
    norms: ClassVar[tuple[str, ...]] = NORMS
    variants: ClassVar[tuple[str, ...]] = VARIANTS

    on: Any = "tiny"
    attack: Attack
    model_options: tuple[tuple[str, Any], ...] = ()

    @classmethod
    def made(cls, **options: Any) -> Self:
        """See `Attack.made`."""
        on, name = options.pop("on", "tiny"), options.pop("attack", "apgd")
        known = load_attack(name).known_options()
        inner = load_attack(name, **{option: value for option, value in options.items() if option in known})
        if isinstance(inner, Transfer):
            raise UsageError("attack transfer cannot contain another transfer; name only the inner model")
        if inner.name == "worst_of":
            raise UsageError("attack transfer cannot contain worst_of; combine them as worst_of:transfer+...")
        rest = tuple((option, value) for option, value in options.items() if option not in known)
        if rest and not isinstance(on, str):
            raise UsageError(
                f"attack transfer: '{rest[0][0]}' is not an option of {inner.name}, and the model is already built"
            )
        return cls(on=on, attack=inner, model_options=rest, **_options_of_attack(inner))

    def with_variant(self, variant: str) -> Self:
        """See `Attack.with_variant`; the variant is that of the inner attack."""
        inner = self.attack.with_variant(variant)
        return replace(self, attack=inner, **_options_of_attack(inner))

    def training(self, model: AnyModel) -> dict[str, tuple[Attack, AnyModel]]:
        """See `Attack.training`; the inner attack is trained on the surrogate."""
        inner = self.attack
        return {self.label: (inner, self._surrogate)} if isinstance(inner, Trained) and inner.train else {}

    def with_learned(self, learned: Learned) -> Self:
        """See `Attack.with_learned`."""
        inner = self.attack
        if not (isinstance(inner, Trained) and inner.train):
            return self
        return replace(self, attack=replace(inner, learned=learned.get(self.label, {})))

    def known_options(self) -> set[str]:
        """See `Attack.known_options`; the options of the surrogate are checked when it is loaded."""
        return {"on", "attack", *self.attack.known_options()}

    def options(self) -> dict[str, Any]:
        """See `Attack.options`; includes the options of the inner attack and of the surrogate."""
        if not isinstance(self.on, str):
            raise UsageError("in a run, the attack transfer needs the name of its model: transfer:MODEL")
        options = {"on": self.on, "attack": self.attack.name}
        chosen = {option: value for option, value in options.items() if value not in ("tiny", "apgd")}
        return {**chosen, **self.attack.options(), **dict(self.model_options)}

    @property
    def label(self) -> str:
        """See `Attack.label`; the surrogate follows the name."""
        options = self.options()
        on = options.pop("on", "tiny")
        return ":".join([self.name, on, *(f"{name}={value}" for name, value in options.items())])

    @property
    def source(self) -> str:
        """A digest of the surrogate's identity."""
        assert self._spec is not None
        return digest_of_value([self._spec.identity(self._surrogate), self.attack.source])

    @property
    def _spec(self) -> ModelSpec | None:
        return ModelSpec(self.on, self.model_options) if isinstance(self.on, str) else None

    @cached_property
    def _surrogate(self) -> AnyModel:
        return self._spec.load() if self._spec else as_model(self.on, "the model of the attack transfer")

    def check(self, model: AnyModel) -> None:
        """Check that the surrogate can be attacked."""
        if not isinstance(self._surrogate, FlowModel):
            raise ModelError("the attack transfer needs a two-frame model as its surrogate")
        self.attack.check(self._surrogate)

    def run(self, problem: Problem, rng: Rng) -> Images:
        """See `Attack.run`; counts the evaluations of the surrogate."""
        pair = problem.pair
        clean_flow = predict_checked(self._surrogate, pair.frames, pair.key, "clean", 0)  # type: ignore[arg-type]
        inner = self.attack.begun(self._surrogate, pair, clean_flow)
        images = self.attack.run(inner, pair.stream(self.attack.name))
        problem.charge(inner)
        problem.troubles |= inner.troubles
        problem.trace += inner.trace
        return images


def _options_of_attack(inner: Attack) -> dict[str, Any]:
    """Return the options that every attack has; a transfer has the values of its inner attack."""
    return {each.name: getattr(inner, each.name) for each in fields(Attack)}
