"""`Comparison`: the difference between two runs as data frames and as a table; tables of several runs: all pairs, a
ranking with ties, the spread over seeds, and the pairs required for a comparison."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import polars as pl

from ..core.errors import UsageError, unknown_name
from ..core.text import plain
from ..run.comparable import common_to, named_runs
from ..run.records.pack import load_any_run
from ..run.run import Run
from ..stats.model_result import not_ranked, run_results
from ..stats.results import METRIC_LABELS, long_label, mean_label, metric_label
from ..stats.uncertainty import compare_rows
from ..stats.uncertainty.bootstrap import LEVEL, RESAMPLES
from ..stats.uncertainty.paired import p_text
from ..stats.uncertainty.sums import AVERAGE, CLEAN, INTERVAL_METRICS
from .render import render
from .table import DASH, Line, Table, TableCell, number_text, signed_text

_DIFFERENCE = ("difference", "interval", "p", "p corrected")
_COLUMNS = ("corruption", "value_first", "value_second", "difference", "low", "high", "p", "p_holm")
_COUNTS = ("blow_ups_first", "blow_ups_second")
_BLOW_UPS = (
    "blow-ups: images on which the error (EPE, or RCRE without ground truth) of the first and of the second is more "
    "than ten times that of the other; if they are few, the mean and the test depend on them."
)


@dataclass(frozen=True, eq=False, repr=False)
class Comparison:
    """A comparison of two runs on the same frames. Differences are first minus second, so they are negative if the
    first run has the lower value.

    Attributes:
        names: names of the two runs.
        frame: all comparisons, with the columns of `robustflow.stats.uncertainty.paired.COMPARISON_SCHEMA`.
        remark: sentences about omitted data, differences between the runs, and reasons why a run is not ranked; may be
            empty.
    """

    names: tuple[str, str]
    frame: pl.DataFrame
    remark: str = ""

    @property
    def metric(self) -> str:
        """The headline metric: "epe", or "rcre" without ground truth."""
        return "epe" if "epe" in set(self.frame["metric"]) else "rcre"

    @property
    def overall(self) -> pl.DataFrame:
        """Differences in clean EPE and in the averages: `metric`, followed by the columns of `per_corruption`."""
        of_all = self.frame.filter(pl.col("corruption").is_in([CLEAN, AVERAGE]))
        return of_all.select("metric", *_COLUMNS, *_COUNTS)

    def per_corruption(self, metric: str = "") -> pl.DataFrame:
        """Return the differences under each corruption, in the paper's order.

        Args:
            metric: "epe", "cre", "crer" or "rcre"; the headline metric by default.

        Returns:
            A frame with the columns corruption, value_first, value_second, difference, low, high (null if there are too
            few images), p, p_holm (p corrected over all corruptions and the average), blow_ups_first and
            blow_ups_second (numbers of images on which the error is more than ten times that of the other run).

        Raises:
            UsageError: unknown metric.
        """
        metric = metric or self.metric
        if metric not in INTERVAL_METRICS:
            raise unknown_name("metric", metric, INTERVAL_METRICS)
        lines = self.frame.filter(~pl.col("corruption").is_in([CLEAN, AVERAGE]), metric=metric)
        return lines.select(*_COLUMNS, *_COUNTS)

    @property
    def sentence(self) -> str:
        """State what can be concluded about the average of the headline metric or, if there is no average, about the
        first corruption."""
        return self._sentence(self.metric)

    def _sentence(self, metric: str) -> str:
        of_metric = self.frame.filter(metric=metric)
        average = of_metric.filter(corruption=AVERAGE)
        sentences = (average if average.height else of_metric)["sentence"].to_list()
        return str(sentences[0]) if sentences else f"No {METRIC_LABELS[metric]} was measured in both runs."

    def table(self, metric: str = "") -> Table:
        """Return a table for `robustflow.report.render`: the overall rows, then one metric for every corruption.

        Args:
            metric: "epe", "cre", "crer" or "rcre"; the headline metric by default.

        Raises:
            UsageError: unknown metric.
        """
        metric = metric or self.metric
        level = self.frame["level"][0]
        first, second = (plain(name) for name in self.names)
        blow_ups = _has_blow_ups(self.frame)
        each = self.per_corruption(metric).iter_rows(named=True)
        sections = {
            "Overall": [
                Line(mean_label(row["metric"], row["corruption"]), _cells(row, level, row["metric"], blow_ups))
                for row in self.overall.iter_rows(named=True)
            ],
            f"{metric_label(metric)} per corruption": [
                Line(long_label(row["corruption"]), _cells(row, level, metric, blow_ups)) for row in each
            ],
        }
        columns = (first, second, *_DIFFERENCE, *["blow-ups"] * blow_ups)
        remarks = (self._sentence(metric), _BLOW_UPS * blow_ups, self.remark)
        title = f"{first} against {second}"
        return Table.of("comparison", title, columns, sections, remarks, "Mean", keep_empty=True)

    def __repr__(self) -> str:
        return render(self.table(), "terminal").rstrip()

    def _repr_html_(self) -> str:
        return render(self.table(), "html")


AnyRun = Run | str | Path
"""A run, or the path of its folder or record."""


def compare(
    first: AnyRun, second: AnyRun, *, level: float = LEVEL, resamples: int = RESAMPLES, seed: int = 0
) -> Comparison:
    """Test whether two runs on the same frames differ, using paired tests over images with intervals and corrected
    p-values.

    Args:
        first, second: runs, or paths of their folders or records. Only conditions measured by both runs on the same
            frames and ground truth are compared.
        level: confidence level of the intervals, between 0 and 1.
        resamples, seed: number of bootstrap resamples, and their random seed. The same seed gives the same numbers.

    Raises:
        RunError: the runs have no condition in common on the same frames and ground truth; the message states how they
            differ.
        UsageError: an argument is neither a run nor a path, or the level or number of resamples is out of range.

    >>> import tempfile, numpy as np
    >>> from robustflow import compare, evaluate
    >>> options = {"corruptions": ["contrast"], "severities": [1]}
    >>> with tempfile.TemporaryDirectory() as a, tempfile.TemporaryDirectory() as b:
    ...     runs = [evaluate("dis", "demo", output=folder, **options) for folder in (a, b)]
    ...     compare(*runs).per_corruption("epe")["difference"].to_list()
    [0.0]
    """
    runs = [_open_run(first), _open_run(second)]
    common = common_to(named_runs(runs))
    (name, one), (other_name, other) = common.rows.items()
    frame = compare_rows(one, other, (name, other_name), level=level, resamples=resamples, seed=seed)
    unranked = [f"Not ranked: {reason}." for reason in not_ranked(run_results(runs))]
    return Comparison((name, other_name), frame, " ".join(filter(None, (common.remark, *unranked))))


def _open_run(run: AnyRun) -> Run:
    if isinstance(run, Run):
        return run
    if isinstance(run, str | Path):
        return load_any_run(run)
    raise UsageError(type(run).__name__, "compare expects runs, or paths of their folders or records")


def pairs_table(frame: pl.DataFrame, note: str = "") -> Table:
    """Tabulate all pairwise comparisons of several models, for `robustflow.report.render`."""
    metric, blow_ups = frame["metric"][0], _has_blow_ups(frame)
    lines = [
        Line(f"{plain(row['first'])} against {plain(row['second'])}", _cells(row, row["level"], metric, blow_ups))
        for row in frame.iter_rows(named=True)
    ]
    remarks = (
        f"p is corrected for {len(lines)} comparisons; a bold EPE is significantly lower.",
        _BLOW_UPS * blow_ups,
        note,
    )
    sections = {f"Average {metric_label(metric)}": lines}
    columns = ("first", "second", *_DIFFERENCE, *["blow-ups"] * blow_ups)
    return Table.of("pairs", "Every two models", columns, sections, remarks, "Models", keep_empty=True)


def _has_blow_ups(frame: pl.DataFrame) -> bool:
    return bool(frame.select(pl.sum_horizontal(*_COUNTS).sum()).item())


def _cells(row: dict[str, Any], level: float, metric: str, blow_ups: bool) -> tuple[TableCell, ...]:
    # a flow that is too short has a lower CRE, CREr and RCRE than the sound flow, so only a lower EPE is marked
    sure = metric == "epe" and row["p_holm"] is not None and row["p_holm"] < 1 - level
    interval = DASH if row["low"] is None else f"[{row['low']:+.2f}, {row['high']:+.2f}]"
    p_values = (DASH if row[p] is None else p_text(row[p]).removeprefix("= ") for p in ("p", "p_holm"))
    counts = [f"{row['blow_ups_first']}, {row['blow_ups_second']}"] * blow_ups
    return (
        TableCell(f"{row['value_first']:.2f}", sure and row["difference"] < 0),
        TableCell(f"{row['value_second']:.2f}", sure and row["difference"] > 0),
        *map(TableCell, (signed_text(row["difference"]), interval, *p_values, *counts)),
    )


def standings_table(standings: pl.DataFrame, metric: str) -> Table:
    """Tabulate the ranking of models with the range of ranks consistent with the tests, from
    `stats.uncertainty.standings`."""
    lines = [
        Line.of(
            plain(row["model"]),
            (
                f"{row['value']:.2f}",
                str(row["rank"]),
                str(row["best"]) if row["best"] == row["worst"] else f"{row['best']} to {row['worst']}",
            ),
        )
        for row in standings.iter_rows(named=True)
    ]
    remark = (
        "possible ranks: consistent with the significant differences from the other models (paired tests, corrected "
        "for all pairs); models whose ranges overlap may be tied."
    )
    columns = (metric_label(metric), "rank", "possible ranks")
    return Table.of("standings", "Ranking", columns, {f"Average {METRIC_LABELS[metric]}": lines}, [remark])


def variance_table(split: pl.DataFrame, metric: str, name: str, remark: str = "") -> Table:
    """Tabulate the variance of one model's score by source, from `stats.uncertainty.variance_split`; `remark`
    describes omitted data."""
    lines = []
    for row in split.iter_rows(named=True):
        numbers = f"{row['deviation']:.3f}", f"{row['share']:.1f}", number_text(row["error_of_mean"], 3)
        lines.append(Line.of(row["source"], (str(row["levels"]), *numbers)))
    about = (
        "deviation: standard deviation of the score of one image, averaged over corruptions; error of the mean: "
        "contribution of the source to the standard error of the mean over all images and seeds. Severities are fixed "
        "by the protocol, not sampled."
    )
    columns = ("levels", "deviation (px)", "share %", "error of the mean (px)")
    title = f"Sources of variance in the {METRIC_LABELS[metric]} of {plain(name)}"
    remarks = (about, plain(remark, None))
    return Table.of("variance", title, columns, {METRIC_LABELS[metric]: lines}, remarks, "Source")


def power_table(plan: pl.DataFrame, power: float, level: float) -> Table:
    """Tabulate the output of `stats.uncertainty.power.plan_pairs`: one section per metric, one row per comparison."""
    then = f"for {plan['effect'][0]:g} px"
    now = ("difference (px)", "detectable now (px)", "pairs now", "groups now")
    columns = (*now, f"power {then}", f"pairs {then}", "groups (interval)")
    sections: dict[str, list[Line]] = {}
    for row in plan.iter_rows(named=True):
        groups = [_count(row[f"clusters_{name}"]) for name in ("needed", "low", "high")]
        texts = (
            f"{row['difference']:+.3f}",
            f"{row['detectable']:.3f}",
            f"{row['images']:,}",
            f"{row['clusters']:,}",
            f"{100 * row['power']:.0f} %",
            _count(row["images_needed"]),
            f"{groups[0]} ({groups[1]} to {groups[2]})",
        )
        line = Line.of(f"{plain(row['first'])} - {plain(row['second'])}", texts)
        sections.setdefault(f"Average {METRIC_LABELS[row['metric']]}", []).append(line)
    about = (
        f"detectable: the difference that a paired test at the {100 * (1 - level):g} % level detects with probability "
        f"{100 * power:g} %. A group is a drive or sequence, or a single pair without either. The numbers of pairs "
        "assume as many pairs per group as in these runs, and all are estimated from the variance of these runs; the "
        f"{100 * level:g} % interval of the number of groups is too short if a few groups dominate the difference."
    )
    return Table.of("power", "Pairs required for a comparison", columns, sections, [about], "Comparison")


def _count(number: int | None) -> str:
    return "over 10^9" if number is None else f"{number:,}"
