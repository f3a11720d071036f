"""`robustflow compare`: test whether models differ significantly, or estimate how many pairs that takes."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .options import Format, refuse_unused

if TYPE_CHECKING:
    import polars as pl


_OF_TESTS = ("level", "resamples", "seed")


def compare(
    context: typer.Context,
    runs: Annotated[list[Path], typer.Argument(metavar="RUN", help="Folders or records of runs on the same data.")],
    metric: Annotated[
        str | None, typer.Option("--metric", help="Compare only this metric: epe, cre, crer or rcre.")
    ] = None,
    effect: Annotated[
        float | None,
        typer.Option("--effect", help="Estimate how many pairs a test needs to detect this difference, in pixels."),
    ] = None,
    power: Annotated[float, typer.Option("--power", help="With --effect: probability of detecting it.")] = 0.8,
    level: Annotated[float, typer.Option(help="Confidence level of the intervals.")] = 0.95,
    resamples: Annotated[int, typer.Option(help="Number of bootstrap resamples.")] = 4999,
    seed: Annotated[int, typer.Option(help="Random seed of the bootstrap.")] = 0,
    format: Format = "terminal",
    output: Annotated[Path | None, typer.Option("--output", "-o", help="File to write, instead of printing.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the comparison as JSON.")] = False,
) -> None:
    """Test whether models differ, paired by image, with intervals and corrected p-values.

    Two runs are compared in one table: overall in every metric, and under each corruption in one metric (EPE by
    default, RCRE without ground truth). Bold marks a significantly lower EPE. More than two runs are ranked, each with
    its range of possible ranks (not in CSV, which contains a single table), and compared pairwise by the average of one
    metric: one sentence per pair on the terminal, one line per pair in other formats.

    For runs of one model with several seeds, the variance is split into the contributions of images, seeds and
    severities.

    With --effect, no test is made: the number of pairs that one needs is estimated from the variances of the runs. If
    pairs come from drives or sequences, the number of drives matters most, because more frames of the same drive add
    little information. The estimates assume that pairs are spread over drives as in these runs.

    \b
    Examples:
      robustflow compare runs/a runs/b
      robustflow compare runs/a runs/b runs/c --metric rcre
      robustflow compare runs/a runs/b --format latex -o comparison.tex
      robustflow compare runs/a runs/b --effect 0.05 --power 0.9
    """
    import polars as pl

    from ..core.errors import RunError, UsageError, unknown_name
    from ..core.text import plain
    from ..report.comparison import compare as compare_two
    from ..report.comparison import pairs_table
    from ..report.standings_tables import power_table, standings_table, variance_table
    from ..run.comparable import common_to
    from ..run.records.pack import load_any_run
    from ..stats.conditions import seeds_of
    from ..stats.model_result import not_ranked
    from ..stats.results import METRIC_LABELS
    from ..stats.run_results import named_runs, run_results
    from ..stats.uncertainty import compare_all, standings, variance_split
    from ..stats.uncertainty.power import plan_pairs
    from ..stats.uncertainty.sums import INTERVAL_METRICS
    from .tables import as_text, check_format, write_text

    if metric is not None and metric not in INTERVAL_METRICS:
        raise unknown_name("metric", metric, INTERVAL_METRICS)
    check_format(format, as_json)
    if effect is None:
        refuse_unused(context, ("power",), "without --effect")
    if len(runs) < 2:
        raise UsageError("a comparison needs two or more runs")
    loaded = [load_any_run(run) for run in runs]
    chosen = metric or ("rcre" if any(run.epe is None for run in loaded) else "epe")
    tables, sentences = [], []
    if effect is not None:
        refuse_unused(context, ("metric", "resamples", "seed"), "with --effect")
        frame = plan_pairs(
            {name: run.rows for name, run in named_runs(loaded).items()}, effect, power=power, level=level
        )
        tables.append(power_table(frame, power, level))
    elif (by_seed := seeds_of(loaded)) is not None:
        refuse_unused(context, _OF_TESTS, "for one model with several seeds, which needs no test")
        frame = variance_split(by_seed.rows, chosen)
        tables.append(variance_table(frame, chosen, loaded[0].name, by_seed.remark))
    elif len(loaded) == 2:
        comparison = compare_two(*loaded, level=level, resamples=resamples, seed=seed)
        frame = comparison.frame if metric is None else comparison.frame.filter(metric=metric)
        tables.append(comparison.table(metric or ""))
    else:
        lines = run_results(loaded)
        common = common_to(dict(zip((line.name for line in lines), loaded, strict=True)))
        frame = compare_all(common.rows, chosen, level=level, resamples=resamples, seed=seed)
        if frame.is_empty():
            label = METRIC_LABELS[chosen]
            raise RunError(
                f"no two of these runs have comparable {label} averages; compare two runs, or choose a different "
                "--metric"
            )
        ranked = [line.name for line in lines if not line.excluded]
        sound = frame.filter(pl.col("first").is_in(ranked) & pl.col("second").is_in(ranked))
        if format != "csv" and _every_pair(sound, ranked):  # a CSV file contains a single table
            tables.append(standings_table(standings(sound, ranked), chosen))
        unranked = [f"Not ranked: {reason}." for reason in not_ranked(lines)]
        notes = [note for note in (common.remark, *unranked) if note]
        if format == "terminal":
            sentences = [*frame["sentence"], *([" ".join(notes)] if notes else [])]
        else:
            tables.append(pairs_table(frame, " ".join(notes)))
    if as_json:
        text = frame.write_json() + "\n"
    else:
        text = "\n".join(as_text(table, format, output) for table in tables)
        text += "".join(f"{plain(sentence, None)}\n" for sentence in sentences)
    write_text(text, output)


def _every_pair(table: "pl.DataFrame", names: list[str]) -> bool:
    return len(names) > 1 and table.height == len(names) * (len(names) - 1) // 2
