"""CosPGD: PGD in which pixels are weighted by their agreement with the reference (Agnihotri et al. 2024)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from .pgd import Pgd


@dataclass(frozen=True, kw_only=True)
class CosPgd(Pgd):
    """PGD in which the loss of each pixel is weighted by the cosine between softmax(u, v) of the flow and of the
    reference.
    """

    name: ClassVar[str] = "cospgd"
    agreeing: ClassVar[bool] = True
