"""A statement about results, the numbers for it, and the verdict."""

from __future__ import annotations

from typing import Literal

from ...validated import FrozenFinite

Verdict = Literal["holds", "does not hold", "too little evidence", "cannot be computed"]
UNKNOWN: Verdict = "cannot be computed"
THIN: Verdict = "too little evidence"


class Statement(FrozenFinite):
    """One statement of an observation as a computation.

    Attributes:
        claim: describes what is computed.
        verdict: whether it holds.
        message: describes the numbers.
        numbers: the same by name.
        main: whether the observation depends on it; the others are further sentences below its heading.
    """

    claim: str
    verdict: Verdict
    message: str
    numbers: dict[str, float] = {}
    main: bool = False


class Observation(FrozenFinite):
    """An observation of the paper.

    Attributes:
        number: 1 to 10.
        title: in the paper's words.
        parts: its computations.
    """

    number: int
    title: str
    parts: list[Statement]

    @property
    def verdict(self) -> Verdict:
        """The verdict on its main parts together."""
        verdicts = [part.verdict for part in self.parts if part.main]
        if "does not hold" in verdicts:
            return "does not hold"
        if THIN in verdicts:
            return THIN
        return UNKNOWN if UNKNOWN in verdicts else "holds"


def without_verdict(observation: Observation, reason: str) -> Observation:
    """The numbers of an observation without a verdict, because they come from too few models or image pairs."""
    parts = [
        one
        if one.verdict == UNKNOWN
        else one.model_copy(update={"verdict": THIN, "message": f"{one.message} ({reason})"})
        for one in observation.parts
    ]
    return observation.model_copy(update={"parts": parts})


def part(
    claim: str, verdict: Verdict, message: str, main: bool = False, numbers: dict[str, float] | None = None
) -> Statement:
    """Make a statement."""
    return Statement(claim=claim, verdict=verdict, message=message, numbers=numbers or {}, main=main)
