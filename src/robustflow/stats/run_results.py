"""Lines of results tables from runs: unique names, means, and the remarks that readers need before comparing them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from functools import cache, partial
from typing import TYPE_CHECKING, Any, TypeVar

from ..core.arguments import SEVERITIES
from ..core.files import digest_of_value
from ..core.text import counted, joined, plain
from ..data.benchmarks import benchmark_facts
from ..data.benchmarks.facts import estimate_remark, sample_noun, truth_remark
from ..run.cells import UNEVEN
from ..run.comparable import conditions_of, recipe_in_words, sample_set
from .exclusion import exclusions
from .model_result import ModelResult, Value
from .results import AVERAGE, CLEAN, RESULT_METRICS, benchmark_label, benchmark_words, inside, long_label
from .uncertainty.intervals import more_than_paper, paper_condition

if TYPE_CHECKING:
    from ..run.run import Run

AnyRun = TypeVar("AnyRun", bound="Run")

OWN_SETTING = "own"
"""The setting of a run whose model does not declare what it was trained on."""
_MOST_NAMED = 3
_LONGEST_VALUE = 24
_DIGITS = 8
_MODEL = "model "
_NOT_A_DIFFERENCE = {"name", "spec", "object", "source", "options"}
"""Parts of a model's identity that its name already contains or that follow from other parts."""


def run_names(runs: Sequence[Run]) -> list[str]:
    """Give each run a unique name: the model's name, followed by what differs between runs with the same name, such as
    the benchmark, a model option or the seed, or by the run's digest (and a number) if nothing readable differs."""
    of_name: dict[str, list[int]] = {}
    for index, run in enumerate(runs):
        of_name.setdefault(run.name, []).append(index)
    candidates = [""] * len(runs)
    for name, indices in of_name.items():
        for index, words in zip(indices, _differences([runs[index] for index in indices]), strict=True):
            candidates[index] = f"{name} ({', '.join(words)})" if words else name
    counts: Counter[str] = Counter()
    names = []
    for name in candidates:
        counts[name] += 1
        names.append(name if counts[name] == 1 else f"{name} #{counts[name]}")
    return names


def named_runs(runs: Sequence[AnyRun]) -> dict[str, AnyRun]:
    """Return the runs by their `run_names`."""
    return dict(zip(run_names(runs), runs, strict=True))


def _differences(runs: Sequence[Run]) -> list[list[str]]:
    """Select, for runs with the same name, the fewest facts (in the order of `_facts`) that distinguish the runs and
    their models."""
    facts = [dict(_facts(run)) for run in runs]
    keys = list(dict.fromkeys(key for known in facts for key in known))
    telling = {*_needed(facts, keys), *_needed(facts, [key for key in keys if key.startswith(_MODEL)])}
    chosen = [[known.get(key, "") for key in keys if key in telling] for known in facts]
    same = Counter(map(tuple, chosen))
    return [
        [*filter(None, words)] + ([run.manifest.identity_digest[:_DIGITS]] if same[tuple(words)] > 1 else [])
        for words, run in zip(chosen, runs, strict=True)
    ]


def _needed(facts: Sequence[Mapping[str, str]], keys: Sequence[str]) -> list[str]:
    """Select keys that distinguish the facts, skipping keys that add nothing to the previous ones."""
    chosen: list[str] = []
    groups = 1
    for key in keys:
        finer = len({tuple(known.get(name, "") for name in (*chosen, key)) for known in facts})
        if finer > groups:
            chosen.append(key)
            groups = finer
    return chosen


def _facts(run: Run) -> Iterator[tuple[str, str]]:
    """Yield (key, description) of everything that may differ between runs with the same name, most informative
    first."""
    identity, planned = run.manifest.identity, run.manifest
    yield "benchmark", benchmark_label(run.benchmark)
    yield "dataset", plain(identity.frames.dataset, _LONGEST_VALUE)
    trained_on = run.provenance.trained_on
    yield (
        f"{_MODEL}trained on",
        "training not stated" if trained_on is None else f"trained on {_named(trained_on, 'set')}",
    )
    for key, value in _texts(identity.model.settings):
        yield f"{_MODEL}{key}", f"{plain(key.replace('_', ' '), _LONGEST_VALUE)} {value}"
    for part, words in recipe_in_words(run):
        if part not in ("benchmark", "dataset"):
            yield part, words
    yield "corruptions", _named(planned.corruptions, "corruption")
    yield "severities", "severities " + ", ".join(map(str, planned.severities or SEVERITIES))
    yield "samples", counted(len(run.manifest.samples), "pair")
    yield "files", f"files {digest_of_value(dict(run.manifest.samples))[:_DIGITS]}"


def _texts(model: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield the settings of a model as text, with digests shortened to their first digits."""
    options = model.get("options") or {}
    for key, value in {**(options if isinstance(options, Mapping) else {}), **model}.items():
        if key not in _NOT_A_DIFFERENCE:
            text = plain(str(value), _LONGEST_VALUE)
            yield key, text[:_DIGITS] if len(str(value)) == 64 else text


def _named(names: Sequence[str], noun: str) -> str:
    """List the names if there are few, otherwise return their number."""
    if len(names) > _MOST_NAMED:
        return counted(len(names), noun)
    return "+".join(plain(str(name), _LONGEST_VALUE) for name in names) or "nothing"


def run_results(
    runs: Sequence[Run], beside_published: bool = False, notes: Sequence[str] | None = None, detailed: bool = True
) -> list[ModelResult]:
    """Collect the EPE, CRE, CREr and RCRE of runs, per corruption, clean and average."""
    names = run_names(runs)
    reasons = cache(lambda: exclusions(runs))
    results = []
    notes = notes or comparison_notes(runs, beside_published)
    for index, (run, name, note) in enumerate(zip(runs, names, notes, strict=True)):
        average = paper_condition(run) if beside_published else AVERAGE
        numbers = {("epe", CLEAN): run.epe_clean}
        for metric in RESULT_METRICS:
            numbers |= {(metric, name): run.mean(metric, name) for name in run.measured.corruptions}
            numbers[metric, AVERAGE] = run.mean(metric, average)
        digest = run.manifest.identity_digest
        values = {key: Value(float(number), source=digest) for key, number in numbers.items() if number is not None}
        head = (run.benchmark, sample_set(run), run_setting(run), name, note)
        exclusion = partial(lambda index: reasons()[index], index)
        results.append(ModelResult(*head, values, run, beside_published, detailed, exclusion=exclusion))
    return results


def run_setting(run: Run) -> str:
    """Return the setting of a run, determined by the model's training data; "own" if the training data are not
    declared."""
    return OWN_SETTING if run.setting == "UNKNOWN" else run.setting


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
    of the paper's benchmarks, the differences from the paper. For `beside_published` see `run_results`."""
    frames, averaged = run.manifest.identity.frames, run.measured.averaged_over
    facts = benchmark_facts(run.benchmark)
    remarks = [_pairs_note(run.benchmark, run.measured.samples, frames.protocol), truth_remark(frames.protocol)]
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
    return "; ".join(filter(None, remarks))


def estimate_of(run: Run) -> str:
    """Return the `estimate_remark` about a run's means."""
    planned = run.manifest
    facts = benchmark_facts(run.benchmark)
    return "" if planned.uneven else estimate_remark(facts, planned.corruptions, planned.severities)


def _pairs_note(benchmark: str, pairs: int, protocol: dict[str, Any]) -> str:
    facts, count = benchmark_facts(benchmark), counted(pairs, sample_noun(benchmark))
    if not facts.published:
        return f"{count} of {benchmark_words(benchmark)}"
    if protocol.get("frames") == "released" and facts.paper_pairs == pairs:
        return ""
    return f"{count}, not the paper's" + (f" {facts.paper_pairs}" if facts.paper_pairs else "")
