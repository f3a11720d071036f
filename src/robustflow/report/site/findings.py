"""The paper's observations checked on each set of comparable results, and what the audit of the tables found."""

from __future__ import annotations

from dataclasses import dataclass

import polars as pl

from ...analysis.audit import AUDIT_CHECKS, Audit, Finding, audit_published, audit_results
from ...analysis.doubts import sound_results
from ...analysis.observations import Observation, observations
from ...analysis.observations.verdict import THIN, UNKNOWN
from ...analysis.published.tables import PAPER
from ...text import plain
from .content import Content

VERDICT_CLASSES = {"holds": "yes", "does not hold": "no", THIN: "open", UNKNOWN: "open"}


@dataclass(frozen=True)
class Checked:
    """The ten observations on one set of results."""

    title: str
    observations: tuple[Observation, ...]


def checked_observations(content: Content) -> list[Checked]:
    """The observations on each sample set that the page is about, if at least one can be computed."""
    checked = []
    sound = sound_results(content.focus, content.doubted)
    for frames in dict.fromkeys(sound["sample_set"]):
        part = sound.filter(pl.col("sample_set") == frames)
        pairs = next((run.summary.samples for (of, _), run in content.runs.items() if of == frames), None)
        made = observations(part, content.costs if frames == PAPER else {}, pairs=pairs)
        if any(one.verdict != UNKNOWN for one in made):
            checked.append(Checked(content.group_titles.get(frames, plain(frames)), tuple(made)))
    return checked


def audits(content: Content) -> list[Audit]:
    """The audit of the paper's tables, and of results from files; runs are audited by `robustflow audit RUN`."""
    frames = set(content.results["sample_set"])
    audits = [audit_published()] if content.costs and not content.alone else []
    from_runs = {of for of, _ in content.runs}
    for name in sorted(frames - from_runs - {PAPER}):
        audited = content.group_titles.get(name, plain(name))
        audits.append(audit_results(content.results.filter(sample_set=name), audited=audited))
    return audits


def by_check(audit: Audit) -> list[tuple[str, int, list[Finding]]]:
    """(what is checked, how many numbers, what does not fit) in the order of the checks."""
    return [
        (AUDIT_CHECKS[check], count, [finding for finding in audit.findings if finding.check == check])
        for check, count in audit.checked.items()
    ]
