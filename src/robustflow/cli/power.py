"""`robustflow power`: estimate how many pairs a comparison needs."""

from typing import Annotated

import typer

from .options import ComparedRuns, Format, OutputFile


def power(
    runs: ComparedRuns,
    effect: Annotated[float, typer.Option("--effect", help="Difference to detect, in pixels.")] = 0.1,
    power: Annotated[float, typer.Option("--power", help="Probability of detecting it.")] = 0.8,
    level: Annotated[float, typer.Option(help="Confidence level of the test (1 minus the significance level).")] = 0.95,
    format: Format = "terminal",
    output: OutputFile = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the plan as JSON.")] = False,
) -> None:
    """Estimate how many pairs are needed to detect a difference between models, from the variances of existing runs.

    If pairs come from drives or sequences, the number of drives matters most, because more frames of the same drive add
    little information. The estimates assume that pairs are spread over drives as in these runs.

    \b
    Examples:
      robustflow power runs/a runs/b
      robustflow power runs/a runs/b --effect 0.05 --power 0.9
    """
    from ..analysis.run_names import named_runs
    from ..analysis.uncertainty.power import plan_pairs
    from ..records.load import load_any_run
    from ..report.standings_tables import power_table
    from .tables import as_text, check_format, write_text

    check_format(format, as_json)
    loaded = [load_any_run(run) for run in runs]
    rows = {name: run.rows for name, run in named_runs(loaded).items()}
    plan = plan_pairs(rows, effect, power=power, level=level)
    text = plan.write_json() + "\n" if as_json else as_text(power_table(plan, power, level), format, output)
    write_text(text, output)
