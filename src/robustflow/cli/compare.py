"""`robustflow compare`: test whether models differ significantly, or estimate how many pairs that takes."""

from pathlib import Path
from typing import Annotated, Any

import typer
from typer import Argument, Option

from ..core.errors import RunError, UsageError, unknown_name
from .options import refuse_unused, shared


@shared(
    "format",
    output="File to write, instead of printing.",
    as_json="Print the comparison as JSON.",
)
def compare(
    context: typer.Context,
    runs: Annotated[list[Path], Argument(metavar="RUN", help="Folders or records of runs on the same data.")],
    metric: Annotated[str | None, Option(help="Compare only this metric: epe, cre, crer, rcre, fl, px1, ...")] = None,
    effect: Annotated[float | None, Option(help="Estimate how many pairs detect so many pixels.")] = None,
    power: Annotated[float, Option(help="With --effect: probability of detecting it.")] = 0.8,
    **given: Any,
) -> None:
    """Test whether models differ, paired by image, with intervals and corrected p-values.

    Two runs are compared in one table: overall in every metric, and under each corruption in one metric (EPE by
    default, RCRE without ground truth). More than two runs are ranked within their settings, each with its range of
    possible ranks (not in CSV), and compared pairwise by the average of one metric. For runs of one model with several
    seeds, the variance is split into the contributions of images, seeds and severities.

    With --effect, no test is made: the number of pairs that one needs is estimated by simulating the test.

    \b
    Examples:
      robustflow compare runs/a runs/b runs/c --metric rcre
      robustflow compare runs/a runs/b --format latex -o comparison.tex
      robustflow compare runs/a runs/b --effect 0.05 --power 0.9
    """
    from ..metrics.cube import AVERAGE
    from ..metrics.measures import MEASURES
    from ..report.comparison import (
        BESIDE_RCRE,
        pairs_table,
        power_table,
        ranked_in_settings,
        unranked_words,
        variance_table,
    )
    from ..report.comparison import compare as compare_two
    from ..run.comparable import common_to, named_runs
    from ..run.records.pack import load_any_run
    from ..stats.estimate import contrast, cubes_of
    from ..stats.power import plan_pairs
    from ..stats.seeds import seeds_of
    from ..stats.variance import variance_split
    from .tables import as_text, check_format, write_text

    format = given["format"]
    if metric is not None and metric not in MEASURES:
        raise unknown_name("metric", metric, MEASURES)
    check_format(format, given["as_json"])
    if effect is None:
        refuse_unused(context, ("power",), "without --effect")
    if len(runs) < 2:
        raise UsageError("RUN", "a comparison needs two or more runs")
    loaded = [load_any_run(run) for run in runs]
    chosen = metric or ("rcre" if any(run.epe is None for run in loaded) else "epe")
    tables = []
    if effect is not None:
        refuse_unused(context, ("metric",), "with --effect")
        rows = {name: run.rows for name, run in named_runs(loaded).items()}
        frame = plan_pairs(rows, effect, power=power)
        tables.append(power_table(frame, power))
    elif (by_seed := seeds_of(loaded)) is not None:
        frame = variance_split(by_seed.rows, chosen)
        tables.append(variance_table(frame, chosen, loaded[0].name, by_seed.remark))
    elif len(loaded) == 2:
        comparison = compare_two(*loaded)
        frame = comparison.frame if metric is None else comparison.of(metric)
        tables.append(comparison.table(metric or ""))
    else:
        named = named_runs(loaded)
        common = common_to(named)
        if any(run.mean(chosen) is None for run in loaded):
            raise RunError("--metric", f"not all of these runs have an average of {chosen}; choose a different one")
        measures = {chosen: MEASURES[chosen]} | (BESIDE_RCRE if chosen == "rcre" else {})
        frame = contrast(cubes_of(common.rows), measures, [(AVERAGE, None)])
        ranking, verdicts = ranked_in_settings(named, common.rows, chosen)
        tables += [] if format == "csv" else ranking  # a CSV file contains a single table
        remarks = filter(None, [common.remark, *verdicts, unranked_words(named)])
        tables.append(pairs_table(frame, " ".join(remarks)))
    if given["as_json"]:
        text = frame.write_json() + "\n"
    else:
        text = "\n".join(as_text(table, format, given["output"]) for table in tables)
    write_text(text, given["output"])
