"""`robustflow export`: write a benchmark's corrupted frames in the KITTI-FC layout, or a run's rows, results in
standard formats, or a submission."""

from pathlib import Path
from typing import Annotated, Any

import typer
from typer import Argument, Option

from ..core.display import ProgressBar
from ..core.errors import UsageError, unknown_name
from ..core.files import make_folder, write_bytes
from ..core.output import echo
from ..core.text import counted
from .options import DATASET, FRAMES, MODEL, data_options, model_options, names, refuse_unused, run_arguments, shared

_SUBMISSION = {"benchmark", "format", "data", "output", "corruptions", "limit", *MODEL}
"""Parameters that a submission uses."""


@shared(
    *DATASET,
    *("corruptions", "severities", "limit", "split"),
    *FRAMES,
    *(name for name in MODEL if name != "model"),
    model="With robustspring: model, if the run does not record it.",
    output="Output folder, or file for rows; by default KITTI-FC, submission, or the name of the format.",
)
def export(
    context: typer.Context,
    benchmark: Annotated[
        str, Argument(metavar="BENCHMARK|RUN", help="kitti-fc; with --format a run's folder or record.")
    ],
    format: Annotated[
        str | None,
        Option(
            "--format",
            "-f",
            help="Format for a run: csv or parquet (rows); huggingface (results); robustspring (the model's "
            "flows, as a submission to its server).",
        ),
    ] = None,
    hub_dataset: Annotated[str | None, Option(help="With huggingface: the benchmark's dataset on the Hub.")] = None,
    **given: Any,
) -> None:
    """Write a benchmark's frames to clean|<corruption>_<severity>/val/{image_2,flow_occ}, or a run's rows or results.

    With --format robustspring the run's model predicts the flow of RobustSpring's frames in --data (spring/test,
    fog/test, ...). The files of csv and huggingface depend only on the run: 'robustflow record verify RECORD
    --exported FILE' compares them with its record. An interrupted export resumes where it stopped.

    \b
    Example:
      robustflow export kitti-fc --data ~/kitti --output ~/KITTI-FC --limit 5
      robustflow export runs/mine --format parquet --output mine.parquet
      robustflow export runs/mine --format robustspring --data ~/RobustSpring --device cuda
    """
    if format == "robustspring":
        refuse_unused(context, set(context.params) - _SUBMISSION, "with --format robustspring")
        _export_submission(Path(benchmark), given)
    elif format is not None:
        _export_run(context, Path(benchmark), format, given["output"], hub_dataset)
    else:
        refuse_unused(context, {"hub_dataset", *MODEL}, "without --format")
        _export_frames(benchmark, given)


def _export_frames(benchmark: str, given: dict[str, Any]) -> None:
    from ..data.benchmarks import BENCHMARKS, load_benchmark
    from ..data.benchmarks.export import export as write

    if benchmark not in BENCHMARKS and Path(benchmark).exists():
        raise UsageError(benchmark, "not a benchmark: add --format to export a run, or give its folder with --data")
    arguments, output = run_arguments(given), given["output"] or Path("KITTI-FC")
    opened = load_benchmark(benchmark, given["data"], given["split"], data_options(given))
    chosen = opened.narrowed(arguments["corruptions"], arguments["severities"], given["limit"])
    levels = {one.name: one.levels(chosen.severities, given["severity_scale"]) for one in chosen.conditions}
    total = len(chosen.keys) * (1 + sum(map(len, levels.values())))
    steps = write(chosen, output, *(given[name] for name in FRAMES if name != "psf_dir"))
    with ProgressBar() as progress:
        fresh = sum(step.fresh for step in progress.track(steps, f"{output}: exporting", total))
    fewer = [name for name, of_name in levels.items() if len(of_name) < len(chosen.severities)]
    if given["severity_scale"] == "calibrated" and fewer:
        typer.echo(f"the calibrated scale lacks some severities of {', '.join(fewer)}", err=True)
    written = f"{fresh} written and {total - fresh} already present"
    echo(f"{output}: {counted(len(chosen.keys), 'pair')}; clean and corrupted copies: {written}")


def _export_run(context: typer.Context, path: Path, format: str, output: Path | None, hub_dataset: str | None) -> None:
    from ..report.exchange import HUB_FILE, hub_results
    from ..run.records.pack import load_any_run
    from ..run.run import ROWS_FORMATS, rows_bytes

    if format not in (*ROWS_FORMATS, "huggingface"):
        raise unknown_name("format of a run", format, (*ROWS_FORMATS, "huggingface", "robustspring"))
    used = {"benchmark", "format", "output"} | ({"hub_dataset"} if format == "huggingface" else set())
    refuse_unused(context, set(context.params) - used, f"with --format {format}")
    run = load_any_run(path)
    if format in ROWS_FORMATS:
        target, data = output or Path(f"rows.{format}"), rows_bytes(run, format)
    else:
        target, data = (output or Path(format)) / HUB_FILE, hub_results(run, hub_dataset)
    make_folder(target.parent)
    write_bytes(target, data)
    echo(str(target))


def _export_submission(path: Path, given: dict[str, Any]) -> None:
    from ..data.datasets.robustspring import CORRUPTIONS, submitted
    from ..models import ModelRef
    from ..run.records.pack import load_any_run
    from ..run.source import RunSource
    from ..run.submission import Robustness, condition_pairs, model_of, write_submission
    from ..stats.results import AVERAGE
    from ..stats.results_file import results_csv
    from ..stats.robustspring import robustness_csv, robustness_means, robustspring_results

    if given["data"] is None:
        raise UsageError("--data", "give RobustSpring's frames, the folder that contains spring/test/")
    output, options = given["output"] or Path("submission"), model_options(given)
    run = load_any_run(path)
    if given["model"] is None:
        ref = RunSource.read(run.path).model_to_reuse(dict(options))
    else:
        ref = ModelRef.parse(given["model"], options)
    conditions, keys = condition_pairs(given["data"], names(given["corruptions"]) or CORRUPTIONS, given["limit"])
    with ProgressBar() as progress:
        written = write_submission(run, model_of(run, ref), conditions, keys, output)
        flows = list(progress.track(written, f"{output}: predicting", len(conditions) * len(keys)))
    moved: dict[str, list[Robustness]] = {}
    for predicted in flows:
        if predicted.moved is not None:
            moved.setdefault(predicted.condition, []).append(predicted.moved)
    fresh = sum(flow.fresh for flow in flows)
    echo(f"{output}: {counted(len(flows), 'flow')}, {fresh} written and {len(flows) - fresh} already present")
    if moved:
        means = robustness_means(moved)
        write_bytes(output / "results.csv", results_csv(robustspring_results(run, flows)).encode())
        write_bytes(output / "robustness.csv", robustness_csv(means).encode())
        epe, fl, px1 = means[AVERAGE][1]
        echo(
            f"change of the flow: {epe:.2f} px on average (EPE robustness), Fl {fl:.2f} %, 1px {px1:.2f} %, over all "
            "pixels; the server takes about 0.1 % of them, in float16"
        )
    if missing := sum(not (output / flow).is_file() for flow in submitted()):
        echo(f"incomplete submission: {missing} of {len(list(submitted()))} flows are missing")
