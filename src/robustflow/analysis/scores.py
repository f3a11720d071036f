"""Runs as results: the means of run folders in the tidy shape, with what a reader must know before comparing them."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import polars as pl

from ..benchmarks import benchmark_facts
from ..benchmarks.facts import truth_remark
from ..corruptions.textures import KEY as TEXTURES
from ..digest import digest_of_bytes
from ..metrics.summary import Scores, has_gaps
from ..text import counted
from .labels import benchmark_words
from .published.tables import PAPER_PAIRS
from .results import AVERAGE, CLEAN, RESULT_METRICS, RESULT_SCHEMA
from .run_names import run_names

if TYPE_CHECKING:
    from ..runs.run import Run

OWN_SETTING = "own"
"""The setting of a run whose model does not declare what it was trained on."""

_OF_FRAMES = ("benchmark", "dataset", "protocol", "seed", "variant", "streams", "severity_scale", "psf")
"""The parts of a run's identity that determine which frames its model was given."""


def run_results(runs: Sequence[Run], beside_published: bool = False) -> pl.DataFrame:
    """EPE, CRE, CREr and RCRE of runs, per corruption, clean and average: columns of `results.RESULT_SCHEMA`.

    Next to published results (`beside_published`), the averages of a run with corruptions that are not in the paper are
    the paper's mean, `Summary.paper`; if not all of the paper's were run, it has no average. A run with only some of
    the paper's keeps its own average, with a note.

    Runs of one `sample_set` measured the same frames under the same corruptions, so their values can be compared;
    `note` says how they differ from the paper's. Two runs of the same name are distinguished by their digests.
    """
    names = run_names(runs)
    records: list[tuple[Any, ...]] = []
    for run, name in zip(runs, names, strict=True):
        identity, summary = run.manifest["identity"], run.summary
        shared = (sample_set(run), note_of(run, beside_published))
        means = paper_means(run) if beside_published else summary
        values = {("epe", CLEAN): summary.epe_clean}
        for metric in RESULT_METRICS:
            values |= {(metric, name_): getattr(scores, metric) for name_, scores in summary.corruptions.items()}
            values[metric, AVERAGE] = getattr(means, metric)
        for (metric, corruption), value in values.items():
            if value is not None:
                head = (str(identity["benchmark"]), run_setting(run), name, metric, corruption)
                records.append((*head, float(value), None, None, str(run.manifest["identity_digest"]), *shared))
    return pl.DataFrame(records, schema=RESULT_SCHEMA, orient="row")


def paper_means(run: Run) -> Scores:
    """The averages of a run that may be shown next to published ones; see `run_results`."""
    summary = run.summary
    if only_of_paper(run):
        return summary
    return summary.paper or Scores()


def paper_rows(run: Run) -> pl.DataFrame:
    """The rows that `paper_means` are over."""
    return run.rows if only_of_paper(run) else run.rows.filter(pl.col("corruption").is_in([CLEAN, *_wanted(run)]))


def only_of_paper(run: Run) -> bool:
    """Whether a run's averages are over the paper's corruptions only."""
    return set(run.summary.averaged_over) <= set(_wanted(run))


def _wanted(run: Run) -> tuple[str, ...]:
    return benchmark_facts(str(run.manifest["identity"]["benchmark"])).paper_corruptions


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
    return OWN_SETTING if run.setting == "undeclared" else run.setting


def sample_set(run: Run) -> str:
    """Names what was measured on: frames, corruptions and severities, their scale, seed and variant; not the model.

    Samples of other data may have the same names; the digests of the clean frames tell them apart. A run with missing
    conditions is averaged over the others, and can be compared with runs that lack the same ones.
    """
    return run.fact("sample_set", str, lambda: _sample_set(run))


def _sample_set(run: Run) -> str:
    identity = run.manifest["identity"]
    parts = {key: identity.get(key) for key in _OF_FRAMES}
    parts |= (
        {TEXTURES: identity[TEXTURES]} if TEXTURES in identity else {}
    )  # missing in runs from before textures could be chosen
    parts |= {"samples": run.manifest["samples"], "selection": run.manifest["selection"]}
    clean = run.rows.filter(corruption=CLEAN).select("sample", "frames_digest")
    parts["frames"] = sorted(clean.iter_rows())
    if not run.summary.complete:
        parts["without"] = [unit.model_dump() for unit in (*run.summary.missing, *run.summary.unmeasured)]
    text = json.dumps(parts, sort_keys=True, default=str)
    return digest_of_bytes(text.encode(), size=8)


def note_of(run: Run, beside_published: bool = False) -> str:
    """How a run differs from the paper's measurement, "" if it does not: pairs, corruptions, severities;
    `beside_published` as for `run_results`. For frames that the paper has no results on and that have no ground truth,
    only what was measured."""
    identity, selection = run.manifest["identity"], run.manifest["selection"]
    benchmark, pairs = str(identity["benchmark"]), run.summary.samples
    apart = not benchmark_facts(benchmark).published and run.summary.epe_clean is None
    if apart:
        remarks = [f"{counted(pairs, 'pair')} of {benchmark_words(benchmark)}"]
    else:
        remarks = [_pairs_note(benchmark, pairs, identity.get("protocol") or {})]
    wanted = benchmark_facts(benchmark).paper_corruptions
    averaged = run.summary.averaged_over
    if beside_published and not only_of_paper(run):
        of_paper = [name for name in wanted if name in averaged]
        remarks.append(
            f"average over the paper's {len(wanted)} of {counted(len(averaged), 'corruption')}"
            if run.summary.paper is not None
            else f"no average: {len(of_paper)} of the paper's {len(wanted)} corruptions, and others"
        )
    elif set(averaged) != set(wanted):
        average = f"average over {counted(len(averaged), 'corruption')}"
        remarks.append(average if apart else f"{average}, not the paper's {len(wanted)}")
    if set(selection["severities"]) != set(benchmark_facts(benchmark).severities):
        remarks.append(f"severities {', '.join(map(str, sorted(selection['severities'])))} alone")
    if "severity_scale" in identity:
        remarks.append("calibrated severities" + ("" if apart else ", not the paper's"))
    remarks.append(truth_remark(identity.get("protocol") or {}))
    if not run.summary.complete:
        remarks.append("not complete")
    return "; ".join(part for part in remarks if part)


def _pairs_note(benchmark: str, pairs: int, protocol: dict[str, Any]) -> str:
    facts, count = benchmark_facts(benchmark), counted(pairs, "pair")
    if not facts.published:
        return f"{count} of {benchmark_words(benchmark)}, not the paper's {PAPER_PAIRS}"
    if protocol.get("frames") == "released" and facts.paper_pairs in (None, pairs):
        return ""
    return f"{count}, not the paper's" + (f" {facts.paper_pairs}" if facts.paper_pairs else "")
