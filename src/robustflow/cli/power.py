"""`robustflow power`: how many pairs does a comparison need?"""

from typing import Annotated

import typer

from .options import ComparedRuns, Format, OutputFile


def power(
    runs: ComparedRuns,
    effect: Annotated[float, typer.Option("--effect", help="The difference that has to be found, in pixels.")] = 0.1,
    power: Annotated[float, typer.Option("--power", help="The probability of finding it.")] = 0.8,
    level: Annotated[float, typer.Option(help="1 minus the significance of the test.")] = 0.95,
    format: Format = "terminal",
    output: OutputFile = None,
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
    from ..records.load import load_any_run
    from ..report.power_table import power_table
    from .tables import as_text, check_format, write_text

    check_format(format, as_json)
    loaded = [load_any_run(run) for run in runs]
    rows = {name: run.rows for name, run in zip(run_names(loaded), loaded, strict=True)}
    plan = plan_pairs(rows, effect, power=power, level=level)
    text = plan.write_json() + "\n" if as_json else as_text(power_table(plan, power, level), format, output)
    write_text(text, output)
