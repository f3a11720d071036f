"""Adversarial attacks: the worst that a small change of the frames does to a model's flow."""

from __future__ import annotations

from .api import attack, list_attacks, load_attack
from .base import Attack
from .result import Attacked

__all__ = ["Attack", "Attacked", "attack", "list_attacks", "load_attack"]
