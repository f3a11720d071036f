"""`robustflow reproduce`: repeat the paper's measurements, check its tables, and run the training experiment."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperGroup

from ..core.errors import UsageError
from .complete import stopped, terminate_as_on_ctrl_c
from .options import Corruptions, Data, Device, Limit, Severities, names, numbers
from .paper import audit, displacement, experiment, observations

if TYPE_CHECKING:
    from ..api import Result
    from ..paper.plan import Artefact, Missing, Runnable
    from ..report.table import Table

    Measured = tuple[Runnable, Result] | Missing


class _TableByDefault(TyperGroup):
    """`reproduce tab2` is short for `reproduce table tab2`."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        completing = ctx.resilient_parsing and not args
        if not completing and (not args or args[0] not in (*self.commands, *ctx.help_option_names)):
            args = ["table", *args]
        return super().parse_args(ctx, args)


app = typer.Typer(
    cls=_TableByDefault, help="Reproduce the paper: a table or figure (reproduce tab2), its audit, its experiments."
)
app.command()(audit)
app.command()(observations)
app.command()(displacement)
app.command()(experiment)


@app.command()
def table(
    what: Annotated[
        str | None, typer.Argument(metavar="TABLE", help="tab1 to tab8 or fig1 to fig9; by default, list them.")
    ] = None,
    data: Data = None,
    checkpoints: Annotated[
        list[Path] | None,
        typer.Option(
            "--checkpoints",
            help="Folder of checkpoints with the catalogue's file names, or names such as raft-ood.pth. Repeatable.",
        ),
    ] = None,
    models: Annotated[
        str | None, typer.Option("--models", help="Comma-separated names of models; all by default.")
    ] = None,
    random: Annotated[
        bool,
        typer.Option(
            "--random",
            help="Use random weights for missing checkpoints; the results are meaningless and only test the setup.",
        ),
    ] = False,
    limit: Limit = None,
    corruptions: Corruptions = None,
    severities: Severities = None,
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder for runs and results.")] = Path("reproduced"),
    device: Device = None,
    workers: Annotated[int | None, typer.Option("--workers", "-w", help="Number of processes, as for run.")] = None,
    batch_size: Annotated[int, typer.Option("--batch-size", help="As for run.")] = 1,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Print what can be run and what is missing, and exit.")
    ] = False,
    format: Annotated[
        str, typer.Option("--format", "-f", help="Table format, as for report, except page.")
    ] = "terminal",
) -> None:
    """Reproduce a table or figure of the paper next to the published values.

    Determines which of the paper's models can be run here, runs them or resumes their runs, and prints differences,
    missing items and where to get them. Without --data it shows the paper's values.

    \b
    Examples:
      robustflow reproduce
      robustflow reproduce tab2
      robustflow reproduce tab2 --checkpoints ~/ckpts --dry-run
      robustflow reproduce tab2 --data ~/kitti --checkpoints ~/ckpts --device cuda
      robustflow reproduce tab2 --data ~/kitti --models dis,raft --random --limit 1 --corruptions fog,snow
      robustflow reproduce fig4 --data ~/kitti --checkpoints ~/ckpts --output reproduced
    """
    from ..core.files import make_folder
    from ..paper.plan import (
        artefact_of,
        choose,
        contents,
        data_hint,
        paper_variants,
        plan_table,
        summary_sentence,
        weights_in,
    )
    from ..paper.side_by_side import comparison_table, paper_alone
    from ..report.render import renderer

    renderer(format)
    if what is None:
        typer.echo("\n".join(contents()))
        return
    artefact = artefact_of(what)
    if not artefact.benchmark:
        typer.echo(f"{artefact.name}: {artefact.title}. It does not compare models. Instead: {artefact.instead}")
        return
    variants = paper_variants(artefact.benchmark, names(models))
    choices = choose(variants, artefact.benchmark, weights_in(checkpoints or []), random=random)
    if data is None or dry_run:
        published = [paper_alone(artefact, variant) for variant in variants]
        _print(plan_table(artefact, choices) if dry_run else comparison_table(artefact, published), format)
        typer.echo(summary_sentence(choices))
        if data is None:
            typer.echo(data_hint(artefact))
        if artefact.table and artefact.instead:
            typer.echo(f"See also: {artefact.instead}")
        return
    if not data.exists():
        raise UsageError(f"--data {data}: no such file or folder. {data_hint(artefact)}")
    part: dict[str, Any] = {"limit": limit, "corruptions": names(corruptions), "severities": numbers(severities)}
    _check_part(artefact, data, part)
    make_folder(output)
    options = {"data": data, "workers": workers, "batch_size": batch_size, **part}
    measured = _measured(artefact, choices, output, device, options)
    _show(artefact, measured, output, format)


def _check_part(artefact: "Artefact", data: Path, part: dict[str, Any]) -> None:
    """Raise if no variant could run on the data, or if the paper has no values to compare with."""
    from warnings import catch_warnings, simplefilter

    from ..data.benchmarks import load_benchmark

    with catch_warnings():
        simplefilter("ignore")  # every run repeats them
        chosen = load_benchmark(artefact.benchmark, data).narrowed(**part)
    published = chosen.facts.paper_corruptions
    if others := [name for name in chosen.corruptions if name not in published]:
        raise UsageError(
            f"the paper has no values for {', '.join(others)} on {chosen.name}; choose from {', '.join(published)}"
        )


def _measured(
    artefact: "Artefact",
    choices: "list[Runnable | Missing]",
    output: Path,
    device: str | None,
    options: dict[str, Any],
) -> "list[Measured]":
    from ..paper.measure import measure_variants
    from ..run.progress import TerminalProgress

    terminate_as_on_ctrl_c()
    progress, measured = TerminalProgress(), []
    try:
        with progress:
            for each in measure_variants(artefact, choices, output, device, progress=progress, **options):
                measured.append(each)
    except KeyboardInterrupt:
        raise stopped(f"{progress.finished_work()} Run the same command again") from None
    return measured


def _show(artefact: "Artefact", measured: "list[Measured]", output: Path, format: str) -> None:
    """Print the new values next to the published ones, then what was not run. Write everything to a file and, if a
    figure was requested, draw it."""
    from ..core.files import write_bytes
    from ..paper.plan import Missing, plan_table, summary_sentence
    from ..paper.side_by_side import comparison_csv, comparison_table, paper_alone, run_beside_paper

    missing = [each for each in measured if isinstance(each, Missing)]
    ran = [each for each in measured if not isinstance(each, Missing)]
    variants = [
        paper_alone(artefact, each.variant) if isinstance(each, Missing) else run_beside_paper(artefact, *each)
        for each in measured
    ]
    if ran:
        _print(comparison_table(artefact, [one for one in variants if one.here]), format)
    if missing:
        _print(plan_table(artefact, missing), format)
    typer.echo(summary_sentence([each if isinstance(each, Missing) else each[0] for each in measured]))
    written = output / f"{artefact.name}.csv"
    write_bytes(written, comparison_csv(artefact, variants).encode())
    typer.echo(f"all values: {written}")
    if artefact.table and artefact.instead:
        typer.echo(f"See also: {artefact.instead}")
    if artefact.figure and ran:
        for path in _draw(artefact, list({run.path: run for _, run in ran}.values()), output):
            typer.echo(str(path))
    if not ran and any(each.failed for each in missing):
        raise typer.Exit(1)


def _draw(artefact: "Artefact", runs: "list[Result]", output: Path) -> list[Path]:
    """Draw the figure of the published values and the figure of the runs."""
    from ..report.assemble import figures_of
    from ..report.figures import write_figures

    drawn = figures_of(runs, published=True)
    matching = {name: figure for name, figure in drawn.items() if name.startswith(artefact.figure)}
    return write_figures(matching, output / "figures", ("png", "svg"))


def _print(table: "Table", format: str) -> None:
    from .tables import as_text

    typer.echo(as_text(table, format, None), nl=False)
