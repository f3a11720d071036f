"""`robustflow reproduce displacement`: distribution of flow magnitudes in a benchmark."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .options import Data, DataOptions, Limit, ModelOptions, Split, keyword_options, refuse_unused

if TYPE_CHECKING:
    from ..benchmarks import Benchmark
    from ..runs.run import Run


def displacement(
    context: typer.Context,
    benchmark: Annotated[str, typer.Argument(metavar="BENCHMARK", help="kitti-fc, gopro-fc, demo, or any dataset.")],
    data: Data = None,
    data_option: DataOptions = None,
    model: Annotated[
        str | None, typer.Option("--model", "-m", help="Model whose flow is measured; ground truth by default.")
    ] = None,
    option: ModelOptions = None,
    limit: Limit = None,
    split: Split = None,
    into: Annotated[
        Path | None,
        typer.Option("--into", metavar="RUN", help="Also store the histogram in the folder of a run on these frames."),
    ] = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Output folder; 'displacement' unless --into is given.")
    ] = None,
) -> None:
    """Write the histogram of flow magnitudes (a figure of the paper) to displacement.csv, .png, .svg and .pdf.

    Runs with ground truth store their histogram automatically unless --no-examples is given; use --into for frames
    without ground truth.

    \b
    Examples:
      robustflow reproduce displacement kitti-fc --data ~/kitti
      robustflow reproduce displacement gopro-fc --data ~/gopro-fc --model dis
      robustflow reproduce displacement gopro-fc --data ~/gopro-fc --model raft --into runs/gopro-fc_raft_1a2b3c4d
    """
    from ..analysis.displacements import label_of
    from ..atomic import make_folder, write_bytes
    from ..benchmarks import load_benchmark
    from ..models import ModelSpec
    from ..progress_bar import ProgressBar
    from ..report.figures import displacement_figure, write_figures
    from ..report.site.write import write_report
    from ..runner.displacement import displacement_histogram
    from ..runs.displacement_file import clean_digests, write_displacement

    if model is None:
        refuse_unused(context, {"option"}, "without --model")
    chosen = load_benchmark(benchmark, data, split, dict(keyword_options(data_option))).narrowed(limit=limit)
    run = None if into is None else _run_of(into, chosen)
    loaded = ModelSpec(model, keyword_options(option)).load() if model is not None else None
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
        typer.echo(str(folder / "displacement.csv"))
        label = label_of(chosen.name, len(chosen.keys), table["source"][0])
        for path in write_figures({"displacement": displacement_figure({label: table})}, folder):
            typer.echo(str(path))
    if run is not None:
        typer.echo(str(write_displacement(run, table)))
        write_report(run)


def _run_of(folder: Path, chosen: "Benchmark") -> "Run":
    from ..errors import UsageError
    from ..runs.run import Run
    from ..text import counted

    if folder.is_file():
        raise UsageError(f"{folder} is a file; histograms can only be stored in a run folder, not in a record")
    run = Run(folder)
    if run.benchmark != chosen.name or set(run.manifest.samples) != set(chosen.keys):
        ran = counted(len(run.manifest.samples), "pair")
        raise UsageError(
            f"{run.path} contains {ran} from {run.benchmark}, but these options select {len(chosen.keys)} from "
            f"{chosen.name}; give the run's --data, --split and --limit"
        )
    return run
