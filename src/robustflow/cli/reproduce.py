"""`robustflow reproduce`: repeat the paper's measurements, and check its tables."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Argument, Option
from typer.core import TyperGroup

from ..core.errors import UsageError
from ..core.files import make_folder, write_bytes
from ..core.output import echo
from .interrupt import stopped, terminate_as_on_ctrl_c
from .options import names, run_arguments, shared
from .paper import audit, displacement, observations

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


app = typer.Typer(cls=_TableByDefault)
app.command()(audit)
app.command()(observations)
app.command()(displacement)


@app.command()
@shared(
    *("data", "limit", "corruptions", "severities", "device", "workers", "batch_size", "format"),
    output="Folder for runs and results; 'reproduced' by default.",
)
def table(
    what: Annotated[str | None, Argument(metavar="TABLE", help="tab1 to tab8 or fig1 to fig9; or list them.")] = None,
    checkpoints: Annotated[
        list[Path] | None,
        Option(
            help="Folder of checkpoints with the catalogue's file names, or names such as raft-ood.pth. Repeatable."
        ),
    ] = None,
    models: Annotated[str | None, Option(help="Comma-separated names of models; all by default.")] = None,
    random: Annotated[bool, Option("--random", help="Random weights for missing checkpoints, as a test.")] = False,
    dry_run: Annotated[bool, Option("--dry-run", help="Print what can be run and what is missing, and exit.")] = False,
    **given: Any,
) -> None:
    """Reproduce a table or figure of the paper next to the published values.

    Determines which of the paper's models can be run here, runs them or resumes their runs, and prints differences,
    missing items and where to get them. Without --data it shows the paper's values.

    \b
    Examples:
      robustflow reproduce
      robustflow reproduce tab2 --checkpoints ~/ckpts --dry-run
      robustflow reproduce tab2 --data ~/kitti --checkpoints ~/ckpts --device cuda
      robustflow reproduce tab2 --data ~/kitti --models dis,raft --random --limit 1 --corruptions fog,snow
    """
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

    data, format, output = given["data"], given["format"], given["output"] or Path("reproduced")
    renderer(format)
    if what is None:
        echo("\n".join(contents()))
        return
    artefact = artefact_of(what)
    if not artefact.benchmark:
        echo(f"{artefact.name}: {artefact.title}. It does not compare models. Instead: {artefact.instead}")
        return
    variants = paper_variants(artefact.benchmark, names(models))
    choices = choose(variants, artefact.benchmark, weights_in(checkpoints or []), random=random)
    if data is None or dry_run:
        published = [paper_alone(artefact, variant) for variant in variants]
        _print(plan_table(artefact, choices) if dry_run else comparison_table(artefact, published), format)
        echo(summary_sentence(choices))
        if data is None:
            echo(data_hint(artefact))
        if artefact.table and artefact.instead:
            echo(f"See also: {artefact.instead}")
        return
    if not data.exists():
        raise UsageError("--data", f"{data}: no such file or folder. {data_hint(artefact)}")
    arguments = run_arguments(given)
    part = {name: arguments[name] for name in ("limit", "corruptions", "severities")}
    _check_part(artefact, data, part)
    make_folder(output)
    options = {name: given[name] for name in ("data", "workers", "batch_size")} | part
    _show(artefact, _measured(artefact, choices, output, given["device"], options), output, format)


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
            others[0], f"the paper has no values for it on {chosen.name}; choose from {', '.join(published)}"
        )


def _measured(
    artefact: "Artefact", choices: "list[Runnable | Missing]", output: Path, device: str | None, options: dict[str, Any]
) -> "list[Measured]":
    from ..paper.measure import measure_variants
    from ..run.progress import TerminalProgress

    terminate_as_on_ctrl_c()
    progress = TerminalProgress()
    try:
        with progress:
            return list(measure_variants(artefact, choices, output, device, progress=progress, **options))
    except KeyboardInterrupt:
        raise stopped(f"{progress.finished_work()} Run the same command again") from None


def _show(artefact: "Artefact", measured: "list[Measured]", output: Path, format: str) -> None:
    """Print the new values next to the published ones, then what was not run. Write everything to a file and, if a
    figure was requested, draw it."""
    from ..paper.plan import Missing, plan_table, summary_sentence
    from ..paper.side_by_side import comparison_csv, comparison_table, paper_alone, run_beside_paper
    from ..report.figures import write_figures
    from ..report.tables import figures_of

    missing = [result for result in measured if isinstance(result, Missing)]
    ran = [result for result in measured if not isinstance(result, Missing)]
    variants = [
        paper_alone(artefact, result.variant) if isinstance(result, Missing) else run_beside_paper(artefact, *result)
        for result in measured
    ]
    if ran:
        _print(comparison_table(artefact, [variant for variant in variants if variant.here]), format)
    if missing:
        _print(plan_table(artefact, missing), format)
    echo(summary_sentence([result if isinstance(result, Missing) else result[0] for result in measured]))
    written = output / f"{artefact.name}.csv"
    write_bytes(written, comparison_csv(artefact, variants).encode())
    echo(f"all values: {written}")
    if artefact.table and artefact.instead:
        echo(f"See also: {artefact.instead}")
    if artefact.figure and ran:
        drawn = figures_of(list({run.path: run for _, run in ran}.values()), published=True)
        matching = {name: figure for name, figure in drawn.items() if name.startswith(artefact.figure)}
        for path in write_figures(matching, output / "figures", ("png", "svg")):
            echo(str(path))
    if not ran and any(variant.failed for variant in missing):
        raise typer.Exit(1)


def _print(table: "Table", format: str) -> None:
    from .tables import as_text

    echo(as_text(table, format, None), end="")
