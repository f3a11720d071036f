"""What an audit found: one record per number that does not fit, with both numbers."""

from __future__ import annotations

from collections import Counter

from ...validated import Frozen, FrozenFinite

AUDIT_CHECKS = {
    "cre": "CRE is the corrupted minus the clean EPE",
    "crer": "CREr is CRE / clean EPE, from the EPE",
    "crer_from_cre": "CREr is CRE / clean EPE, from the CRE",
    "average": "the average is the mean over corruptions",
    "bound": "RCRE is at least |EPE - clean EPE|",
    "best": "the best of each column is marked",
    "rank": "ranks follow from the printed values",
    "rank_from_epe": "ranks follow from CREr computed from the EPE",
    "swapped": "each row belongs to its model",
    "shifted": "each value is in its column",
    "summary": "the summary follows from the rows",
    "rows": "the rows are possible measurements",
    "budget": "attacked frames are within the stated budget",
}
"""Each check and what it asserts."""


class Finding(FrozenFinite):
    """A number that does not follow from the others within rounding.

    Attributes:
        check: one of `AUDIT_CHECKS`.
        source: the table or file it is in.
        setting, model, metric, corruption: where in it; "" if not applicable.
        given: the number as printed.
        recomputed: what follows from the other numbers.
        tolerance: how far apart rounding alone could put the two.
        message: describes the finding.
    """

    check: str
    source: str
    setting: str = ""
    model: str = ""
    metric: str = ""
    corruption: str = ""
    given: float | None = None
    recomputed: float | None = None
    tolerance: float | None = None
    message: str


class Audit(Frozen):
    """All findings, and how many numbers each check examined.

    Attributes:
        audited: what was examined.
        checked: numbers compared, by check.
        findings: in the order of the checks.
    """

    audited: str
    checked: dict[str, int]
    findings: list[Finding]

    @property
    def fits(self) -> bool:
        """Whether everything follows within rounding."""
        return not self.findings

    def counts(self) -> dict[str, int]:
        """Findings by check."""
        return dict(Counter(finding.check for finding in self.findings))


def merged_audit(audited: str, parts: list[tuple[str, int, list[Finding]]]) -> Audit:
    """One audit from (check, numbers compared, findings) of several checks."""
    return Audit(
        audited=audited,
        checked={check: count for check, count, _ in parts if count},
        findings=[finding for _, _, findings in parts for finding in findings],
    )
