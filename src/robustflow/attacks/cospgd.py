"""CosPGD: PGD in which pixels are weighted by their agreement with the reference (Agnihotri et al. 2024)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from .pgd import Pgd


@dataclass(frozen=True, kw_only=True)
class CosPgd(Pgd):
    """PGD whose gradient is that of each pixel's loss times the cosine between softmax(u, v) and that of the reference.

    The weight depends only on u - v, and is near 0 or 1 once that is a few pixels; docs/attacks.md says what follows.
    """

    name: ClassVar[str] = "cospgd"
    agreeing: ClassVar[bool] = True
