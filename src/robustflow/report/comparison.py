"""`Comparison`: the difference between two runs as data frames and as a table; tables of several runs: all pairs, a
ranking with ties, the spread over seeds, and the pairs required for a comparison."""

from __future__ import annotations

from collections.abc import Mapping
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
from .table import Column, Row, Table, TableCell

_COLUMNS = ("corruption", "value_first", "value_second", "difference", "low", "high", "p", "p_holm")
_COUNTS = ("blow_ups_first", "blow_ups_second")
_OF_ALL = pl.col("corruption").is_in([CLEAN, AVERAGE])
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
        return self.frame.filter(_OF_ALL).select("metric", *_COLUMNS, *_COUNTS)

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
        return self.frame.filter(~_OF_ALL, metric=metric).select(*_COLUMNS, *_COUNTS)

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
        first, second = (plain(name) for name in self.names)
        each = self.per_corruption(metric).with_columns(metric=pl.lit(metric))
        sections = {
            "Overall": {mean_label(row["metric"], row["corruption"]): row for row in self.overall.to_dicts()},
            f"{metric_label(metric)} per corruption": {long_label(row["corruption"]): row for row in each.to_dicts()},
        }
        remarks = (self._sentence(metric), self.remark)
        return _table("comparison", f"{first} against {second}", (first, second), sections, remarks, "Mean", self.frame)

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
    pairs = {f"{plain(row['first'])} against {plain(row['second'])}": row for row in frame.to_dicts()}
    images = " to ".join(map(str, dict.fromkeys((frame["images"].min(), frame["images"].max()))))
    about = (
        f"Intervals: {100 * frame['level'][0]:g} %, over {images} images; p is corrected for {len(pairs)} comparisons."
    )
    remarks = (about + " A marked EPE is significantly lower." * (frame["metric"][0] == "epe"), note)
    sections = {f"Average {metric_label(frame['metric'][0])}": pairs}
    return _table("pairs", "Every two models", ("first", "second"), sections, remarks, "Models", frame)


def _table(
    name: str,
    title: str,
    heads: tuple[str, str],
    sections: Mapping[str, Mapping[str, dict[str, Any]]],
    remarks: tuple[str, str],
    row_header: str,
    frame: pl.DataFrame,
) -> Table:
    """Tabulate rows of a comparison, by section and label."""
    blow_ups, alpha = bool(frame.select(pl.sum_horizontal(*_COUNTS).sum()).item()), 1 - frame["level"][0]
    columns = (*heads, Column("difference", "{:+.2f}"), "interval", "p", "p corrected", "blow-ups")[: 6 + blow_ups]
    rows = {heading: [_row(*item, blow_ups, alpha) for item in of.items()] for heading, of in sections.items()}
    said, note = remarks
    return Table.of(name, title, columns, rows, (said, _BLOW_UPS * blow_ups, note), row_header, keep_empty=True)


def _row(label: str, row: dict[str, Any], blow_ups: bool, alpha: float) -> Row:
    # a flow that is too short has a lower CRE, CREr and RCRE than the sound flow, so only a lower EPE is marked
    sure = row["metric"] == "epe" and row["p_holm"] is not None and row["p_holm"] < alpha
    interval = None if row["low"] is None else f"[{row['low']:+.2f}, {row['high']:+.2f}]"
    p_values = (None if row[p] is None else p_text(row[p]).removeprefix("= ") for p in ("p", "p_holm"))
    counts = f"{row['blow_ups_first']}, {row['blow_ups_second']}"
    first = TableCell(f"{row['value_first']:.2f}", sure and row["difference"] < 0)
    second = TableCell(f"{row['value_second']:.2f}", sure and row["difference"] > 0)
    return Row(label, (first, second, row["difference"], interval, *p_values, counts)[: 6 + blow_ups])


def standings_table(standings: pl.DataFrame, metric: str) -> Table:
    """Tabulate the ranking of models with the range of ranks consistent with the tests, from
    `stats.uncertainty.standings`."""
    rows = [
        (plain(model), (value, str(rank), str(best) if best == worst else f"{best} to {worst}"))
        for model, value, rank, best, worst in standings.iter_rows()
    ]
    remark = (
        "possible ranks: consistent with the significant differences from the other models (paired tests, corrected "
        "for all pairs); models whose ranges overlap may be tied."
    )
    columns = (metric_label(metric), "rank", "possible ranks")
    return Table.of("standings", "Ranking", columns, {f"Average {METRIC_LABELS[metric]}": rows}, [remark])


def variance_table(split: pl.DataFrame, metric: str, name: str, remark: str = "") -> Table:
    """Tabulate the variance of one model's score by source, from `stats.uncertainty.variance_split`; `remark`
    describes omitted data."""
    about = (
        "deviation: standard deviation of the score of one image, averaged over corruptions; error of the mean: "
        "contribution of the source to the standard error of the mean over all images and seeds. Severities are fixed "
        "by the protocol, not sampled."
    )
    columns = (
        Column("levels", "{:d}"),
        Column("deviation (px)", "{:.3f}"),
        Column("share %", "{:.1f}"),
        Column("error of the mean (px)", "{:.3f}"),
    )
    rows = split.select("levels", "deviation", "share", "error_of_mean").iter_rows()
    title = f"Sources of variance in the {METRIC_LABELS[metric]} of {plain(name)}"
    sections = {METRIC_LABELS[metric]: zip(split["source"], rows, strict=True)}
    return Table.of("variance", title, columns, sections, (about, plain(remark, None)), "Source")


_NEEDED = ("images_needed", "clusters_needed", "clusters_low", "clusters_high")


def power_table(plan: pl.DataFrame, power: float, level: float) -> Table:
    """Tabulate the output of `stats.uncertainty.power.plan_pairs`: one section per metric, one row per comparison."""
    then = f"for {plan['effect'][0]:g} px"
    columns = (
        Column("difference (px)", "{:+.3f}"),
        Column("detectable now (px)", "{:.3f}"),
        Column("pairs now", "{:,}"),
        Column("groups now", "{:,}"),
        f"power {then}",
        f"pairs {then}",
        "groups (interval)",
    )
    sections: dict[str, list[Row]] = {}
    for row in plan.iter_rows(named=True):
        pairs, *groups = (_count(row[name]) for name in _NEEDED)
        now = (row[name] for name in ("difference", "detectable", "images", "clusters"))
        values = (*now, f"{100 * row['power']:.0f} %", pairs, "{} ({} to {})".format(*groups))
        made = Row(f"{plain(row['first'])} - {plain(row['second'])}", values)
        sections.setdefault(f"Average {METRIC_LABELS[row['metric']]}", []).append(made)
    about = (
        f"detectable: the difference that a paired test at the {100 * (1 - level):g} % level detects with probability "
        f"{100 * power:g} %. A group is a drive or sequence, or a single pair without either. The numbers of pairs "
        "assume as many pairs per group as in these runs, and all are estimated from the variance of these runs; the "
        f"{100 * level:g} % interval of the number of groups is too short if a few groups dominate the difference."
    )
    return Table.of("power", "Pairs required for a comparison", columns, sections, [about], "Comparison")


def _count(number: int | None) -> str:
    return "over 10^9" if number is None else f"{number:,}"
