"""Findings of the audit of the tables."""

from __future__ import annotations

from ...analysis.audit import AUDIT_CHECKS, Audit, Finding, audit_results
from ...analysis.model_result import by_frames
from ...analysis.published.tables import PAPER
from ...text import plain
from .content import Content


def audits(content: Content, benchmark: str) -> list[Audit]:
    """Audit the values of a benchmark in the paper's tables and in results files."""
    results = [line for line in content.lines if line.benchmark == benchmark and line.run is None]
    sections = []
    for frames, lines in by_frames(results).items():
        if frames == PAPER and content.alone:
            continue
        audited = "the published tables" if frames == PAPER else content.group_titles.get(frames, plain(frames))
        sections.append(audit_results(lines, audited))
    return sections


def by_check(audit: Audit) -> list[tuple[str, int, list[Finding]]]:
    """The results as (check, number of values, findings), in the order of the checks."""
    return [
        (AUDIT_CHECKS[check], count, [finding for finding in audit.findings if finding.check == check])
        for check, count in audit.checked.items()
    ]
