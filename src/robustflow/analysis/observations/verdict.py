"""Statements about results, with the supporting numbers and a verdict."""

from __future__ import annotations

from typing import Literal

from ...validated import FrozenFinite

Verdict = Literal["holds", "does not hold", "too little evidence", "cannot be computed"]
UNKNOWN: Verdict = "cannot be computed"
THIN: Verdict = "too little evidence"


class Statement(FrozenFinite):
    """One statement in an observation, checked by a computation.

    Attributes:
        claim: statement that is checked.
        verdict: whether the claim holds.
        message: description of the numbers.
        numbers: name -> number.
        main: whether the verdict on the observation depends on this statement.
    """

    claim: str
    verdict: Verdict
    message: str
    numbers: dict[str, float] = {}
    main: bool = False


class Observation(FrozenFinite):
    """An observation from the paper.

    Attributes:
        number: number of the observation, 1 to 10.
        title: the observation in the paper's words.
        parts: statements that make up the observation.
    """

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
