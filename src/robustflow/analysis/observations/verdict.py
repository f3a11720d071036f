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
        if THIN in verdicts:
            return THIN
        return UNKNOWN if UNKNOWN in verdicts else "holds"


def without_verdict(observation: Observation, reason: str) -> Observation:
    """Remove the verdict from an observation whose numbers come from too few models or image pairs."""
    parts = [
        one
        if one.verdict == UNKNOWN
        else one.model_copy(update={"verdict": THIN, "message": f"{one.message} ({reason})"})
        for one in observation.parts
    ]
    return observation.model_copy(update={"parts": parts})


def unknown(number: int, title: str, claim: str, reason: str) -> Observation:
    """Create an observation that these results cannot test."""
    return Observation(number=number, title=title, parts=[part(claim, UNKNOWN, reason, main=True)])


def part(
    claim: str, verdict: Verdict, message: str, main: bool = False, numbers: dict[str, float] | None = None
) -> Statement:
    """Create a statement."""
    return Statement(claim=claim, verdict=verdict, message=message, numbers=numbers or {}, main=main)
