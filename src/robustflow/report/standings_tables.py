"""Tables for several runs: a ranking with ties, the spread over seeds, and the order under different conditions."""

from __future__ import annotations

import polars as pl

from ..analysis.labels import METRIC_LABELS, metric_label
from ..text import plain
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


def stability_table(stability: pl.DataFrame, metric: str, remark: str = "") -> Table:
    """Tabulate the order of models under each condition, from `analysis.uncertainty.rank_stability`; `remark` describes
    omitted data."""
    sections = []
    for condition in stability["condition"].unique(maintain_order=True):
        rows = stability.filter(condition=condition)
        lines = tuple(
            Line.of(plain(row["model"]), (f"{row['value']:.2f}", str(row["rank"]), f"{row['moved']:+d}"))
            for row in rows.iter_rows(named=True)
        )
        sections.append(Section(f"{plain(condition)} (tau {rows['tau'][0]:.2f})", lines))
    columns = (Column(metric_label(metric)), Column("rank"), Column("moved"))
    about = (
        "moved: ranks lost relative to the first condition; tau: Kendall's tau between this order and the order "
        "under the first condition."
    )
    return Table("stability", "Order of the models", columns, tuple(sections), _remarks(about, remark))


def _remarks(*remarks: str) -> tuple[str, ...]:
    return tuple(plain(remark, None) for remark in remarks if remark)


def _range(best: int, worst: int) -> str:
    return str(best) if best == worst else f"{best} to {worst}"
