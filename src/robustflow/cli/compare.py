"""`robustflow compare`: is one model really better than another?"""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    import polars as pl


def compare(
    runs: Annotated[
        list[Path], typer.Argument(metavar="RUN_A RUN_B...", help="Folders or records of runs over the same data.")
    ],
    metric: Annotated[
        str | None, typer.Option("--metric", help="Compare only this metric: epe, cre, crer or rcre.")
    ] = None,
    level: Annotated[float, typer.Option(help="Level of the confidence intervals.")] = 0.95,
    resamples: Annotated[int, typer.Option(help="Resamples of the bootstrap.")] = 4999,
    seed: Annotated[int, typer.Option(help="Seed of the bootstrap.")] = 0,
    format: Annotated[
        str, typer.Option("--format", "-f", help="terminal, markdown, latex, csv, html, or MODULE:FUNCTION.")
    ] = "terminal",
    output: Annotated[Path | None, typer.Option("--output", "-o", help="File to write, instead of printing.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the comparison as JSON.")] = False,
) -> None:
    """Say whether models differ, image by image, with intervals and corrected p-values.

    Two runs are compared in a table: overall in every metric, and under each corruption in one (CRE by default, RCRE
    without ground truth); bold marks a value that is significantly lower. More than two are ranked, with the range of
    ranks that the tests allow for each (not in CSV, which holds a single table), and compared pairwise in the average
    of one metric: one sentence per pair on the terminal, one line per pair in the other formats.

    For runs of one model with several seeds, the spread is split into the shares of images, seeds and severities; runs
    of several models under several conditions (seed, split, variant, ...) show how the order of the models changes.

    \b
    Examples:
      robustflow compare runs/a runs/b
      robustflow compare runs/a runs/b runs/c --metric rcre
      robustflow compare runs/a runs/b --format latex -o comparison.tex
    """
    import polars as pl

    from ..analysis.conditions import orders, seeds_of
    from ..analysis.labels import METRIC_LABELS
    from ..analysis.model_result import not_ranked
    from ..analysis.run_results import run_results
    from ..analysis.uncertainty import compare_all, rank_stability, standings, variance_split
    from ..analysis.uncertainty.sums import INTERVAL_METRICS
    from ..atomic import write_bytes
    from ..errors import RunError, UsageError, unknown_name
    from ..records.load import load_any_run
    from ..report.comparison import compare as compare_two
    from ..report.comparison import pairs_table
    from ..report.render import render, renderer
    from ..report.standings_tables import stability_table, standings_table, variance_table
    from ..runs.comparable import common_to
    from ..text import plain
    from .tables import for_stdout

    if metric is not None and metric not in INTERVAL_METRICS:
        raise unknown_name("metric", metric, INTERVAL_METRICS)
    renderer(format)  # refuse an unknown format before reading anything
    if as_json and format != "terminal":
        raise UsageError(f"--json and --format {format} exclude each other; leave out one of them")
    if len(runs) < 2:
        raise UsageError("one run cannot be compared: name two or more")
    loaded = [load_any_run(run) for run in runs]
    chosen = metric or ("rcre" if any(run.cre is None for run in loaded) else "cre")
    across = None
    if (by_seed := seeds_of(loaded)) is not None:
        frame = variance_split(by_seed.rows, chosen)
        across = frame, variance_table(frame, chosen, loaded[0].name, by_seed.remark)
    elif (order := orders(loaded, chosen)) is not None:
        frame = rank_stability(order.scores)
        across = frame, stability_table(frame, chosen, order.remark)
    if across is not None:
        frame, shown = across
        text = frame.write_json() + "\n" if as_json else render(shown, format)
        if output is None:
            typer.echo(text, nl=False)
        else:
            write_bytes(output, text.encode())
            typer.echo(str(output))
        return
    if len(loaded) == 2:
        comparison = compare_two(*loaded, level=level, resamples=resamples, seed=seed)
        table = comparison.frame if metric is None else comparison.frame.filter(metric=metric)
    else:
        lines = run_results(loaded)
        common = common_to(dict(zip((line.name for line in lines), loaded, strict=True)))
        rows, note = common.rows, common.remark
        table = compare_all(rows, chosen, level=level, resamples=resamples, seed=seed)
        if table.is_empty():
            label = METRIC_LABELS[chosen]
            raise RunError(f"no two of these runs have an average {label} in common; compare two, or another --metric")
        ranked = [line.name for line in lines if not line.excluded]
        sound = table.filter(pl.col("first").is_in(ranked) & pl.col("second").is_in(ranked))
        note = " ".join(filter(None, [note, *not_ranked(lines)]))
    on_screen = format == "terminal" and output is None
    if as_json:
        text = table.write_json() + "\n"
    elif len(loaded) == 2:
        shown = comparison.table(metric or "")
        text = for_stdout(shown) if on_screen else render(shown, format)
    elif format == "terminal":
        ranking = for_stdout(standings_table(standings(sound, ranked), chosen)) if _every_pair(sound, ranked) else ""
        sentences = (*table["sentence"], *filter(None, [note]))
        text = ranking + "".join(f"{plain(sentence, None)}\n" for sentence in sentences)
    else:
        shown_tables = [pairs_table(table, note)]
        if format != "csv" and _every_pair(sound, ranked):  # a CSV file holds a single table
            shown_tables.insert(0, standings_table(standings(sound, ranked), chosen))
        text = "\n".join(render(one, format) for one in shown_tables)
    if output is None:
        typer.echo(text, nl=False)
    else:
        write_bytes(output, text.encode())
        typer.echo(str(output))


def _every_pair(table: "pl.DataFrame", names: list[str]) -> bool:
    return len(names) > 1 and table.height == len(names) * (len(names) - 1) // 2
