"""The registry of attacks by name; attacks are imported only when they are built."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from ..core.errors import UsageError
from ..core.plugins import Registry

ATTACKS: Registry[Any] = Registry("attack", entry_point_group="robustflow.attacks")

ATTACK_VERSION = 7
"""Part of every run's identity; incremented whenever the frames of an attack change."""

CONTROLS = ("random_sign", "random_gauss")
"""The random-noise controls, which an attack should outperform."""
PATCH_CONTROL = "random_patch"
"""The control for patches."""

_CLASSES = {
    "random_sign": "controls:RandomSign",
    "random_gauss": "controls:RandomGauss",
    "random_patch": "controls:RandomPatch",
    "fgsm": "pgd:Fgsm",
    "bim": "pgd:Bim",
    "pgd": "pgd:Pgd",
    "cospgd": "pgd:CosPgd",
    "apgd": "pgd:Apgd",
    "pcfa": "pcfa:Pcfa",
    "square": "square:Square",
    "transfer": "composed:Transfer",
    "worst_of": "composed:WorstOf",
    "universal": "trained:Universal",
    "patch": "patch:Patch",
}
SHIPPED: tuple[str, ...] = tuple(_CLASSES)
"""The attacks of this package; installed packages can add more."""

NORMS: dict[str, str] = {"random_gauss": "rms", "pcfa": "rms", "random_patch": "area", "patch": "area"}
"""The norm of each attack's budget in a run, if it is not "linf"."""


@dataclass(frozen=True)
class AttackSpec:
    """An attack, as its label describes it; it may be unknown, e.g. a user's attack on another machine.

    Attributes:
        name: the registered name.
        argument: the text after the name that is no option.
        options: the options as text, by name.
    """

    name: str
    argument: str
    options: Mapping[str, str]

    @property
    def norm(self) -> str:
        """The norm of the attack's budget."""
        if "norm" in self.options:
            return self.options["norm"]
        if self.name == "transfer" and "attack" in self.options:
            return attack_spec(self.options["attack"]).norm
        if self.name == "worst_of" and self.argument:
            return attack_spec(self.argument.partition("+")[0]).norm
        return NORMS.get(self.name, "linf")

    @property
    def control(self) -> str:
        """The control with the same norm in the same frames.

        >>> attack_spec("pgd").control, attack_spec("pcfa:moved=first").control
        ('random_sign', 'random_gauss:moved=first')
        """
        control = next(name for name in (*CONTROLS, PATCH_CONTROL) if NORMS.get(name, "linf") == self.norm)
        moved = self.options.get("moved")
        return f"{control}:moved={moved}" if moved in ("first", "second") else control

    @property
    def kind(self) -> Any:
        """The class of the attack (`base.Attack`), imported on first use; None if no package provides it."""
        return ATTACKS.get(self.name) if self.name in ATTACKS else None


@lru_cache(maxsize=4096)
def attack_spec(label: str) -> AttackSpec:
    """Parse the label of an attack, the only place that does; imports nothing.

    >>> attack_spec("pgd:steps=40:loss=cosine")
    AttackSpec(name='pgd', argument='', options={'steps': '40', 'loss': 'cosine'})
    >>> attack_spec("transfer:ptlflow:raft:checkpoint=things").argument
    'ptlflow:raft'
    """
    head, *parts = label.split(":")
    argument: list[str] = []
    options: dict[str, str] = {}
    for part in parts:
        option, is_option, value = part.partition("=")
        if is_option and option.strip() in options:
            raise UsageError(option.strip(), f"'{label}' sets this option twice")
        if is_option:
            options[option.strip()] = value.strip()
        elif options:
            options[next(reversed(options))] += f":{part}"  # the value contains a colon
        else:
            argument.append(part.strip())
    return AttackSpec(head.strip(), ":".join(argument), options)


for _name, _target in _CLASSES.items():
    ATTACKS.add(_name, f"robustflow.attacks.{_target}")
