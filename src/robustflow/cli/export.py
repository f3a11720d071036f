"""`robustflow export`: write a benchmark's corrupted frames in the KITTI-FC layout, or a run's rows, results in
standard formats, or a submission."""

from pathlib import Path
from typing import Annotated, Any

import typer

from ..core.errors import UsageError
from .options import (
    Checkpoint,
    CommonDraws,
    Corruptions,
    Data,
    DataOptions,
    Depth,
    Device,
    Focal,
    Limit,
    ModelOptions,
    Precision,
    PsfDir,
    Seed,
    Severities,
    SeverityScale,
    Split,
    Variant,
    data_options,
    model_options,
    names,
    numbers,
    refuse_unused,
    use_psf_dir,
)

_OF_MODEL = {"model", "checkpoint", "device", "precision", "option"}
_OF_SUBMISSION = {"benchmark", "format", "data", "output", "corruptions", "limit", *_OF_MODEL}
"""Parameters that a submission uses."""


def export(
    context: typer.Context,
    benchmark: Annotated[
        str, typer.Argument(metavar="BENCHMARK|RUN", help="kitti-fc; with --format a run's folder or record.")
    ],
    data: Data = None,
    data_option: DataOptions = None,
    depth: Depth = None,
    focal: Focal = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            help="Output folder; by default KITTI-FC, submission or the name of the format. Output file for rows.",
        ),
    ] = None,
    format: Annotated[
        str | None,
        typer.Option(
            "--format",
            "-f",
            help="Format for a run: csv, parquet or croissant (rows); huggingface (results); robustspring (the model's "
            "flows, as a submission to its server).",
        ),
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
    model: Annotated[
        str | None, typer.Option("--model", "-m", help="With robustspring: model, if the run does not record it.")
    ] = None,
    checkpoint: Checkpoint = None,
    device: Device = None,
    precision: Precision = None,
    option: ModelOptions = None,
    hub_dataset: Annotated[
        str | None, typer.Option("--hub-dataset", help="With huggingface: the benchmark's dataset on the Hub.")
    ] = None,
) -> None:
    """Write a benchmark's frames to clean|<corruption>_<severity>/val/{image_2,flow_occ}, or a run's rows or results.

    With --format robustspring the run's model predicts the flow of RobustSpring's frames in --data (spring/test,
    fog/test, ...). Flows are written in the layout that its flow_robust_subsampling expects, and results.csv contains
    the change of the flow under corruption. The files of croissant and huggingface depend only on the run:
    'robustflow record verify RECORD --exported FILE' compares them with the run's record. Existing complete frames and
    flows are kept, so an interrupted export resumes where it stopped.

    \b
    Example:
      robustflow export kitti-fc --data ~/kitti --output ~/KITTI-FC --limit 5
      robustflow export runs/mine --format parquet --output mine.parquet
      robustflow export runs/mine --format croissant --output mine
      robustflow export runs/mine --format robustspring --data ~/RobustSpring --device cuda
    """
    if format == "robustspring":
        refuse_unused(context, set(context.params) - _OF_SUBMISSION, "with --format robustspring")
        given = model_options(option, checkpoint=checkpoint, device=device, precision=precision)
        _export_submission(Path(benchmark), model, given, data, output, names(corruptions), limit)
        return
    if format is not None:
        _export_run(context, Path(benchmark), format, output, hub_dataset)
        return
    refuse_unused(context, {"hub_dataset", *_OF_MODEL}, "without --format")
    from ..core.display import ProgressBar
    from ..core.text import counted
    from ..corruptions.stack import levels_of
    from ..data.benchmarks import BENCHMARKS, load_benchmark
    from ..data.benchmarks.export import export as write

    if benchmark not in BENCHMARKS and Path(benchmark).exists():
        raise UsageError(
            f"{benchmark} is not a benchmark: add --format to export a run, or give its folder with --data"
        )
    use_psf_dir(psf_dir)
    output = output or Path("KITTI-FC")
    opened = load_benchmark(benchmark, data, split, data_options(data_option, depth, focal))
    chosen = opened.narrowed(names(corruptions), numbers(severities), limit)
    levels = [len(levels_of(name, chosen.severities, severity_scale)) for name in chosen.corruptions]
    total = len(chosen.keys) * (1 + sum(levels))
    steps = write(chosen, output, seed, variant, severity_scale, common_draws)
    with ProgressBar() as progress:
        fresh = sum(step.fresh for step in progress.track(steps, f"{output}: exporting", total))
    fewer = [name for name, n in zip(chosen.corruptions, levels, strict=True) if n < len(chosen.severities)]
    if severity_scale == "calibrated" and fewer:
        typer.echo(
            f"not exported at every severity, because the calibrated scale lacks some severities of {', '.join(fewer)}",
            err=True,
        )
    typer.echo(
        f"{output}: {counted(len(chosen.keys), 'pair')}; clean and corrupted copies: {fresh} written and "
        f"{total - fresh} already present"
    )


def _export_run(context: typer.Context, path: Path, format: str, output: Path | None, hub_dataset: str | None) -> None:
    from ..core.errors import unknown_name
    from ..core.files import make_folder, write_bytes
    from ..report.exchange import EXCHANGE_FORMATS, exchange_files
    from ..run.records.pack import load_any_run
    from ..run.run import ROWS_FORMATS, rows_bytes

    if format not in (*ROWS_FORMATS, *EXCHANGE_FORMATS):
        raise unknown_name("format of a run", format, (*ROWS_FORMATS, *EXCHANGE_FORMATS, "robustspring"))
    used = {"benchmark", "format", "output"} | ({"hub_dataset"} if format == "huggingface" else set())
    refuse_unused(context, set(context.params) - used, f"with --format {format}")
    run = load_any_run(path)
    if format in ROWS_FORMATS:
        files = {output or Path(f"rows.{format}"): rows_bytes(run, format)}
    else:
        made = exchange_files(run, format, hub_dataset)
        files = {(output or Path(format)) / name: data for name, data in made.items()}
    for target, data in files.items():
        make_folder(target.parent)
        write_bytes(target, data)
        typer.echo(str(target))


def _export_submission(
    path: Path,
    model: str | None,
    given: tuple[tuple[str, Any], ...],
    data: Path | None,
    output: Path | None,
    corruptions: list[str] | None,
    limit: int | None,
) -> None:
    from ..core.display import ProgressBar
    from ..core.files import write_bytes
    from ..data.datasets.robustspring import CORRUPTIONS, submitted
    from ..models import ModelSpec
    from ..run.records.pack import load_any_run
    from ..run.source import RunSource
    from ..run.submission import Robustness, condition_pairs, model_of, write_submission
    from ..stats.results import AVERAGE
    from ..stats.results_file import results_csv
    from ..stats.robustspring import robustness_csv, robustness_means, robustspring_results

    if data is None:
        raise UsageError(
            "--format robustspring needs RobustSpring's frames: give --data PATH, the folder that contains spring/test/"
        )
    output = output or Path("submission")
    run = load_any_run(path)
    spec = ModelSpec(model, given) if model is not None else RunSource.read(run.path).model_to_reuse(dict(given))
    conditions = condition_pairs(data, corruptions or CORRUPTIONS, limit)
    total = sum(len(condition.keys) for condition in conditions)
    with ProgressBar() as progress:
        written = write_submission(run, model_of(run, spec), conditions, output)
        flows = list(progress.track(written, f"{output}: predicting", total))
    moved: dict[str, list[Robustness]] = {}
    for one in flows:
        if one.moved is not None:
            moved.setdefault(one.condition, []).append(one.moved)
    if moved:
        write_bytes(output / "results.csv", results_csv([robustspring_results(run, flows)]).encode())
        means = robustness_means(moved)
        write_bytes(output / "robustness.csv", robustness_csv(means).encode())
    fresh = sum(one.fresh for one in flows)
    typer.echo(f"{output}: {len(flows)} flows, {fresh} written and {len(flows) - fresh} already present")
    if moved:
        epe, fl, px1 = means[AVERAGE][1]
        typer.echo(
            f"the flow changed by {epe:.2f} px on average (EPE robustness), Fl {fl:.2f} %, 1px {px1:.2f} %, over "
            "all pixels; the server evaluates about 0.1 % of the pixels, subsampled in float16, so its numbers differ "
            "slightly"
        )
    if missing := sum(not (output / flow).is_file() for flow in submitted()):
        typer.echo(f"incomplete submission: {missing} of {len(list(submitted()))} flows are missing")
