"""`robustflow export`: a benchmark's corrupted frames in the layout KITTI-FC was released in, or a run's rows."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .options import (
    CommonDraws,
    Corruptions,
    Data,
    Limit,
    PsfDir,
    Seed,
    Severities,
    SeverityScale,
    Split,
    Variant,
    names,
    numbers,
    use_psf_dir,
)


def export(
    benchmark: Annotated[
        str, typer.Argument(metavar="BENCHMARK|RUN", help="kitti-fc; with --format a run's folder or record.")
    ],
    data: Data = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="Folder to write, KITTI-FC by default; of rows the file, rows.csv."),
    ] = None,
    format: Annotated[
        str | None, typer.Option("--format", "-f", help="Write the rows of a run: csv or parquet.")
    ] = None,
    corruptions: Corruptions = None,
    severities: Severities = None,
    limit: Limit = None,
    split: Split = None,
    seed: Seed = 0,
    variant: Variant = "default",
    severity_scale: SeverityScale = "paper",
    common_draws: CommonDraws = False,
    psf_dir: PsfDir = None,
) -> None:
    """Write a benchmark as files: clean|<corruption>_<severity>/val/{image_2,flow_occ}; or a run's rows as one file.

    Files that are already whole are left alone, so a stopped export continues where it stopped.

    \b
    Example:
      robustflow export kitti-fc --data ~/kitti --output ~/KITTI-FC --limit 5
      robustflow export runs/mine --format parquet --output mine.parquet
    """
    if format is not None:
        _export_rows(Path(benchmark), format, output)
        return
    output = output or Path("KITTI-FC")
    from rich.console import Console
    from rich.progress import track

    from ..benchmarks import load_benchmark
    from ..benchmarks.export import export as write
    from ..corruptions.stack import levels_of

    use_psf_dir(psf_dir)
    chosen = load_benchmark(benchmark, data, split).narrowed(names(corruptions), numbers(severities), limit)
    levels = [len(levels_of(name, chosen.severities, severity_scale)) for name in chosen.corruptions]
    total = len(chosen.keys) * (1 + sum(levels))
    console = Console(stderr=True)
    steps = write(chosen, output, seed, variant, severity_scale, common_draws)
    shown = track(steps, "exporting", total, console=console, disable=not console.is_terminal)
    fresh = sum(step.fresh for step in shown)
    fewer = [name for name, n in zip(chosen.corruptions, levels, strict=True) if n < len(chosen.severities)]
    if severity_scale == "calibrated" and fewer:
        typer.echo(f"not at every severity, because the calibrated scale lacks some: {', '.join(fewer)}", err=True)
    typer.echo(
        f"{output}: {len(chosen.keys)} pairs; clean and corrupted, {fresh} written and {total - fresh} already there"
    )


def _export_rows(run: Path, format: str, output: Path | None) -> None:
    from ..atomic import write_bytes
    from ..records.load import load_run
    from ..runs.rows_file import rows_bytes

    data = rows_bytes(load_run(run), format)
    target = output or Path(f"rows.{format}")
    write_bytes(target, data)
    typer.echo(str(target))
