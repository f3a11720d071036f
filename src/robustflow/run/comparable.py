"""Decide which runs may be compared, for all tables, leaderboards, tests, trends, figures and exports.

Results of two runs may be compared if both measured the same rows: the same pairs under the same corruptions and
severities, with equal digests of the frames and of the ground truth. Means are over all rows of a run, so they require
that all rows are the same and were made with the same settings (`sample_set`); tests require only common rows
(`common_to`). Differences between runs are described in words, based on the settings (seed, draws, the source of a
user's corruption, ...) and the rows.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import reduce
from typing import Any, NamedTuple

import polars as pl

from ..core.errors import RunError
from ..core.files import digest_of_value
from ..core.text import counted, first_of, joined, plain
from ..data.benchmarks import benchmark_facts
from ..data.benchmarks.facts import truth_remark
from ..metrics.rows import CLEAN, ROW_KEY
from .cells import UNEVEN
from .config import FrameOptions, option_of
from .run import Run

SELECTION = ("pairs", "corruptions", "severities", "complete")
"""The parts of `measured_in_words` that describe which rows exist, not how they were made."""

_DIGESTS = ("frames_digest", "truth_digest")
_MOST_NAMED = 4
_LONGEST_VALUE = 24
_DIGITS = 6


def sample_set(run: Run) -> str:
    """Name what a run measured, whatever its model: means of runs with the same name may be compared."""

    def made() -> str:
        _clean_cells(run)  # cached now, from the same rows, because describing a difference needs these values
        missing = [unit.model_dump() for unit in run.measured.missing]
        return sample_set_of(run.manifest.identity.frames.record(), measured_cells(run.rows), missing)

    return run.cached_value("sample_set", str, made)


def sample_set_of(recipe: Any, cells: Iterable[Sequence[Any]], missing: Sequence[Any] = ()) -> str:
    """Return a name that identifies measured cells: (sample, corruption, severity, digest of frames, digest of ground
    truth).

    >>> sample_set_of("", [("a", "fog", 1, "00", None)]) == sample_set_of("", [("a", "fog", 1, "01", None)])
    False
    """
    return digest_of_value([recipe, sorted(cells, key=lambda cell: cell[:3]), missing])


def measured_cells(rows: pl.DataFrame) -> list[tuple[Any, ...]]:
    """Return the rows with a pixel to measure, in the form that `sample_set_of` expects."""
    return rows.filter(pl.coalesce("n_valid", "n_all") > 0).select(*ROW_KEY, *_DIGESTS).rows()


def common_rows(rows: Sequence[pl.DataFrame], names: Sequence[str]) -> tuple[list[pl.DataFrame], str]:
    """Return the rows that several runs have in common on the same data, and a remark about omitted rows (or "")."""
    parts = [one.select(*ROW_KEY, pl.struct(*_DIGESTS).alias(f"_{index}")) for index, one in enumerate(rows)]
    shared = reduce(lambda one, other: one.join(other, on=list(ROW_KEY), how="inner"), parts)
    every = joined(list(names))
    if shared.is_empty():
        raise RunError(every, "no sample, corruption and severity in common")
    same = shared.select(
        *ROW_KEY,
        *(
            pl.all_horizontal(
                pl.col("_0").struct.field(name).eq_missing(pl.col(f"_{index}").struct.field(name))
                for index in range(len(parts))
            ).alias(name)
            for name in _DIGESTS
        ),
    )
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
    cells = common.select(ROW_KEY)
    remark = ""
    if any(one.height != cells.height for one in rows):
        counts = joined([f"{one.height} in {name}" for name, one in zip(names, rows, strict=True)])
        remark = f"Compared: {cells.height} common rows (clean or corrupted pairs) out of {counts}."
    for noun, left_out in (("pair", pairs), ("corruption", corruptions)):
        if left_out:
            which = f"{counted(len(left_out), noun)} ({_listed(left_out)})"
            remark += f" Left out, because the frames or the ground truth differ: {which}."
    return [one.join(cells, on=list(ROW_KEY), how="semi") for one in rows], remark.strip()


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


def differences(runs: Mapping[str, Run], parts: Sequence[str] = ()) -> str:
    """Describe how the measurements of several runs differ; "" if they do not. `parts` limits the description to some
    of the parts of `measured_in_words`."""
    every = list(runs.values())
    if len({sample_set(run) for run in every}) == 1:
        return ""
    by_words: dict[str, list[str]] = {}
    for name, words in zip(runs, conditions_of(every, parts), strict=True):
        by_words.setdefault(words, []).append(name)
    return "; ".join(
        f"{joined(names)} {'has' if len(names) == 1 else 'have'} {words}" for words, names in by_words.items() if words
    )


def conditions_of(runs: Sequence[Run], parts: Sequence[str] = ()) -> list[str]:
    """Name briefly what each run measured, by the differences between the runs; "" for all if there are none."""
    measured = measured_in_words(runs)
    names = dict.fromkeys(name for one in measured for name in one)
    differing = [name for name in names if len({one.get(name, "") for one in measured}) > 1]
    other_data = any(name in ("benchmark", "dataset") or name.startswith("protocol ") for name in differing)
    explained = ("truth", "clean") if other_data else ("truth",) if "ground_truth" in differing else ()
    chosen = [name for name in differing if name not in explained and (not parts or name in parts)]
    words = [", ".join(one[name] for name in chosen if one.get(name)) for one in measured]
    if parts:
        return words
    sets = [sample_set(run) for run in runs]
    kinds = Counter(each for each, _ in set(zip(words, sets, strict=True)))
    return [
        each if kinds[each] == 1 else ", ".join(filter(None, (each, f"frames {frames[:_DIGITS]}")))
        for each, frames in zip(words, sets, strict=True)
    ]


def measured_in_words(runs: Sequence[Run]) -> list[dict[str, str]]:
    """Describe what each of several runs measured, part by part; the most informative parts come first."""
    clean = [_clean_cells(run) for run in runs]
    shared = sorted(set.intersection(*(set(one) for one in clean)))
    everywhere = set.intersection(*(set(run.measured.corruptions) for run in runs))
    out = []
    for run, cells in zip(runs, clean, strict=True):
        words, names = dict(recipe_in_words(run)), sorted(run.measured.corruptions)
        if shared:
            truth = [cells[sample][1] for sample in shared]
            words["truth"] = f"ground truth {_digits(truth)}" if any(truth) else "no ground truth"
            words["clean"] = f"clean frames {_digits([cells[sample][0] for sample in shared])}"
        alike = any(len(other) == len(cells) and other.keys() != cells.keys() for other in clean)
        words["pairs"] = counted(len(cells), "pair") + (f" {_digits(sorted(cells))}" if alike else "")
        more = [name for name in names if name not in everywhere]
        few = joined(names) if names else "no corruption"
        many = f"{len(names)} corruptions" + (f" (with {_listed(more)})" if more else "")
        words["corruptions"] = few if len(names) <= _MOST_NAMED else many
        levels = run.measured.severities or run.manifest.severities  # a run of attacks alone has no means
        words["severities"] = f"{'severity' if len(levels) == 1 else 'severities'} {joined(list(map(str, levels)))}"
        words["severities"] += f" ({UNEVEN})" if run.manifest.uneven else ""
        words["complete"] = "every planned row" if run.measured.complete else "rows missing"
        out.append({name: plain(value, 120) for name, value in words.items()})
    return out


def _clean_cells(run: Run) -> dict[str, tuple[str, str | None]]:
    """Map each sample to the digests of its clean frames and of its ground truth."""

    def made() -> dict[str, tuple[str, str | None]]:
        clean = run.rows.filter(corruption=CLEAN).sort("sample")
        return {sample: (frames, truth) for sample, frames, truth in clean.select("sample", *_DIGESTS).rows()}

    return run.cached_value("clean_cells", dict[str, tuple[str, str | None]], made)


def _digits(value: Any) -> str:
    return digest_of_value(value)[:_DIGITS]


_IN_WORDS: dict[str, Callable[[Any], str]] = {
    "dataset": lambda value: f"dataset {value}",
    **{
        name: option.in_words
        for name, field in FrameOptions.model_fields.items()
        if (option := option_of(field)) is not None and option.words
    },
    "psf": lambda value: f"lenses {value}" if value else "the package's lenses",
    "streams": lambda value: f"random streams {value}",
    "attacks": lambda value: f"attacks {value}",
}
"""Descriptions of the fields of `FrameIdentity`, the most informative first."""


def recipe_in_words(run: Run) -> Iterator[tuple[str, str]]:
    """Describe how a run's frames were chosen and made, field by field, from its manifest."""
    frames = run.manifest.identity.frames
    protocol, fields = dict(frames.protocol), dict(frames)
    yield "benchmark", f"benchmark {plain(benchmark_facts(run.benchmark).title, 40)}"
    yield "ground_truth", truth_remark(protocol) or "the usual ground truth"
    for name, value in sorted(protocol.items()):
        if name != "ground_truth":
            yield f"protocol {name}", f"{name} {_short(value)}"
    for name, words in _IN_WORDS.items():
        yield name, words(fields[name])
    for name in sorted(fields.keys() - {"benchmark", "protocol", "corruptions", *_IN_WORDS}):
        yield name, f"{name} {_short(fields[name])}"
    for name, digest in sorted(frames.corruptions.items()):
        yield f"source {name}", f"source {_digits(digest)} of {name}"


def _short(value: Any) -> str:
    if isinstance(value, Mapping):
        return ", ".join(f"{name}={_short(each)}" for name, each in sorted(value.items()))
    return plain(str(value), _LONGEST_VALUE)


def _listed(names: Sequence[str]) -> str:
    return first_of([plain(name, 40) for name in names], _MOST_NAMED)
