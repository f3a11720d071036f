"""From rows to means, by the paper's averaging and by pooled pixels.

The paper averages over the pixels of an image, then images, then severities, then corruptions (section
"Robustness Metrics"). A run's mean is over the corruptions that it was asked for; the paper's, over its 20 or 24,
is given beside it where all of them were run. Every mean here is `math.fsum(...) / count`, which is exactly
rounded and so does not depend on the order of the rows; the summary of the same rows is the same to the byte
however they were computed or stored.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Collection, Iterable, Sequence
from typing import Any, Literal, get_args

import polars as pl

from ..corruptions.registry import FAMILIES, IMAGE_PAIR, PAPER_ORDER
from ..errors import RunError, UsageError
from ..metrics.regions import REGIONS
from ..metrics.robustness import cre, crer
from ..metrics.rows import CLEAN, FIRST_SCHEMA, ROW_KEY, complete_rows
from ..metrics.summary import METRICS, Averaging, CorruptionScores, MissingCells, RegionScores, Scores, Summary
from .family_means import by_family
from .plan import Cell

_WHOLE = {
    "epe": ("epe_sum", "n_valid", 1.0),
    "rcre_all": ("rcre_all_sum", "n_all", 1.0),
    "fl": ("fl_count", "n_valid", 100.0),
    "px1": ("px1_count", "n_valid", 100.0),
    "px3": ("px3_count", "n_valid", 100.0),
    "px5": ("px5_count", "n_valid", 100.0),
    "wauc": ("wauc_sum", "n_valid", 100.0),
    "coverage": ("n_covered", "n_wanted", 1.0),
}
"""Metric: (column of its sum, column of its count, factor)."""

_NEEDS: tuple[tuple[str, str], ...] = (
    *((count, total) for total, count, _ in _WHOLE.values() if count in FIRST_SCHEMA),
    ("n_valid", "rcre_sum"),
    *((f"n_{region}", f"{total}_{region}") for region in REGIONS for total in ("epe_sum", "rcre_sum", "fl_count")),
    *((f"n_{region}", "n_valid") for region in REGIONS),
)
"""(column of a count, column of what is there wherever pixels were counted)."""


def summarize(
    rows: pl.DataFrame,
    averaging: Averaging = "image",
    planned: Iterable[Cell] | None = None,
    *,
    paper: Collection[str] = IMAGE_PAIR,
    over: Literal["all", "paper"] = "all",
) -> Summary:
    """The means of a run.

    Args:
        rows: columns of `ROW_SCHEMA`, in any order.
        averaging: "image" (the paper's) or "pixel" (the pixels of all images in one mean).
        planned: every (sample, corruption, severity) there should be, clean rows as (sample, "clean", 0). By
            default every sample found, at every (corruption, severity) found and clean.
        paper: the corruptions that the paper's mean on the benchmark is over.
        over: what the overall means are over: all corruptions found, or those alone that the paper has, as summaries of
            version 1 were made.

    Returns:
        A `Summary`. CRE compares the same pixels of the same samples: those found both at the setting and clean, where
        both flows are predicted. Overall means are over every corruption found, elastic_transform, a user's own and
        stacks "a+b" among them; `Summary.paper` holds the paper's mean.

    Raises:
        RunError: columns or sums that are missing, or a (sample, corruption, severity) found twice.
        UsageError: unknown averaging.
    """
    if averaging not in get_args(Averaging):
        raise UsageError(f"unknown averaging '{averaging}': choose from {', '.join(get_args(Averaging))}")
    rows = complete_rows(_checked(rows))
    cells = list(rows.select(ROW_KEY).iter_rows())
    samples = {sample for sample, _, _ in cells}
    settings = {(corruption, severity) for _, corruption, severity in cells} | {(CLEAN, 0)}
    expected = {(s, *setting) for s in samples for setting in settings} if planned is None else set(planned)
    missing = _units(expected - set(cells))
    with_truth = pl.coalesce("n_valid", "n_all")
    unmeasured = _units(rows.filter(with_truth == 0).select(ROW_KEY).iter_rows())

    whole = rows.with_columns(
        rcre_sum=pl.when(pl.col("n_valid").is_null()).then("rcre_all_sum").otherwise("rcre_sum"),
        rcre_n=with_truth,
        n_covered=with_truth,
        n_wanted=pl.when(pl.col("n_valid").is_null()).then(pl.col("height") * pl.col("width")).otherwise("n_truth"),
    )
    clean, by_setting = _scores(whole, _WHOLE | {"rcre": ("rcre_sum", "rcre_n", 1.0)}, averaging)
    corruptions = _corruptions(by_setting, clean, over)
    averaged_over = [name for name, scores in corruptions.items() if scores.averaged]
    overall = _mean_scores([corruptions[name] for name in averaged_over], clean)
    in_paper = [name for name in corruptions if name in paper]
    families = {family: _mean_scores(parts, clean) for family, parts in by_family(corruptions).items()}
    return Summary(
        **overall.model_dump(),
        averaging=averaging,
        complete=not missing and not unmeasured,
        missing=missing,
        unmeasured=unmeasured,
        samples=len(samples),
        n_invalid=int(rows["n_invalid"].sum()),
        epe_clean=clean.epe,
        clean=clean,
        averaged_over=averaged_over,
        corruptions=corruptions,
        families=families,
        regions=_regions(rows, averaging, over),
        paper=_mean_scores([corruptions[name] for name in in_paper], clean) if set(in_paper) == set(paper) else None,
        paper_over=in_paper if set(in_paper) == set(paper) else [],
    )


def _checked(rows: pl.DataFrame) -> pl.DataFrame:
    """The rows in the order of their keys, or the reason why these are not the rows of a run."""
    absent = [name for name in FIRST_SCHEMA if name not in rows.columns]
    if absent:
        raise RunError(f"rows lack the column '{absent[0]}': they are of another schema; run the benchmark again")
    rows = rows.sort(ROW_KEY)
    twice = rows.filter(rows.select(ROW_KEY).is_duplicated())
    if twice.height:
        sample, corruption, severity = twice.select(ROW_KEY).row(0)
        raise RunError(
            f"rows of sample '{sample}', {corruption} severity {severity} are there twice: "
            "the rows of two runs were mixed; summarise one run at a time"
        )
    lacking = [(pl.col(count) > 0).fill_null(False) & pl.col(total).is_null() for count, total in _NEEDS]
    damaged = rows.filter(pl.any_horizontal(lacking))
    if damaged.height:
        sample, corruption, severity = damaged.select(ROW_KEY).row(0)
        raise RunError(
            f"the row of sample '{sample}', {corruption} severity {severity} counts pixels without what was measured "
            "on them: the rows were damaged or changed; run the benchmark again"
        )
    return rows


def _units(units: Iterable[Any]) -> list[MissingCells]:
    by_setting: dict[tuple[str, int], list[str]] = defaultdict(list)
    for sample, corruption, severity in units:
        by_setting[corruption, severity].append(sample)
    return [
        MissingCells(corruption=corruption, severity=severity, samples=sorted(by_setting[corruption, severity]))
        for corruption, severity in sorted(by_setting)
    ]


_Columns = dict[str, tuple[str, str, float]]


def _scores(
    rows: pl.DataFrame, columns: _Columns, averaging: Averaging
) -> tuple[Scores, dict[tuple[str, int], Scores]]:
    """Scores on the clean frames, and at each (corruption, severity).

    CRE is None throughout where rows of an earlier version do not say what the clean error is over their pixels.
    """
    total, count, _ = columns["epe"]
    before = f"clean_{total}"
    clean_rows = rows.filter(pl.col("corruption") == CLEAN)
    clean = Scores(**_means(clean_rows, columns, averaging))
    partner = clean_rows.select("sample", _clean_n=count)
    settings = rows.filter(pl.col("corruption") != CLEAN).join(partner, on="sample", how="left", maintain_order="left")
    comparable = settings.filter((pl.col(count) > 0) & (pl.col("_clean_n") > 0))[before].null_count() == 0
    by_setting = {}
    for key, group in settings.partition_by("corruption", "severity", as_dict=True, maintain_order=True).items():
        corruption, severity = key
        both = group.filter((pl.col(count) > 0) & (pl.col("_clean_n") > 0))
        scores = Scores(**_means(group, columns, averaging))
        moved = None
        if comparable:
            paired = _means(both, {"epe": columns["epe"], "before": (before, count, 1.0)}, averaging)
            moved = cre(paired["epe"], paired["before"])
        by_setting[corruption, severity] = scores.model_copy(update={"cre": moved, "crer": crer(moved, clean.epe)})
    return clean, by_setting


def _means(rows: pl.DataFrame, columns: _Columns, averaging: Averaging) -> dict[str, float | None]:
    """The mean of each metric over images; images without a pixel to measure are left out."""
    out: dict[str, float | None] = {}
    for metric, (total, count, factor) in columns.items():
        images = [(s, n) for s, n in zip(rows[total].to_list(), rows[count].to_list(), strict=True) if n]
        if averaging == "image":
            out[metric] = _mean([factor * s / n for s, n in images])
        else:
            pixels = sum(n for _, n in images)
            out[metric] = factor * math.fsum(s for s, _ in images) / pixels if pixels else None
    return out


def _mean(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return math.fsum(known) / len(known) if known else None


def _mean_scores(parts: Sequence[Scores], clean: Scores) -> Scores:
    """Mean of each metric over severities or corruptions; CREr is the ratio of the means."""
    means = {metric: _mean([getattr(part, metric) for part in parts]) for metric in METRICS}
    return Scores(**means | {"crer": crer(means["cre"], clean.epe)})


def _corruptions(
    by_setting: dict[tuple[str, int], Scores], clean: Scores, over: Literal["all", "paper"]
) -> dict[str, CorruptionScores]:
    by_corruption: dict[str, dict[int, Scores]] = defaultdict(dict)
    for (corruption, severity), scores in sorted(by_setting.items(), key=lambda item: item[0]):
        by_corruption[corruption][severity] = scores
    family_of = {name: family for family, names in FAMILIES.items() for name in names}
    return {
        name: CorruptionScores(
            **_mean_scores(list(by_corruption[name].values()), clean).model_dump(),
            family=family_of.get(name),
            averaged=over == "all" or name in PAPER_ORDER,
            severities=list(by_corruption[name]),
            by_severity={m: [getattr(scores, m) for scores in by_corruption[name].values()] for m in METRICS},
        )
        for name in _corruption_order(by_corruption)
    }


def _regions(rows: pl.DataFrame, averaging: Averaging, over: Literal["all", "paper"]) -> dict[str, RegionScores]:
    out = {}
    for region in REGIONS:
        count = f"n_{region}"
        if not rows[count].sum():
            continue
        columns = {
            "epe": (f"epe_sum_{region}", count, 1.0),
            "rcre": (f"rcre_sum_{region}", count, 1.0),
            "fl": (f"fl_count_{region}", count, 100.0),
        }
        clean, by_setting = _scores(rows, columns, averaging)
        corruptions = _corruptions(by_setting, clean, over)
        overall = _mean_scores([c for c in corruptions.values() if c.averaged], clean)
        clean_rows = rows.filter((pl.col("corruption") == CLEAN) & pl.col(count).is_not_null())
        inside, n_valid = sum(clean_rows[count].to_list()), sum(clean_rows["n_valid"].to_list())
        out[region] = RegionScores(
            **overall.model_dump(),
            share=100.0 * inside / n_valid if n_valid else None,
            epe_clean=clean.epe,
            fl_clean=clean.fl,
        )
    return out


def in_order(summary: Summary) -> Summary:
    """A summary that was read from a file, whose keys may be in any order, in the order of one that is computed."""
    return summary.model_copy(
        update={
            "corruptions": {name: summary.corruptions[name] for name in _corruption_order(summary.corruptions)},
            "families": {name: summary.families[name] for name in FAMILIES if name in summary.families},
            "regions": {name: summary.regions[name] for name in REGIONS if name in summary.regions},
        }
    )


def _corruption_order(names: Collection[str]) -> list[str]:
    """The paper's order, then the others by name."""
    return [name for name in PAPER_ORDER if name in names] + sorted(set(names) - set(PAPER_ORDER))
