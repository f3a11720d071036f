"""`robustflow power`: how many pairs does a comparison need?"""

from pathlib import Path
from typing import Annotated

import typer


def power(
    runs: Annotated[
        list[Path], typer.Argument(metavar="RUN_A RUN_B...", help="Folders or records of runs over the same data.")
    ],
    effect: Annotated[float, typer.Option("--effect", help="The difference that has to be found, in pixels.")] = 0.1,
    power: Annotated[float, typer.Option("--power", help="The probability of finding it.")] = 0.8,
    level: Annotated[float, typer.Option(help="1 minus the significance of the test.")] = 0.95,
    format: Annotated[
        str, typer.Option("--format", "-f", help="terminal, markdown, latex, csv, html, or MODULE:FUNCTION.")
    ] = "terminal",
    output: Annotated[Path | None, typer.Option("--output", "-o", help="File to write, instead of printing.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the plan as JSON.")] = False,
) -> None:
    """Say how many pairs detect a difference between models, from the variances of runs that exist.

    Where pairs come from drives or sequences, these are what counts: more frames of the same drive add little, so the
    numbers of pairs are of pairs spread over as many drives as here.

    \b
    Examples:
      robustflow power runs/a runs/b
      robustflow power runs/a runs/b --effect 0.05 --power 0.9
    """
    from ..analysis.run_names import run_names
    from ..analysis.uncertainty.power import plan_pairs
    from ..atomic import write_bytes
    from ..errors import UsageError
    from ..records.load import load_any_run
    from ..report.power_table import power_table
    from ..report.render import render, renderer
    from .tables import for_stdout

    renderer(format)  # refuse an unknown format before reading anything
    if as_json and format != "terminal":
        raise UsageError(f"--json and --format {format} exclude each other; leave out one of them")
    loaded = [load_any_run(run) for run in runs]
    rows = {name: run.rows for name, run in zip(run_names(loaded), loaded, strict=True)}
    plan = plan_pairs(rows, effect, power=power, level=level)
    table = power_table(plan, power, level)
    if as_json:
        text = plan.write_json() + "\n"
    elif format == "terminal" and output is None:
        text = for_stdout(table)
    else:
        text = render(table, format)
    if output is None:
        typer.echo(text, nl=False)
    else:
        write_bytes(output, text.encode())
        typer.echo(str(output))
