"""Statements about results, with the supporting numbers and a verdict."""

from __future__ import annotations

from typing import Literal

from ...validated import FrozenFinite

Verdict = Literal["holds", "does not hold", "too little evidence", "cannot be computed"]
UNKNOWN: Verdict = "cannot be computed"
THIN: Verdict = "too little evidence"


class Statement(FrozenFinite):
    """One statement in an observation, checked by a computation."""

    claim: str
    verdict: Verdict
    message: str
    numbers: dict[str, float] = {}
    main: bool = False


class Observation(FrozenFinite):
    """An observation from the paper."""

    number: int
    title: str
    parts: list[Statement]

    @property
    def verdict(self) -> Verdict:
        """The joint verdict on the main parts."""
        verdicts = [part.verdict for part in self.parts if part.main]
        if "does not hold" in verdicts:
            return "does not hold"
        return THIN if THIN in verdicts else "holds"


def part(
    claim: str, verdict: Verdict, message: str, main: bool = False, numbers: dict[str, float] | None = None
) -> Statement:
    """Create a statement."""
    return Statement(claim=claim, verdict=verdict, message=message, numbers=numbers or {}, main=main)
