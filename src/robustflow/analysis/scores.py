"""Runs as results: the means of run folders in the tidy shape, with what a reader must know before comparing them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import polars as pl

from ..benchmarks import benchmark_facts
from ..benchmarks.facts import truth_remark
from ..metrics.summary import Scores, has_gaps
from ..runs.comparable import conditions_of, sample_set
from ..text import counted, joined
from .labels import benchmark_words, inside, long_label
from .results import AVERAGE, CLEAN, RESULT_METRICS, RESULT_SCHEMA
from .run_names import run_names

if TYPE_CHECKING:
    from ..runs.run import Run

OWN_SETTING = "own"
"""The setting of a run whose model does not declare what it was trained on."""

_MOST_NAMED = 3


def run_results(
    runs: Sequence[Run], beside_published: bool = False, notes: Sequence[str] | None = None
) -> pl.DataFrame:
    """EPE, CRE, CREr and RCRE of runs, per corruption, clean and average: columns of `results.RESULT_SCHEMA`.

    Next to published results (`beside_published`), the averages of a run with all of the paper's corruptions and others
    are the paper's mean, `Summary.paper`.

    Runs of one `sample_set` may be compared; `note` says what was measured: one of `notes`, by default `notes_of` the
    runs. Two runs of the same name are distinguished by what differs.
    """
    names = run_names(runs)
    records: list[tuple[Any, ...]] = []
    for run, name, note in zip(runs, names, notes or notes_of(runs, beside_published), strict=True):
        summary = run.summary
        shared = (sample_set(run), note)
        means = paper_means(run) if beside_published else summary
        values = {("epe", CLEAN): summary.epe_clean}
        for metric in RESULT_METRICS:
            values |= {(metric, name_): getattr(scores, metric) for name_, scores in summary.corruptions.items()}
            values[metric, AVERAGE] = getattr(means, metric)
        for (metric, corruption), value in values.items():
            if value is not None:
                head = (run.benchmark, run_setting(run), name, metric, corruption)
                records.append((*head, float(value), None, None, run.manifest.identity_digest, *shared))
    return pl.DataFrame(records, schema=RESULT_SCHEMA, orient="row")


def paper_means(run: Run) -> Scores:
    """The averages of a run that are shown next to published ones: the paper's mean where the run has it."""
    return run.summary.paper or run.summary


def paper_rows(run: Run) -> pl.DataFrame:
    """The rows that `paper_means` are over."""
    if not more_than_paper(run):
        return run.rows
    return run.rows.filter(pl.col("corruption").is_in([CLEAN, *run.summary.paper_over]))


def more_than_paper(run: Run) -> bool:
    """Whether a run's averages are over all of the paper's corruptions and others."""
    return run.summary.paper is not None and len(run.summary.averaged_over) > len(run.summary.paper_over)


def coverage_of(runs: Sequence[Run]) -> dict[tuple[str, str], float]:
    """(sample set, name) -> share of the pixels included in the mean errors, for the runs that left out any."""
    summaries = {(sample_set(run), name): run.summary for name, run in zip(run_names(runs), runs, strict=True)}
    return {
        key: summary.coverage
        for key, summary in summaries.items()
        if summary.coverage is not None and has_gaps(summary)
    }


def run_setting(run: Run) -> str:
    """The setting of a run, by what its model was trained on; "own" if that was not declared."""
    return OWN_SETTING if run.setting == "UNKNOWN" else run.setting


def notes_of(runs: Sequence[Run], beside_published: bool = False) -> list[str]:
    """`note_of` each of several runs, and what tells those apart whose notes are alike but which cannot be compared:
    the seed, the ground truth, the pairs, ..."""
    notes = [note_of(run, beside_published) for run in runs]
    keys = [(run.benchmark, note) for run, note in zip(runs, notes, strict=True)]
    alike: dict[tuple[str, str], dict[str, Run]] = {}
    for key, run in zip(keys, runs, strict=True):
        alike.setdefault(key, {}).setdefault(sample_set(run), run)
    conditions = {
        (key, measured): words
        for key, of_set in alike.items()
        if len(of_set) > 1
        for measured, words in zip(of_set, conditions_of(list(of_set.values())), strict=True)
    }
    return [
        "; ".join(filter(None, (note, conditions.get((key, sample_set(run))))))
        for run, key, note in zip(runs, keys, notes, strict=True)
    ]


def note_of(run: Run, beside_published: bool = False) -> str:
    """What was measured, as far as a reader expects something else: pairs, corruptions, severities; on a benchmark of
    the paper the differences from the paper's measurement. `beside_published` as for `run_results`."""
    frames, averaged = run.manifest.identity.frames, run.summary.averaged_over
    facts = benchmark_facts(run.benchmark)
    remarks = [_pairs_note(run.benchmark, run.summary.samples, frames.protocol), truth_remark(frames.protocol)]
    if beside_published and more_than_paper(run):
        remarks.append(f"average over the paper's {len(run.summary.paper_over)} of {len(averaged)} corruptions")
    elif set(averaged) != set(facts.paper_corruptions):
        names = [inside(long_label(name)) for name in averaged]
        what = joined(names) if 0 < len(names) <= _MOST_NAMED else counted(len(names), "corruption")
        papers = f", not the paper's {len(facts.paper_corruptions)}" if facts.published else ""
        remarks.append(f"average over {what}{papers}")
    levels = sorted(run.manifest.selection.severities)
    if set(levels) != set(facts.severities):
        remarks.append(f"{'severity' if len(levels) == 1 else 'severities'} {joined(list(map(str, levels)))} only")
    if frames.severity_scale:
        remarks.append("calibrated severities" + (", not the paper's" if facts.published else ""))
    if not run.summary.complete:
        remarks.append("not complete")
    return "; ".join(filter(None, remarks))


def _pairs_note(benchmark: str, pairs: int, protocol: dict[str, Any]) -> str:
    facts, count = benchmark_facts(benchmark), counted(pairs, "pair")
    if not facts.published:
        return f"{count} of {benchmark_words(benchmark)}"
    if protocol.get("frames") == "released" and facts.paper_pairs in (None, pairs):
        return ""
    return f"{count}, not the paper's" + (f" {facts.paper_pairs}" if facts.paper_pairs else "")
