"""The paper's observations checked on each set of comparable results, and what the audit of the tables found."""

from __future__ import annotations

from dataclasses import dataclass

from ...analysis.audit import AUDIT_CHECKS, Audit, Finding, audit_results
from ...analysis.model_result import by_frames, ranked
from ...analysis.observations import Observation, observations
from ...analysis.observations.verdict import THIN, UNKNOWN
from ...analysis.published.tables import PAPER
from ...benchmarks import benchmark_facts
from ...text import plain
from .content import Content

VERDICT_CLASSES = {"holds": "yes", "does not hold": "no", THIN: "open", UNKNOWN: "open"}


@dataclass(frozen=True)
class Checked:
    """The ten observations on one set of results."""

    title: str
    observations: tuple[Observation, ...]

    @property
    def computed(self) -> list[Observation]:
        """The observations with a verdict."""
        return [one for one in self.observations if one.verdict != UNKNOWN]

    @property
    def unknown(self) -> list[Observation]:
        """The observations on which these results have no bearing."""
        return [one for one in self.observations if one.verdict == UNKNOWN]


def checked_observations(content: Content, benchmark: str) -> list[Checked]:
    """The observations on each sample set of a benchmark that the page is about, if at least one can be computed."""
    checked = []
    for frames, part in by_frames(ranked(line for line in content.focus if line.benchmark == benchmark)).items():
        made = observations(part, content.costs if frames == PAPER else {})
        if any(one.verdict != UNKNOWN for one in made):
            checked.append(Checked(content.group_titles.get(frames, plain(frames)), tuple(made)))
    return checked


def audits(content: Content, benchmark: str) -> list[Audit]:
    """The audit of what the paper's tables and results files have of a benchmark; runs are audited by `robustflow audit
    RUN`."""
    results = [line for line in content.lines if line.benchmark == benchmark and line.run is None]
    made = []
    for frames, lines in by_frames(results).items():
        if frames == PAPER and content.alone:
            continue
        costs = content.costs if frames == PAPER and benchmark_facts(benchmark).has_flow else {}
        audited = "the published tables" if frames == PAPER else content.group_titles.get(frames, plain(frames))
        made.append(audit_results(lines, costs, audited))
    return made


def by_check(audit: Audit) -> list[tuple[str, int, list[Finding]]]:
    """(check, number of values, findings) in the order of the checks."""
    return [
        (AUDIT_CHECKS[check], count, [finding for finding in audit.findings if finding.check == check])
        for check, count in audit.checked.items()
    ]
