"""A page in sections: everything that it shows of one benchmark, one of which is shown at a time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ...analysis.audit import Audit
from .board import Board
from .content import Content
from .figures import FigureGroup
from .findings import Checked, audits, checked_observations
from .headline import headline


@dataclass(frozen=True)
class BenchmarkSection:
    """What a page shows of one benchmark.

    Attributes:
        board: its part of the leaderboard.
        headline: the first sentences.
        figures: by the frames they are of.
        observations, audits: what was checked of its results.
    """

    board: Board
    headline: Sequence[str]
    figures: Sequence[FigureGroup]
    observations: Sequence[Checked]
    audits: Sequence[Audit]


def sections_of(content: Content, boards: Sequence[Board], figures: Sequence[FigureGroup]) -> list[BenchmarkSection]:
    """A section for each board."""
    return [
        BenchmarkSection(
            board=board,
            headline=headline(content, board.benchmark),
            figures=[group for group in figures if group.benchmark == board.benchmark],
            observations=checked_observations(content, board.benchmark),
            audits=audits(content, board.benchmark),
        )
        for board in boards
    ]
