"""`robustflow displacement`: how far things move in a benchmark."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .options import Data, DataOptions, Limit, ModelOptions, Split, keyword_options


def displacement(
    benchmark: Annotated[str, typer.Argument(help="kitti-fc, gopro-fc, demo, or any data set.")],
    data: Data = None,
    data_option: DataOptions = None,
    model: Annotated[
        str | None, typer.Option("--model", "-m", help="Whose flow to measure; the ground truth by default.")
    ] = None,
    option: ModelOptions = None,
    limit: Limit = None,
    split: Split = None,
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder to write.")] = Path("displacement"),
) -> None:
    """Write the histogram of flow amplitudes (the paper's figure of both benchmarks): displacement.csv, .png and .pdf.

    \b
    Examples:
      robustflow displacement kitti-fc --data ~/kitti
      robustflow displacement gopro-fc --data ~/gopro-fc --model dis
    """
    from rich.console import Console
    from rich.progress import Progress

    from ..atomic import make_folder, write_bytes
    from ..benchmarks import load_benchmark
    from ..models import ModelSpec
    from ..report.displacement import displacement_figure, displacement_histogram

    chosen = load_benchmark(benchmark, data, split, dict(keyword_options(data_option))).narrowed(limit=limit)
    loaded = ModelSpec(model, keyword_options(option)).load() if model is not None else None
    make_folder(output)
    console = Console(stderr=True)
    with Progress(console=console, disable=not console.is_terminal) as progress:
        task = progress.add_task("measuring")
        table = displacement_histogram(
            chosen,
            loaded,
            source=model or "",
            progress=lambda done, total: progress.update(task, completed=done, total=total),
        )
    write_bytes(output / "displacement.csv", table.write_csv().encode())
    for form in ("png", "pdf"):
        displacement_figure([table], output / f"displacement.{form}")
    for form in ("csv", "png", "pdf"):
        typer.echo(str(output / f"displacement.{form}"))
