"""Settings of runs, and the remarks that readers need before comparing them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from ..core.text import counted, joined
from ..data.benchmarks import benchmark_facts, outside_remark
from ..data.benchmarks.facts import estimate_remark, sample_noun, truth_remark
from ..run.comparable import conditions_of, sample_set
from ..run.manifest import UNEVEN
from .intervals import more_than_paper
from .results import benchmark_words, inside, long_label

if TYPE_CHECKING:
    from ..run.run import Run

_MOST_NAMED = 3


def comparison_notes(runs: Sequence[Run], beside_published: bool = False) -> list[str]:
    """Return the `comparison_note` of each run. If runs that cannot be compared have equal notes, the difference is
    added, for example the seed, the ground truth or the pairs."""
    notes = [comparison_note(run, beside_published) for run in runs]
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


def comparison_note(run: Run, beside_published: bool = False) -> str:
    """Describe how the measurement differs from what a reader would expect: pairs, corruptions, severities and, on one
    of the paper's benchmarks, the differences from the paper. For `beside_published` see `results_frame`."""
    frames, averaged = run.manifest.identity.frames, run.measured.averaged_over
    facts = benchmark_facts(run.benchmark)
    outside = outside_remark(run.benchmark, frames.protocol, run.manifest.samples)
    remarks = [
        _pairs_note(run.benchmark, run.measured.samples, frames.protocol),
        outside,
        truth_remark(frames.protocol),
    ]
    if beside_published and more_than_paper(run):
        remarks.append(f"average over the paper's {len(run.measured.paper_over)} of {len(averaged)} corruptions")
    elif set(averaged) != set(facts.paper_corruptions):
        names = [inside(long_label(name)) for name in averaged]
        what = joined(names) if 0 < len(names) <= _MOST_NAMED else counted(len(names), "corruption")
        papers = f", not the paper's {len(facts.paper_corruptions)}" if facts.published else ""
        remarks.append(f"average over {what}{papers}")
    levels = run.manifest.severities
    if run.manifest.uneven:
        remarks.append(UNEVEN)
    elif levels and set(levels) != set(facts.severities):
        remarks.append(f"{'severity' if len(levels) == 1 else 'severities'} {joined(list(map(str, levels)))} only")
    remarks.append(estimate_of(run))
    if frames.made_with["severity_scale"] != "paper":
        remarks.append("calibrated severities" + (", not the paper's" if facts.published else ""))
    if not run.measured.complete:
        remarks.append("not complete")
    if run.manifest.flows_differ_on:
        remarks.append("predicts different flows for the same frames")
    remarks += [run.provenance.backbone_note, _doubtful_training(run), unknown_change(run)]
    return "; ".join(filter(None, remarks))


def _doubtful_training(run: Run) -> str:
    """Return a remark if a model that was not trained on the benchmark, as far as is known, has a clean EPE far below
    every published one: less than half of it on the paper's pairs, less than a quarter on others."""
    facts = benchmark_facts(run.benchmark)
    clean, lowest = run.epe_clean, facts.lowest_ood_clean_epe
    share = 0.5 if run.measured.samples == facts.paper_pairs else 0.25
    if clean is None or lowest is None or run.setting not in ("OOD", "UNKNOWN") or clean >= share * lowest:
        return ""
    below = f"clean EPE {clean:.2f} px, far below the lowest published OOD result ({lowest:.2f} px)"
    return f"{below}: these frames may be in its training data"


def estimate_of(run: Run) -> str:
    """Return the `estimate_remark` about a run's means."""
    planned = run.manifest
    facts = benchmark_facts(run.benchmark)
    return "" if planned.uneven else estimate_remark(facts, planned.corruptions, planned.severities)


def unknown_change(run: Run) -> str:
    """Return why a run with errors has no CRE or no CREr; "" if it has both."""
    if run.epe is None or run.epe_clean is None or run.crer is not None:
        return ""
    if run.cre is None:
        return f"no CRE: with errors of {run.epe_clean:.2g} px, differences are below the rounding of sums"
    return f"no CREr: a clean EPE of {run.epe_clean:.2g} px is below 1/64 px, the step of stored ground truth"


def _pairs_note(benchmark: str, pairs: int, protocol: dict[str, Any]) -> str:
    facts, count = benchmark_facts(benchmark), counted(pairs, sample_noun(benchmark))
    if not facts.published:
        return f"{count} of {benchmark_words(benchmark)}"
    if protocol.get("frames") == "released" and facts.paper_pairs == pairs:
        return ""
    return f"{count}, not the paper's" + (f" {facts.paper_pairs}" if facts.paper_pairs else "")
