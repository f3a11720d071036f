"""`Comparison`: the difference between two runs as data frames and as a table; tables of several runs: all pairs, a
ranking with ties, the spread over seeds, and the pairs required for a comparison."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import polars as pl

from ..core.errors import UsageError, unknown_name
from ..core.text import joined, plain
from ..metrics.cube import Cube
from ..metrics.measures import EVERY, LABELS, LEADING, MEASURES
from ..run.comparable import common_to, named_runs
from ..run.records.pack import load_any_run
from ..run.run import Run
from ..stats.estimate import HEADLINE, contrast, cubes_of
from ..stats.exclusion import exclusions, not_ranked
from ..stats.paired import difference_sentence, is_sure, p_text, standings
from ..stats.results import AVERAGE, CLEAN, long_label, mean_label, metric_label
from ..stats.verdict import WITHOUT_TRUTH, compared, verdict_of
from .render import render
from .table import Column, Row, Table, TableCell

_COUNTS = ("blow_ups_model", "blow_ups_against")
BESIDE_RCRE = {name: MEASURES[name] for name in WITHOUT_TRUTH[1:]}
"""What is shown beside RCRE without ground truth: a flow that ignores the frames has a low RCRE."""
_OF_ALL = pl.col("condition").is_in([CLEAN, AVERAGE])
_BLOW_UPS = (
    "blow-ups: images on which the error (EPE, or RCRE without ground truth) of the first and of the second is more "
    "than ten times that of the other; if they are few, the mean and the test depend on them."
)


@dataclass(frozen=True, eq=False, repr=False)
class Comparison:
    """A comparison of two runs on the same frames. Differences are first minus second, so they are negative if the
    first run has the lower value.

    Attributes:
        cubes: the rows of the two runs that may be compared, by name.
        remark: sentences about omitted data, differences between the runs, and reasons why a run is not ranked; may be
            empty.
    """

    cubes: Mapping[str, Cube]
    remark: str = ""

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the two runs."""
        return tuple(self.cubes)

    @cached_property
    def frame(self) -> pl.DataFrame:
        """All comparisons in EPE, CRE, CREr and RCRE, without ground truth also the overall ones of the photometric
        error, with the columns of `robustflow.stats.estimate.CONTRASTS`."""
        frame = contrast(self.cubes, HEADLINE)
        if LEADING in set(frame["measure"]):
            return frame
        return contrast(self.cubes, HEADLINE | BESIDE_RCRE).filter(~pl.col("measure").is_in([*BESIDE_RCRE]) | _OF_ALL)

    @property
    def metric(self) -> str:
        """The headline metric: "epe", or "rcre" without ground truth."""
        return "epe" if "epe" in set(self.frame["measure"]) else "rcre"

    @property
    def overall(self) -> pl.DataFrame:
        """Differences in clean EPE and in the averages."""
        return self.frame.filter(_OF_ALL)

    def of(self, metric: str = "") -> pl.DataFrame:
        """Return the differences in one metric, also on average, with p corrected over all of them.

        Args:
            metric: a measure of `robustflow.metrics.MEASURES`; the headline metric by default.

        Raises:
            UsageError: unknown metric.
            RunError: it was not measured in both runs.
        """
        metric = metric or self.metric
        if metric not in MEASURES:
            raise unknown_name("metric", metric, MEASURES)
        if metric in HEADLINE:
            return self.frame.filter(measure=metric)
        return contrast(self.cubes, {metric: MEASURES[metric]})

    def per_corruption(self, metric: str = "") -> pl.DataFrame:
        """Return the differences in one metric (see `of`) under each corruption, in the paper's order."""
        return self.of(metric).filter(~_OF_ALL)

    @property
    def sentence(self) -> str:
        """State what can be concluded about the average of the headline metric or, if there is no average, about the
        first corruption."""
        return _sentence(self.of(), self.metric)

    def table(self, metric: str = "") -> Table:
        """Return a table for `robustflow.report.render`: the overall rows, then one metric (see `of`) for every
        corruption."""
        metric, found = metric or self.metric, self.of(metric)
        first, second = (plain(name) for name in self.names)
        overall = self.overall if metric in HEADLINE else pl.concat([self.overall, found.filter(_OF_ALL)])
        each = found.filter(~_OF_ALL)
        sections = {
            "Overall": {mean_label(row["measure"], row["condition"]): row for row in overall.to_dicts()},
            f"{metric_label(metric)} per corruption": {long_label(row["condition"]): row for row in each.to_dicts()},
        }
        remarks = (_sentence(found, metric), self.remark)
        return _table("comparison", f"{first} against {second}", (first, second), sections, remarks, "Mean", self.frame)

    def __repr__(self) -> str:
        return render(self.table(), "terminal").rstrip()

    def _repr_html_(self) -> str:
        return render(self.table(), "html")


def _sentence(of_metric: pl.DataFrame, metric: str) -> str:
    average = of_metric.filter(condition=AVERAGE)
    rows = (average if average.height else of_metric).to_dicts()
    return difference_sentence(rows[0]) if rows else f"No {LABELS[metric]} was measured in both runs."


AnyRun = Run | str | Path
"""A run, or the path of its folder or record."""


def compare(first: AnyRun, second: AnyRun) -> Comparison:
    """Test whether two runs on the same frames differ, using paired tests over images with intervals and corrected
    p-values.

    Args:
        first, second: runs, or paths of their folders or records. Only conditions measured by both runs on the same
            frames and ground truth are compared.

    Raises:
        RunError: the runs have no condition in common on the same frames and ground truth; the message states how they
            differ.
        UsageError: an argument is neither a run nor a path.

    >>> import tempfile, numpy as np
    >>> from robustflow import compare, evaluate
    >>> options = {"corruptions": ["contrast"], "severities": [1]}
    >>> with tempfile.TemporaryDirectory() as a, tempfile.TemporaryDirectory() as b:
    ...     runs = [evaluate("dis", "demo", output=folder, **options) for folder in (a, b)]
    ...     compare(*runs).per_corruption("epe")["value"].to_list()
    [0.0]
    """
    runs = [_open_run(first), _open_run(second)]
    named = named_runs(runs)
    common = common_to(named)
    remarks = (common.remark, unranked_words(named), setting_words(named))
    return Comparison(cubes_of(common.rows), " ".join(filter(None, remarks)))


def _open_run(run: AnyRun) -> Run:
    if isinstance(run, Run):
        return run
    if isinstance(run, str | Path):
        return load_any_run(run)
    raise UsageError(type(run).__name__, "compare expects runs, or paths of their folders or records")


def pairs_table(frame: pl.DataFrame, note: str = "") -> Table:
    """Tabulate all pairwise comparisons of several models, for `robustflow.report.render`."""
    sections: dict[str, dict[str, dict[str, Any]]] = {}
    for row in frame.to_dicts():
        of_measure = sections.setdefault(f"Average {metric_label(row['measure'])}", {})
        of_measure[f"{plain(row['model'])} against {plain(row['against'])}"] = row
    many = max(map(len, sections.values()))
    images = " to ".join(map(str, dict.fromkeys((frame["pairs"].min(), frame["pairs"].max()))))
    about = f"Intervals: 95 %, over {images} images; p is corrected for {many} comparisons."
    metric = frame["measure"][0]
    marked = f" A marked {LABELS[metric]} is significantly lower."
    remarks = (about + marked * (EVERY[metric].verdict == "leads"), note)
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
    blow_ups = bool(frame.select(pl.sum_horizontal(*_COUNTS).sum()).item())
    tests = (Column("difference", "{:+.2f}"), "interval", "ratio", "wins", "p", "blow-ups")
    columns = (*heads, *tests[: 5 + blow_ups])
    rows = {heading: [_row(*item, blow_ups) for item in of.items()] for heading, of in sections.items()}
    said, note = remarks
    return Table.of(name, title, columns, rows, (said, _BLOW_UPS * blow_ups, note), row_header, keep_empty=True)


def _row(label: str, row: dict[str, Any], blow_ups: bool) -> Row:
    sure = EVERY[row["measure"]].verdict == "leads" and is_sure(row)
    interval = None if row["low"] is None else f"[{row['low']:+.2f}, {row['high']:+.2f}]"
    p = None if row["p_adjusted"] is None else p_text(row["p_adjusted"]).removeprefix("= ")
    counts = f"{row['blow_ups_model']}, {row['blow_ups_against']}"
    first = TableCell(f"{row['value_model']:.2f}", sure and row["value"] < 0)
    second = TableCell(f"{row['value_against']:.2f}", sure and row["value"] > 0)
    ratio = None if row["ratio"] is None else f"{row['ratio']:.2f}"
    wins = None if row["wins"] is None else f"{row['wins']}:{row['losses']}"
    return Row(label, (first, second, row["value"], interval, ratio, wins, p, counts)[: 7 + blow_ups])


def ranked_in_settings(
    runs: Mapping[str, Run], rows: Mapping[str, pl.DataFrame], metric: str
) -> tuple[list[Table], list[str]]:
    """Return the ranking of each setting by a metric that ranks, and the verdicts in words.

    Args:
        runs: several runs by name.
        rows: their comparable rows.
    """
    tables, words = [], [setting_words(runs)]
    of_setting: dict[str, dict[str, pl.DataFrame]] = {}
    for (name, run), reason in zip(runs.items(), exclusions(list(runs.values())), strict=True):
        if not reason:
            of_setting.setdefault(run.setting, {})[name] = rows[name]
    for setting, ranked in of_setting.items():
        if len(ranked) < 2:
            continue
        if sentence := verdict_of(compared(ranked)).sentence:
            words.append(f"{plain(setting)}: {sentence}")
        if MEASURES[metric].verdict != "explains":
            tests = contrast(cubes_of(ranked), {metric: MEASURES[metric]}, [(AVERAGE, None)])
            tables.append(standings_table(standings(tests, list(ranked)), metric, setting))
    return tables, words


def unranked_words(runs: Mapping[str, Run]) -> str:
    """Say why runs are not ranked; "" if all are."""
    reasons = dict(zip(runs, exclusions(list(runs.values())), strict=True))
    return " ".join(f"Not ranked: {reason}." for reason in not_ranked(reasons))


def setting_words(runs: Mapping[str, Run]) -> str:
    """Name the settings of models, if they differ; "" otherwise."""
    settings = {name: run.setting for name, run in runs.items()}
    if len(set(settings.values())) < 2:
        return ""
    each = joined([f"{plain(name)} {plain(setting)}" for name, setting in settings.items()])
    return f"Settings: {each}; models of different settings are compared, but not ranked together."


def standings_table(standings: pl.DataFrame, metric: str, setting: str) -> Table:
    """Tabulate the ranking of the models of a setting with the range of ranks consistent with the tests, from
    `stats.paired.standings`."""
    rows = [
        (plain(model), (value, str(rank), str(best) if best == worst else f"{best} to {worst}"))
        for model, value, rank, best, worst in standings.iter_rows()
    ]
    remark = (
        "possible ranks: consistent with the significant differences from the other models (paired tests, corrected "
        "for all pairs); models whose ranges overlap may be tied."
    )
    columns = (metric_label(metric), "rank", "possible ranks")
    return Table.of("standings", f"Ranking, {plain(setting)}", columns, {f"Average {LABELS[metric]}": rows}, [remark])


def variance_table(split: pl.DataFrame, metric: str, name: str, remark: str = "") -> Table:
    """Tabulate the variance of one model's score by source, from `stats.variance_split`; `remark`
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
    title = f"Sources of variance in the {LABELS[metric]} of {plain(name)}"
    sections = {LABELS[metric]: zip(split["source"], rows, strict=True)}
    return Table.of("variance", title, columns, sections, (about, plain(remark, None)), "Source")


_NEEDED = ("pairs_needed", "clusters_needed", "clusters_low", "clusters_high")


def power_table(plan: pl.DataFrame, power: float) -> Table:
    """Tabulate the output of `stats.power.plan_pairs`: one section per metric, one row per comparison."""
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
        now = (row[name] for name in ("value", "detectable", "pairs", "clusters"))
        values = (*now, f"{100 * row['power']:.0f} %", pairs, "{} ({} to {})".format(*groups))
        made = Row(f"{plain(row['model'])} - {plain(row['against'])}", values)
        sections.setdefault(f"Average {LABELS[row['measure']]}", []).append(made)
    about = (
        f"detectable: the difference that the paired test at the 5 % level detects with probability {100 * power:g} %, "
        "by simulating it on the differences in these runs. A group is a drive or sequence, or a single pair without "
        "either. The numbers of pairs assume as many pairs per group as in these runs; the 95 % interval of the number "
        "of groups is too short if a few groups dominate the difference."
    )
    return Table.of("power", "Pairs required for a comparison", columns, sections, [about], "Comparison")


def _count(number: int | None) -> str:
    return "over 10^9" if number is None else f"{number:,}"
