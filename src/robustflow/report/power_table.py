"""Table of the number of pairs required for a comparison."""

from __future__ import annotations

import polars as pl

from ..analysis.labels import METRIC_LABELS
from ..text import plain
from .table import Column, Line, Section, Table


def power_table(plan: pl.DataFrame, power: float, level: float) -> Table:
    """Tabulate the output of `analysis.uncertainty.power.plan_pairs`: one section per metric, one row per
    comparison."""
    effect = plan["effect"][0]
    now, then = ("detectable now (px)", "pairs now", "groups now"), f"for {effect:g} px"
    columns = tuple(map(Column, ("difference (px)", *now, f"power {then}", f"pairs {then}", "groups")))
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
                    _count(row["clusters_needed"]),
                ),
            )
            for row in plan.filter(metric=metric).iter_rows(named=True)
        )
        sections.append(Section(f"Average {METRIC_LABELS[metric]}", lines))
    about = (
        f"detectable: the difference that a paired test at the {100 * (1 - level):g} % level detects with probability "
        f"{100 * power:g} %. A group is a drive or sequence, or a single pair that belongs to none. The numbers of "
        "pairs assume as many pairs per group as in these runs. They are estimated from the variance of these runs and "
        "can be far off with few groups."
    )
    return Table("power", "Pairs required for a comparison", columns, tuple(sections), (about,), "Comparison")


def _count(number: int | None) -> str:
    return "over 10^9" if number is None else f"{number:,}"
