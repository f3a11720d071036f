"""Every attack by name, without importing any of them."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from ..registry import Registry

if TYPE_CHECKING:
    from .base import Attack

ATTACKS: Registry[type[Attack]] = Registry("attack", entry_point_group="robustflow.attacks")

ATTACK_VERSION = 1
"""Part of every run's identity: raised when any attack's frames change, so that results never mix."""

CONTROLS = ("random_sign", "random_gauss")
"""Random noise of the attacks' norms, which an attack has to beat."""

_CLASSES = {
    "random_sign": "random_sign:RandomSign",
    "random_gauss": "random_gauss:RandomGauss",
    "fgsm": "fgsm:Fgsm",
    "bim": "bim:Bim",
    "pgd": "pgd:Pgd",
    "cospgd": "cospgd:CosPgd",
    "apgd": "apgd:Apgd",
    "pcfa": "pcfa:Pcfa",
    "square": "square:Square",
}
SHIPPED: tuple[str, ...] = tuple(_CLASSES)
"""The attacks of this package; installed packages add others."""

NORMS: dict[str, str] = {"random_gauss": "rms", "pcfa": "rms"}
"""The norm of an attack's budget in a run, where it is not "linf"."""


def norm_of(name: str) -> str:
    """The norm in which the budget of an attack holds by default; it is not imported to find out.

    >>> norm_of("pgd"), norm_of("pcfa")
    ('linf', 'rms')
    """
    return NORMS.get(name, "linf")


def control_of(name: str) -> str:
    """The random noise of an attack's norm.

    >>> control_of("pgd")
    'random_sign'
    """
    return next(control for control in CONTROLS if norm_of(control) == norm_of(name))


def with_controls(names: Iterable[str]) -> tuple[str, ...]:
    """Attacks, each once, after the random noise of their norms.

    Raises:
        UsageError: an unknown attack.

    >>> with_controls(["pgd", "square"]), with_controls([])
    (('random_sign', 'pgd', 'square'), ())
    """
    asked = list(dict.fromkeys(names))
    for name in asked:
        ATTACKS.get(name)
    controls = [control for control in CONTROLS if control in map(control_of, asked)]
    return tuple(dict.fromkeys((*controls, *asked)))


for _name, _target in _CLASSES.items():
    ATTACKS.add(_name, f"robustflow.attacks.{_target}")
