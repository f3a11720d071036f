"""Subcommands of `robustflow reproduce`: consistency of results, the paper's observations, and flow magnitudes in a
benchmark."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Argument, Option

from ..core.display import ProgressBar
from ..core.errors import UsageError
from ..core.files import make_folder, write_bytes
from ..core.output import echo
from ..core.text import counted, plain
from .options import data_options, keyword_options, refuse_unused, shared

if TYPE_CHECKING:
    from ..data.benchmarks import Benchmark
    from ..run.run import Run

FOUND = 3
"""Exit code for inconsistent results; 1 and 2 are errors, as for every command."""


@shared(as_json="Print the findings as JSON.")
def audit(
    source: Annotated[Path | None, Argument(metavar="FILE", help="Results (CSV); the paper's by default.")] = None,
    **given: Any,
) -> None:
    """List numbers that contradict the others by more than rounding, each with its printed and its recomputed value.

    Recomputes CRE from EPE, averages, CREr, ranks and highlighted best values; detects swapped or shifted rows.
    Exit codes: 0 if everything is consistent, 3 if not, 1 if the source cannot be read.

    \b
    Examples:
      robustflow reproduce audit
      robustflow reproduce audit results.csv --json
    """
    from ..stats.audit import AUDIT_CHECKS, audit_published, audit_results
    from ..stats.results_file import read_results

    audit = audit_published() if source is None else audit_results(read_results(source), str(source))
    if given["as_json"]:
        echo(audit.model_dump_json(indent=2))
    else:
        for check, count in audit.checked.items():
            findings = [finding for finding in audit.findings if finding.check == check]
            echo(f"{AUDIT_CHECKS[check]}: {len(findings)} of {count} are inconsistent")
            for finding in findings:
                where = f"{finding.source}: " if finding.source else ""
                echo(f"  {plain(where + finding.message, 400)}")
        if not audit.checked:
            echo("no number can be derived from the others, so nothing was checked")
        echo(f"{plain(audit.audited, 200)}: {counted(len(audit.findings), 'finding')}")
    if not audit.fits:
        raise typer.Exit(FOUND)


def observations() -> None:
    """Check the paper's ten observations: whether its tables agree, and whether the statements generalise.

    \b
    Example:
      robustflow reproduce observations
    """
    from ..paper.observations import observations_table
    from .tables import for_stdout

    echo(for_stdout(observations_table()), end="")


@shared(
    *("data", "data_options", "option", "limit", "split"),
    model="Model whose flow is measured; ground truth by default.",
    output="Output folder; 'displacement' unless --into is given.",
)
def displacement(
    context: typer.Context,
    benchmark: Annotated[str, Argument(metavar="BENCHMARK", help="kitti-fc, gopro-fc, demo, or any dataset.")],
    into: Annotated[Path | None, Option(metavar="RUN", help="Also store it in a run on these frames.")] = None,
    **given: Any,
) -> None:
    """Write the histogram of flow magnitudes (a figure of the paper) to displacement.csv, .png, .svg and .pdf.

    Runs with ground truth store their histogram automatically unless --no-examples is given; use --into for frames
    without ground truth.

    \b
    Examples:
      robustflow reproduce displacement kitti-fc --data ~/kitti
      robustflow reproduce displacement gopro-fc --data ~/gopro-fc --model raft --into runs/gopro-fc_raft_1a2b3c4d
    """
    from ..data.benchmarks import load_benchmark
    from ..models import ModelRef
    from ..report.figures import displacement_figure, write_figures
    from ..report.site.page import write_report
    from ..run.displacement import clean_digests, displacement_histogram, displacement_label, write_displacement

    model, output = given["model"], given["output"]
    if model is None:
        refuse_unused(context, {"option"}, "without --model")
    opened = load_benchmark(benchmark, given["data"], given["split"], data_options(given))
    chosen = opened.narrowed(limit=given["limit"])
    run = None if into is None else _run_of(into, chosen)
    loaded = ModelRef.parse(model, keyword_options(given["option"])).load() if model is not None else None
    folder = output if output is not None or run is not None else Path("displacement")
    if folder is not None:
        make_folder(folder)
    with ProgressBar() as progress:
        progress.start("measuring", len(chosen.keys))
        table = displacement_histogram(
            chosen,
            loaded,
            source=model or "",
            progress=lambda done: progress.update("measuring", done),
            digests=None if run is None else clean_digests(run),
        )
    if folder is not None:
        write_bytes(folder / "displacement.csv", table.write_csv().encode())
        echo(str(folder / "displacement.csv"))
        label = displacement_label(chosen.name, len(chosen.keys), table["source"][0])
        for path in write_figures({"displacement": displacement_figure({label: table})}, folder):
            echo(str(path))
    if run is not None:
        echo(str(write_displacement(run, table)))
        write_report(run)


def _run_of(folder: Path, chosen: "Benchmark") -> "Run":
    from ..run.run import Run

    if folder.is_file():
        raise UsageError(folder, "a file; histograms can only be stored in a run's folder, not in a record")
    run = Run(folder)
    if run.benchmark != chosen.name or set(run.manifest.samples) != set(chosen.keys):
        raise UsageError(run.path, "a run on other frames; give its benchmark, --data, --split and --limit")
    return run
