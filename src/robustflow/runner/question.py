"""A question to a model: the frames of one cell."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from ..sample import Frame

if TYPE_CHECKING:  # a process that only predicts does not import what plans need
    from ..runs.plan import Cell


@dataclass(frozen=True)
class Question:
    """A request for the flow of one cell.

    Attributes:
        cell: (sample key, corruption, severity).
        frames: RGB uint8 (H, W, 3) each: the pair, or the clip in the order of time.
        index: of frame 1 in the clip; None for a model that is given pairs.
    """

    cell: Cell
    frames: tuple[Frame, ...]
    index: int | None = None
