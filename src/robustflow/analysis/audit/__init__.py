"""Are published or own results consistent? Each inconsistency is listed with both numbers."""

from __future__ import annotations

from collections.abc import Mapping

import polars as pl

from ..published.tables import Cost, published_costs, published_results
from .checks import Book, check_averages, check_bound, check_cre, check_crer, check_marks
from .costs import check_costs
from .findings import AUDIT_CHECKS, Audit, Finding, merged_audit
from .patterns import check_shifted, check_swapped
from .run_folder import audit_run

__all__ = ["AUDIT_CHECKS", "Audit", "Finding", "audit_published", "audit_results", "audit_run"]


def audit_published() -> Audit:
    """The paper's tables.

    >>> audit_published().counts()["swapped"]
    2
    """
    return audit_results(published_results(), published_costs(), audited="the published tables")


def audit_results(results: pl.DataFrame, costs: Mapping[str, Cost] | None = None, audited: str = "results") -> Audit:
    """Results in the tidy shape (`robustflow.analysis.results.RESULT_SCHEMA`), and a cost table if there is one."""
    book = Book(results)
    checks = (check_swapped, check_shifted, check_cre, check_averages, check_crer, check_bound, check_marks)
    parts = [check(book) for check in checks]
    return merged_audit(audited, parts + (check_costs(book, costs) if costs else []))
