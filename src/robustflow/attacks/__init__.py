"""Adversarial attacks: small changes to the frames that make a model's flow as wrong as possible."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .api import attack, list_attacks, load_attack
    from .base import Attack
    from .result import Attacked

_HOMES = {"Attack": "base", "Attacked": "result", "attack": "api", "list_attacks": "api", "load_attack": "api"}

__all__ = ["Attack", "Attacked", "attack", "list_attacks", "load_attack"]


def __getattr__(name: str) -> Any:
    """Import a public name on first use, so that runs without attacks import only the names of attacks."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f".{_HOMES[name]}", __name__), name)
