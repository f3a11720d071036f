"""Every attack by name, without importing any of them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..registry import Registry

if TYPE_CHECKING:
    from .base import Attack

ATTACKS: Registry[type[Attack]] = Registry("attack", entry_point_group="robustflow.attacks")

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

for _name, _target in _CLASSES.items():
    ATTACKS.add(_name, f"robustflow.attacks.{_target}")
