"""Adversarial attacks: small changes to the frames that make a model's flow as wrong as possible."""

from __future__ import annotations

from .api import attack, list_attacks, load_attack
from .base import Attack
from .result import Attacked

__all__ = ["Attack", "Attacked", "attack", "list_attacks", "load_attack"]
