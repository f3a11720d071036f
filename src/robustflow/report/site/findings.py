"""Checks of the paper's observations on each set of comparable results, and findings of the audit of the tables."""

from __future__ import annotations

from dataclasses import dataclass

from ...analysis.audit import AUDIT_CHECKS, Audit, Finding, audit_results
from ...analysis.model_result import by_frames, ranked
from ...analysis.observations import Observation, observations
from ...analysis.observations.verdict import THIN, UNKNOWN
from ...analysis.published.tables import PAPER
from ...text import plain
from .content import Content

VERDICT_CLASSES = {"holds": "yes", "does not hold": "no", THIN: "open", UNKNOWN: "open"}


@dataclass(frozen=True)
class Checked:
    """The verdicts on the ten observations for one set of results."""

    title: str
    observations: tuple[Observation, ...]

    @property
    def computed(self) -> list[Observation]:
        """Observations with a verdict."""
        return [one for one in self.observations if one.verdict != UNKNOWN]

    @property
    def unknown(self) -> list[Observation]:
        """Observations that these results cannot test."""
        return [one for one in self.observations if one.verdict == UNKNOWN]


def checked_observations(content: Content, benchmark: str) -> list[Checked]:
    """Check the observations on each sample set of a benchmark that the page is about, if at least one can be
    computed."""
    checked = []
    for frames, part in by_frames(ranked(line for line in content.focus if line.benchmark == benchmark)).items():
        verdicts = observations(part)
        if any(one.verdict != UNKNOWN for one in verdicts):
            checked.append(Checked(content.group_titles.get(frames, plain(frames)), tuple(verdicts)))
    return checked


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
