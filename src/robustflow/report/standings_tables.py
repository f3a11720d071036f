"""Tables for several runs: a ranking with ties, the spread over seeds, and the pairs required for a comparison."""

from __future__ import annotations

import polars as pl

from ..core.text import plain
from ..stats.results import METRIC_LABELS, metric_label
from .table import Column, Line, Section, Table, number_text


def standings_table(standings: pl.DataFrame, metric: str) -> Table:
    """Tabulate the ranking of models with the range of ranks consistent with the tests, from
    `analysis.uncertainty.standings`."""
    lines = tuple(
        Line.of(plain(row["model"]), (f"{row['value']:.2f}", str(row["rank"]), _range(row["best"], row["worst"])))
        for row in standings.iter_rows(named=True)
    )
    remark = (
        "possible ranks: ranks consistent with the significant differences from the other models (paired tests, "
        "corrected for all pairs); models whose ranges overlap may be tied."
    )
    columns = (Column(metric_label(metric)), Column("rank"), Column("possible ranks"))
    section = Section(f"Average {METRIC_LABELS[metric]}", lines)
    return Table("standings", "Ranking", columns, (section,), (remark,))


def variance_table(split: pl.DataFrame, metric: str, name: str, remark: str = "") -> Table:
    """Tabulate the variance of one model's score by source, from `analysis.uncertainty.variance_split`; `remark`
    describes omitted data."""
    lines = tuple(
        Line.of(
            row["source"],
            (
                str(row["levels"]),
                f"{row['deviation']:.3f}",
                f"{row['share']:.1f}",
                number_text(row["error_of_mean"], 3),
            ),
        )
        for row in split.iter_rows(named=True)
    )
    columns = (Column("levels"), Column("deviation (px)"), Column("share %"), Column("error of the mean (px)"))
    about = (
        "deviation: standard deviation of the score of one image, averaged over corruptions; error of the mean: "
        "contribution of the source to the standard error of the mean over all images and seeds. Severities are fixed "
        "by the protocol, not sampled."
    )
    title = f"Sources of variance in the {METRIC_LABELS[metric]} of {plain(name)}"
    return Table(
        "variance", title, columns, (Section(METRIC_LABELS[metric], lines),), _remarks(about, remark), "Source"
    )


def power_table(plan: pl.DataFrame, power: float, level: float) -> Table:
    """Tabulate the output of `analysis.uncertainty.power.plan_pairs`: one section per metric, one row per
    comparison."""
    effect = plan["effect"][0]
    now, then = ("detectable now (px)", "pairs now", "groups now"), f"for {effect:g} px"
    columns = tuple(map(Column, ("difference (px)", *now, f"power {then}", f"pairs {then}", "groups (interval)")))
    sections = []
    for metric in plan["metric"].unique(maintain_order=True):
        lines = tuple(
            Line.of(
                f"{plain(row['first'])} - {plain(row['second'])}",
                (
                    f"{row['difference']:+.3f}",
                    f"{row['detectable']:.3f}",
                    f"{row['images']:,}",
                    f"{row['clusters']:,}",
                    f"{100 * row['power']:.0f} %",
                    _count(row["images_needed"]),
                    "{} ({} to {})".format(*(_count(row[f"clusters_{name}"]) for name in ("needed", "low", "high"))),
                ),
            )
            for row in plan.filter(metric=metric).iter_rows(named=True)
        )
        sections.append(Section(f"Average {METRIC_LABELS[metric]}", lines))
    about = (
        f"detectable: the difference that a paired test at the {100 * (1 - level):g} % level detects with probability "
        f"{100 * power:g} %. A group is a drive or sequence, or a single pair without either. The numbers of "
        "pairs assume as many pairs per group as in these runs. All are estimated from the variance of these runs; the "
        f"{100 * level:g} % interval of the number of groups shows how uncertain that is, and is too short if a few "
        "groups dominate the difference."
    )
    return Table("power", "Pairs required for a comparison", columns, tuple(sections), (about,), "Comparison")


def _count(number: int | None) -> str:
    return "over 10^9" if number is None else f"{number:,}"


def _remarks(*remarks: str) -> tuple[str, ...]:
    return tuple(plain(remark, None) for remark in remarks if remark)


def _range(best: int, worst: int) -> str:
    return str(best) if best == worst else f"{best} to {worst}"
