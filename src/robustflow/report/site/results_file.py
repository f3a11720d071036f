"""Results as the file that `robustflow leaderboard`, `audit` and `read_results` take again."""

from __future__ import annotations

import csv
import io

import polars as pl

from ..render.csv import text_cell

_TEXTS = ("benchmark", "setting", "model", "metric", "corruption", "source", "sample_set", "note")


def results_csv(results: pl.DataFrame) -> str:
    """Results (columns of `results.RESULT_SCHEMA`) as CSV, each value with the digits that are known of it.

    >>> from robustflow.report.results import parse_results
    >>> text = "setting,model,metric,corruption,value\\nOOD,Mine,epe,clean,4.20\\n"
    >>> print(results_csv(parse_results(text, "mine.csv", "mine")).splitlines()[1])
    kitti-fc,OOD,Mine,epe,clean,,mine,,4.20,
    """
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow([*_TEXTS, "value", "marked"])
    for row in results.iter_rows(named=True):
        value = repr(row["value"]) if row["decimals"] is None else f"{row['value']:.{row['decimals']}f}"
        marked = {None: "", True: "yes", False: "no"}[row["marked"]]
        writer.writerow([*(text_cell(row[name]) for name in _TEXTS), value, marked])
    return out.getvalue()
