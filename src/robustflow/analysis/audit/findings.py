"""The findings of an audit: one record per inconsistent number, with the given and the recomputed value."""

from __future__ import annotations

from collections import Counter

from ...validated import Frozen, FrozenFinite

AUDIT_CHECKS = {
    "cre": "CRE is the corrupted minus the clean EPE",
    "crer": "CREr is CRE / clean EPE, with the CRE computed from the EPE",
    "crer_from_cre": "CREr is CRE / clean EPE, with the printed CRE",
    "average": "the average is the mean over corruptions",
    "bound": "RCRE is at least |EPE - clean EPE|",
    "best": "the best value in each column is marked",
    "rank": "ranks follow from the printed values",
    "rank_from_epe": "ranks follow from CREr computed from the EPE",
    "swapped": "each row belongs to its model",
    "shifted": "each value is in the right column",
}
"""Statement verified by each check."""


class Finding(FrozenFinite):
    """A number that differs from the value computed from other numbers by more than rounding can explain."""

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
    """All findings, and the number of values that each check compared."""

    audited: str
    checked: dict[str, int]
    findings: list[Finding]

    @property
    def fits(self) -> bool:
        """Whether all numbers are consistent within rounding."""
        return not self.findings

    def counts(self) -> dict[str, int]:
        """Return the number of findings per check."""
        return dict(Counter(finding.check for finding in self.findings))


def merged_audit(audited: str, parts: list[tuple[str, int, list[Finding]]]) -> Audit:
    """Merge the (check, number of values compared, findings) of several checks into one audit."""
    return Audit(
        audited=audited,
        checked={check: count for check, count, _ in parts if count},
        findings=[finding for _, _, findings in parts for finding in findings],
    )
