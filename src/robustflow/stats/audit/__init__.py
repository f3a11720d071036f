"""Check published results, or your own, for consistency and list each inconsistency with both numbers."""

from __future__ import annotations

from collections.abc import Sequence

from ..model_result import ModelResult, printed_costs
from ..published.tables import published_results
from .checks import check_averages, check_bound, check_cre, check_crer, check_marks
from .costs import check_costs
from .findings import AUDIT_CHECKS, Audit, Finding
from .patterns import check_shifted, check_swapped

__all__ = ["AUDIT_CHECKS", "Audit", "Finding", "audit_published", "audit_results"]


def audit_published() -> Audit:
    """Audit the paper's tables."""
    return audit_results(published_results(), audited="the published tables")


def audit_results(results: Sequence[ModelResult], audited: str = "results") -> Audit:
    """Audit results from any source."""
    checks = (check_swapped, check_shifted, check_cre, check_averages, check_crer, check_bound, check_marks)
    parts = [check(results) for check in checks] + (check_costs(results) if printed_costs(results) else [])
    return Audit(
        audited=audited,
        checked={check: count for check, count, _ in parts if count},
        findings=[finding for _, _, findings in parts for finding in findings],
    )
