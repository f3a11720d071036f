"""The registry of attacks by name; attacks are imported only when they are built."""

from __future__ import annotations

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


def split_name(name: str) -> tuple[str, str, dict[str, str]]:
    """Split an attack's label into its registered name, the positional part (without "="), and its options.

    >>> split_name("pgd:steps=40:loss=cosine")
    ('pgd', '', {'steps': '40', 'loss': 'cosine'})
    >>> split_name("transfer:ptlflow:raft:checkpoint=things")
    ('transfer', 'ptlflow:raft', {'checkpoint': 'things'})
    """
    head, *parts = name.split(":")
    argument: list[str] = []
    options: dict[str, str] = {}
    for part in parts:
        option, is_option, value = part.partition("=")
        if is_option and option.strip() in options:
            raise UsageError(option.strip(), f"'{name}' sets this option twice")
        if is_option:
            options[option.strip()] = value.strip()
        elif options:
            options[next(reversed(options))] += f":{part}"  # the value contains a colon
        else:
            argument.append(part.strip())
    return head.strip(), ":".join(argument), options


def norm_of(name: str) -> str:
    """Return the norm of an attack's budget from its label, without importing the attack."""
    head, argument, options = split_name(name)
    if "norm" in options:
        return options["norm"]
    if head == "transfer" and "attack" in options:
        return norm_of(options["attack"])
    if head == "worst_of" and argument:
        return norm_of(argument.partition("+")[0])
    return NORMS.get(head, "linf")


def control_of(name: str) -> str:
    """Return the control with the same norm in the same frames as an attack.

    >>> control_of("pgd"), control_of("pcfa:moved=first")
    ('random_sign', 'random_gauss:moved=first')
    """
    control = next(control for control in (*CONTROLS, PATCH_CONTROL) if norm_of(control) == norm_of(name))
    moved = split_name(name)[2].get("moved")
    return f"{control}:moved={moved}" if moved in ("first", "second") else control


for _name, _target in _CLASSES.items():
    ATTACKS.add(_name, f"robustflow.attacks.{_target}")
