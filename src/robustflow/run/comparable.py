"""Decide which runs may be compared, and name what tells runs apart, for all tables, leaderboards, tests, trends,
figures and exports.

Results of two runs may be compared if both measured the same rows: the same pairs under the same corruptions and
severities, with equal digests of the frames and of the ground truth. Means are over all rows of a run, so they require
that all rows are the same and were made with the same settings (`sample_set`); tests require only common rows
(`common_to`). Unique names of runs and descriptions of their differences are selected from one list, `run_facts`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import reduce
from typing import Any, NamedTuple, TypeVar

import polars as pl

from ..core.errors import RunError
from ..core.files import digest_of_value
from ..core.text import counted, first_of, joined, plain
from ..data.benchmarks import benchmark_facts
from ..data.benchmarks.facts import truth_remark
from ..metrics.rows import CLEAN, ROW_KEY
from .config import FrameOptions, option_of
from .manifest import UNEVEN
from .run import Run

AnyRun = TypeVar("AnyRun", bound=Run)
MEASURED = pl.coalesce("n_valid", "n_all") > 0
"""Whether a row has a pixel to measure."""

_DIGESTS = ("frames_digest", "truth_digest")
_MOST_NAMED = 4
_LONGEST_VALUE = 24
_DIGITS = 8
_MODEL = "model "
_IN_NAME = {"name", "spec", "object", "source", "options"}
"""Settings of a model that its name already contains or that follow from other settings."""
_DIGEST = "digest of "
"""Prefix of facts that only say that data differ: named where nothing else tells the runs apart."""


def sample_set(run: Run) -> str:
    """Name what a run measured, whatever its model: means of runs with the same name may be compared."""

    def made() -> str:
        _clean_cells(run)  # cached now, from the same rows, because describing a difference needs these values
        missing = [unit.model_dump() for unit in run.measured.missing]
        return sample_set_of(run.manifest.identity.frames.record(), measured_cells(run.rows), missing)

    return run.derived.value("sample_set", str, made)


def sample_set_of(recipe: Any, cells: Iterable[Sequence[Any]], missing: Sequence[Any] = ()) -> str:
    """Return a name that identifies measured cells: (sample, corruption, severity, digest of frames, digest of ground
    truth).

    >>> sample_set_of("", [("a", "fog", 1, "00", None)]) == sample_set_of("", [("a", "fog", 1, "01", None)])
    False
    """
    return digest_of_value([recipe, sorted(cells, key=lambda cell: cell[:3]), missing])


def measured_cells(rows: pl.DataFrame) -> list[tuple[Any, ...]]:
    """Return the rows with a pixel to measure, in the form that `sample_set_of` expects."""
    return rows.filter(MEASURED).select(*ROW_KEY, *_DIGESTS).rows()


def common_rows(rows: Sequence[pl.DataFrame], names: Sequence[str]) -> tuple[list[pl.DataFrame], str]:
    """Return the rows that several runs measured on the same data, and a remark about omitted rows (or "")."""
    every = joined(list(names))
    cells = pl.concat(one.filter(MEASURED).select(*ROW_KEY, *_DIGESTS) for one in rows).group_by(ROW_KEY)
    equal = [pl.col(name).n_unique() == 1 for name in _DIGESTS]
    same = cells.agg(*equal, runs=pl.len()).filter(runs=len(rows))
    if same.is_empty():
        raise RunError(every, "no sample, corruption and severity in common")
    differ = ~(pl.col("frames_digest") & pl.col("truth_digest"))
    pairs = same.filter(differ, corruption=CLEAN)["sample"].unique().sort().to_list()
    common = same.filter(~pl.col("sample").is_in(pairs))
    corruptions = common.filter(differ)["corruption"].unique().sort().to_list()
    common = common.filter(~pl.col("corruption").is_in(corruptions))
    if common.is_empty() or (corruptions and not (common["corruption"] != CLEAN).any()):
        frames = same.filter(~pl.col("frames_digest")).height
        truth = same.filter(~pl.col("truth_digest")).height
        sample, corruption, severity = same.filter(differ).sort(ROW_KEY).select(ROW_KEY).row(0)
        where = f"first in sample '{plain(sample)}', {plain(corruption)}, severity {severity}"
        counts = f"frames in {frames} and ground truth in {truth} of {same.height} common rows, {where}"
        raise RunError(every, f"not measured on the same data: different {counts}")
    kept = [one.join(common, on=list(ROW_KEY), how="semi") for one in rows]
    remark = omitted_rows(rows, kept, names)
    for noun, left_out in (("pair", pairs), ("corruption", corruptions)):
        if left_out:
            which = f"{counted(len(left_out), noun)} ({_named(left_out)})"
            remark += f" Left out, because the frames or the ground truth differ: {which}."
    return kept, remark.strip()


def common_cells(rows: Sequence[pl.DataFrame]) -> list[pl.DataFrame]:
    """Return the rows of the samples, corruptions and severities that all have, whatever their frames."""
    cells = reduce(lambda one, other: one.join(other, on=list(ROW_KEY), how="semi"), rows).select(ROW_KEY)
    return [one.join(cells, on=list(ROW_KEY), how="semi") for one in rows]


def omitted_rows(rows: Sequence[pl.DataFrame], kept: Sequence[pl.DataFrame], names: Sequence[str]) -> str:
    """Return a remark about the rows that are not compared; "" if all are."""
    if all(one.height == of_one.height for one, of_one in zip(rows, kept, strict=True)):
        return ""
    counts = joined([f"{one.height} in {name}" for name, one in zip(names, rows, strict=True)])
    return f"Compared: {kept[0].height} common rows (clean or corrupted pairs) out of {counts}."


class CommonRows(NamedTuple):
    """The rows of several runs that may be compared."""

    rows: Mapping[str, pl.DataFrame]
    remark: str = ""


def common_to(runs: Mapping[str, Run]) -> CommonRows:
    """Return the comparable rows of several runs, by name, and a description of all differences."""
    try:
        rows, remark = common_rows([run.rows for run in runs.values()], list(runs))
    except RunError as error:
        why = f"{error.args[-1]}; {differences(runs)}; compare runs on the same frames and ground truth"
        raise RunError(error.culprit, why) from None
    remarks = [remark]
    if words := differences(runs):
        remarks.append(f"The runs differ: {words}.")
    remarks += [
        f"{name} predicted {100 * (run.mean('coverage') or 0):.1f} % of the pixels; its errors cover only these pixels."
        for name, run in runs.items()
        if run.averages.has_gaps
    ]
    return CommonRows(dict(zip(runs, rows, strict=True)), " ".join(filter(None, remarks)))


def differences(runs: Mapping[str, Run]) -> str:
    """Describe how the measurements of several runs differ, whatever their models; "" if they do not."""
    by_words: dict[str, list[str]] = {}
    for name, words in zip(runs, conditions_of(list(runs.values())), strict=True):
        by_words.setdefault(words, []).append(name)
    return "; ".join(f"{joined(names)}: {words}" for words, names in by_words.items() if words)


def conditions_of(runs: Sequence[Run]) -> list[str]:
    """Describe what each run measured by the facts in which the runs differ; "" for all if there are none."""
    facts = run_facts(runs)
    keys = [key for key in dict.fromkeys(key for one in facts for key in one) if not key.startswith(_MODEL)]
    digests = [key for key in keys if key.startswith(_DIGEST)]
    readable = [key for key in keys if key not in digests and len({one.get(key) for one in facts}) > 1]
    chosen = [*readable, *_telling(facts, digests, readable)]
    return [", ".join(one[key] for key in chosen if key in one) for one in facts]


def run_names(runs: Sequence[Run]) -> list[str]:
    """Give each run a unique name: the model's name, followed by the fewest facts that distinguish the runs of the same
    name and their models, or by the run's digest (and a number) if no fact does."""
    by_name: dict[str, list[int]] = {}
    for index, run in enumerate(runs):
        by_name.setdefault(run.name, []).append(index)
    names = [run.name for run in runs]
    for name, indices in by_name.items():
        if len(indices) > 1:
            for index, words in zip(indices, _distinctions([runs[index] for index in indices]), strict=True):
                names[index] = f"{name} ({words})" if words else name
    counts: Counter[str] = Counter()
    for index, name in enumerate(names):
        counts[name] += 1
        names[index] = name if counts[name] == 1 else f"{name} #{counts[name]}"
    return names


def named_runs(runs: Sequence[AnyRun]) -> dict[str, AnyRun]:
    """Return the runs by their `run_names`."""
    return dict(zip(run_names(runs), runs, strict=True))


def _distinctions(runs: Sequence[Run]) -> list[str]:
    facts = run_facts(runs)
    keys = list(dict.fromkeys(key for one in facts for key in one))
    needed = {*_telling(facts, keys), *_telling(facts, [key for key in keys if key.startswith(_MODEL)])}
    words = [", ".join(one[key] for key in keys if key in needed and key in one) for one in facts]
    kinds = Counter(words)
    digests = (run.manifest.identity_digest[:_DIGITS] for run in runs)
    return [
        each if kinds[each] == 1 else ", ".join(filter(None, (each, digest)))
        for each, digest in zip(words, digests, strict=True)
    ]


def _telling(facts: Sequence[Mapping[str, str]], keys: Iterable[str], known: Sequence[str] = ()) -> list[str]:
    """Select the keys that distinguish runs which those before them, and the `known` keys, do not."""

    def kinds(names: Sequence[str]) -> int:
        return len({tuple(one.get(name) for name in names) for one in facts})

    chosen: list[str] = []
    for key in keys:
        if kinds([*known, *chosen, key]) > kinds([*known, *chosen]):
            chosen.append(key)
    return chosen


def run_facts(runs: Sequence[Run]) -> list[dict[str, str]]:
    """Describe everything that may differ between runs, fact by fact; the most informative facts come first."""
    everywhere = set.intersection(*(set(run.measured.corruptions) for run in runs)) if runs else set()
    return [{key: plain(text, 120) for key, text in _facts(run, everywhere)} for run in runs]


def _facts(run: Run, everywhere: set[str]) -> Iterator[tuple[str, str]]:
    frames, measured = run.manifest.identity.frames, run.measured
    trained_on = run.provenance.trained_on
    yield "benchmark", plain(benchmark_facts(run.benchmark).title, 40)
    yield "dataset", f"dataset {_short(frames.dataset)}"
    yield f"{_MODEL}training", "training UNKNOWN" if trained_on is None else f"trained on {_named(trained_on)}"
    settings = run.manifest.identity.model.settings
    options = settings.get("options")
    for key, value in {**(options if isinstance(options, Mapping) else {}), **settings}.items():
        if key not in _IN_NAME:
            yield f"{_MODEL}{key}", f"{_short(key.replace('_', ' '))} {_short(value)}"
    clean = _clean_cells(run)
    truth = [digest for _, digest in clean.values()]
    usual = "the usual ground truth" if any(truth) else "no ground truth"
    yield "ground truth", truth_remark(frames.protocol) or usual
    for key, value in sorted(frames.protocol.items()):
        if key != "ground_truth":
            yield f"protocol {key}", f"{key} {_short(value)}"
    for key, value in frames:
        if key not in ("benchmark", "dataset", "protocol", "corruptions", "attack_sources"):
            yield key, _in_words(key, value)
    for key, digest in sorted((frames.corruptions | frames.attack_sources).items()):
        yield f"source {key}", f"source {digest[:_DIGITS]} of {key}"
    names = sorted(measured.corruptions)
    more = [name for name in names if name not in everywhere]
    many = counted(len(names), "corruption") + (f" (with {_named(more)})" if more else "")
    yield "corruptions", many if len(names) > _MOST_NAMED else joined(names or ["no corruption"])
    levels = measured.severities or run.manifest.severities  # a run of attacks alone has no means
    uneven = f" ({UNEVEN})" if run.manifest.uneven else ""
    yield "severities", f"{'severity' if len(levels) == 1 else 'severities'} {joined(list(map(str, levels)))}{uneven}"
    yield "complete", "every planned row" if measured.complete else "rows missing"
    yield "pairs", counted(len(clean), "pair")
    yield "digest of pairs", f"pairs {_digits(list(clean))}"
    yield "digest of truth", f"ground truth {_digits(truth)}"
    yield "digest of clean frames", f"clean frames {_digits([digest for digest, _ in clean.values()])}"
    yield "digest of frames", f"frames {sample_set(run)[:_DIGITS]}"


def _clean_cells(run: Run) -> dict[str, tuple[str, str | None]]:
    """Map each sample to the digests of its clean frames and of its ground truth, sorted by sample."""

    def made() -> dict[str, tuple[str, str | None]]:
        clean = run.rows.filter(corruption=CLEAN).sort("sample")
        return {sample: (frames, truth) for sample, frames, truth in clean.select("sample", *_DIGESTS).rows()}

    return run.derived.value("clean_cells", dict[str, tuple[str, str | None]], made)


def _digits(value: Any) -> str:
    return digest_of_value(value)[:_DIGITS]


def _in_words(name: str, value: Any) -> str:
    """Describe a field of `FrameIdentity`, in the words of its option if it is one."""
    option = option_of(FrameOptions.model_fields[name]) if name in FrameOptions.model_fields else None
    if option is not None and option.words:
        return option.in_words(value)
    return f"default {name}" if value is None else f"{name} {_short(value)}"


def _short(value: Any) -> str:
    if isinstance(value, Mapping):
        return ", ".join(f"{name}={_short(each)}" for name, each in sorted(value.items()))
    text = str(value)
    return text[:_DIGITS] if len(text) == 64 else plain(text, _LONGEST_VALUE)  # 64: a SHA-256


def _named(names: Sequence[str]) -> str:
    return first_of([plain(name, 40) for name in names], _MOST_NAMED) or "nothing"
