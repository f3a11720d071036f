"""The user's own attacks: objects, classes or `module:Attribute`, checked and registered by name.

`robustflow.testing.check_attack` runs further checks (budget, determinism, the best pair).
"""

from __future__ import annotations

import inspect
from dataclasses import dataclass, fields
from typing import Any

from ..core.errors import UsageError, unknown_name
from ..core.plugins import called, checked_name, described, import_target, is_target, own_name
from ..core.rng import Rng
from ..core.source_digest import source_digest
from .ball import Images
from .base import Attack
from .problem import Problem
from .registry import ATTACKS, attack_spec

Made = Any
"""The user's attack, as a class or object."""

_own: dict[str, Made] = {}


@dataclass(frozen=True, kw_only=True)
class OwnAttack(Attack):
    """Wrap a user's attack: its inputs are read-only, and its exceptions become one-line errors."""

    made_by_user: Any
    given: tuple[tuple[str, Any], ...] = ()

    @classmethod
    def of(cls, registered: str, **options: Any) -> Attack:
        """Build a registered attack with options of the user's class and of `Attack`."""
        attack = _own[registered]
        if inspect.isclass(attack) and issubclass(attack, Attack):
            return attack.made(**options)
        common = {option.name: options.pop(option.name) for option in fields(Attack) if option.name in options}
        takes = _parameters(attack)
        for option, value in options.items():
            if option not in takes:
                raise unknown_name(f"option of attack {registered}", option, [*takes, *_COMMON])
            if isinstance(takes[option], int) and isinstance(value, str) and value.isdecimal():
                options[option] = int(value)
        common.setdefault("norm", str(getattr(attack, "norm", "linf")))
        made = attack
        if inspect.isclass(attack):
            advice = "give every argument a default value, or pass an object"
            made = called(registered, "its constructor", lambda: attack(**options), advice)
        return cls(made_by_user=made, given=tuple(options.items()), **common)

    @property
    def name(self) -> str:  # type: ignore[override]
        """The attack's name."""
        return own_name(self.made_by_user)

    @property
    def needs_gradients(self) -> bool:  # type: ignore[override]
        """Whether the attack needs gradients: True unless its attribute `needs_gradients` is False."""
        return bool(getattr(self.made_by_user, "needs_gradients", True))

    def known_options(self) -> set[str]:
        return {*_parameters(type(self.made_by_user)), *_COMMON}

    def options(self) -> dict[str, Any]:
        options = super().options()
        return {name: options[name] for name in _COMMON if name in options} | dict(self.given)

    @property
    def source(self) -> str:
        """A digest of the source files and of the attributes that affect the result."""
        return source_digest(self.made_by_user)

    def __reduce__(self) -> tuple[Any, ...]:
        return _restored, (_own[self.name], self.options())  # an object of a class may not be picklable

    def run(self, problem: Problem, rng: Rng) -> Images:
        run = self.made_by_user.run
        images: Images = called(self.name, "run", lambda: run(problem, rng), read_only="the pair")
        return images


_COMMON = tuple(option.name for option in fields(Attack))


def register_attack(made: Made) -> str:
    """Register a class or an object under its name, which replaces an earlier one of that name; return the name."""
    if not callable(getattr(made, "run", None)):
        raise UsageError(described(made), "an attack needs a method run; see the guide 'add your attack'")
    name = checked_name(made, "attack", ATTACKS.__contains__)
    _own[name] = made
    return name


def _restored(made: Made, options: dict[str, Any]) -> Attack:
    """Register an attack in a worker process, and return it."""
    return OwnAttack.of(register_attack(made), **options)


def with_target_registered(name: str) -> str:
    """Import an attack given as `module.path:Attribute` and return its name; only for names that a user entered.

    >>> with_target_registered("pgd:steps=3")
    'pgd:steps=3'
    """
    spec = attack_spec(name)
    target = f"{spec.name}:{spec.argument}"
    if spec.name in ATTACKS or spec.name in _own or not is_target(target):
        return name
    registered = register_attack(import_target(target, "attack"))
    return ":".join([registered, *(f"{option}={value}" for option, value in spec.options.items())])


def registered_attack(name: str) -> Made | None:
    """Return what the user has registered under a name."""
    return _own.get(name)


def _parameters(made: Made) -> dict[str, Any]:
    """Return the options of a class with their defaults; an object has no options."""
    if not inspect.isclass(made):
        return {}
    return {name: parameter.default for name, parameter in inspect.signature(made).parameters.items()}
