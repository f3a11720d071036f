"""`robustflow reproduce experiment`: train networks with and without corruptions."""

from pathlib import Path
from typing import Annotated

import typer

from .options import numbers


def experiment(
    output: Annotated[Path, typer.Option("--output", "-o", help="The experiment's folder.")] = Path("robust-training"),
    data: Annotated[
        list[str] | None,
        typer.Option("--data", "-d", help="NAME=FOLDER of real pairs for additional evaluation. Repeatable."),
    ] = None,
    seeds: Annotated[
        int, typer.Option(min=1, help="Number of seeds, with one training run of each kind per seed.")
    ] = 6,
    steps: Annotated[int | None, typer.Option(min=1, help="Steps per training run, instead of the recipe's.")] = None,
    severities: Annotated[str, typer.Option(help="Severities for evaluation, e.g. 1,3,5.")] = "3",
    shapes: Annotated[int, typer.Option(min=1, help="Number of held-out pairs of flying shapes.")] = 150,
    size: Annotated[str, typer.Option(help="Their size, HEIGHTxWIDTH.")] = "160x224",
    loaders: Annotated[int, typer.Option(min=0, help="Processes that prepare batches in advance.")] = 1,
) -> None:
    """Test whether training with corruptions helps against unseen corruptions, holding out noise, then weather.

    Trains `tiny` from several random initialisations; continues each without corruptions, with all of them, and with
    all but noise or weather; and evaluates every network on unseen pairs. Ctrl-C stops the experiment; run the same
    command again to resume. Commands running in several terminals share the work.

    \b
    Examples:
      robustflow reproduce experiment
      robustflow reproduce experiment --data middlebury=~/middlebury --seeds 10
    """
    from ..extras import require

    require("torch", "training")
    from ..atomic import write_bytes
    from ..experiments.findings import findings
    from ..experiments.robust_training import TrainingExperiment, evaluation_sets, run_experiment
    from .interrupt import Interrupted, stopped

    asked = TrainingExperiment(
        output,
        evaluation_sets(data or [], shapes, size),
        seeds=seeds,
        steps=steps,
        severities=tuple(numbers(severities) or ()),
        loaders=loaders,
    )
    stop = Interrupted()
    runs = run_experiment(asked, lambda text: typer.echo(f"robustflow: {text}", err=True), stop)
    if runs is None:
        raise stopped(f"{asked.output} is kept. Run the same command again")
    text, table = findings(runs)
    write_bytes(asked.output / "effects.csv", table.write_csv().encode())
    write_bytes(asked.output / "findings.md", text.encode())
    typer.echo(text)
