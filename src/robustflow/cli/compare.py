"""`robustflow compare`: is one model really better than another?"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def compare(
    runs: Annotated[
        list[Path], typer.Argument(metavar="RUN_A RUN_B...", help="Folders or records of runs over the same data.")
    ],
    metric: Annotated[str | None, typer.Option("--metric", help="epe, cre, crer or rcre alone.")] = None,
    level: Annotated[float, typer.Option(help="Of the confidence intervals.")] = 0.95,
    resamples: Annotated[int, typer.Option(help="Of the bootstrap.")] = 4999,
    seed: Annotated[int, typer.Option(help="Of the bootstrap.")] = 0,
    as_json: Annotated[bool, typer.Option("--json", help="Print the comparison as JSON.")] = False,
) -> None:
    """Say whether models differ, image by image, with intervals and corrected p-values.

    Two runs are compared in every metric, on average and under each corruption; more than two pairwise in one metric
    (CRE by default).

    \b
    Examples:
      robustflow compare runs/a runs/b
      robustflow compare runs/a runs/b runs/c --metric rcre
    """
    from ..errors import UsageError, unknown_name
    from ..report.load import load_run
    from ..report.runs import run_names
    from ..report.text import plain
    from ..report.uncertainty import compare as compare_two
    from ..report.uncertainty import compare_all
    from ..report.uncertainty.sums import METRICS

    if metric is not None and metric not in METRICS:
        raise unknown_name("metric", metric, METRICS)
    if len(runs) < 2:
        raise UsageError("one run cannot be compared: name two or more")
    found = [load_run(run) for run in runs]
    rows = dict(zip(run_names(found), (run.rows for run in found), strict=True))
    if len(found) == 2:
        (first, a), (second, b) = rows.items()
        table = compare_two(a, b, (first, second), level=level, resamples=resamples, seed=seed)
        table = table if metric is None else table.filter(metric=metric)
    else:
        table = compare_all(rows, metric or "cre", level=level, resamples=resamples, seed=seed)
    if as_json:
        typer.echo(table.write_json())
        return
    for sentence in table["sentence"]:
        typer.echo(plain(sentence, None))
