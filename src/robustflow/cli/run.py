"""`robustflow run`: evaluate a model on a benchmark."""

from pathlib import Path
from typing import Annotated

import typer

from ..core.errors import UsageError
from . import complete
from .complete import stopped, terminate_as_on_ctrl_c
from .options import (
    HOW,
    OUTPUT,
    WHAT,
    Attacks,
    Benchmark,
    Checkpoint,
    CommonDraws,
    Corruptions,
    Data,
    DataOptions,
    Depth,
    Device,
    Focal,
    Limit,
    ModelNames,
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
    use_psf_dir,
)


def run(
    models: Annotated[
        list[str] | None,
        typer.Argument(metavar="MODEL...", help="Models, as with --model.", autocompletion=complete.models),
    ] = None,
    model: ModelNames = None,
    benchmark: Benchmark = "demo",
    data: Data = None,
    checkpoint: Checkpoint = None,
    device: Device = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            help="Folder of the run, or parent folder for several runs; in runs/ by default.",
        ),
    ] = None,
    option: ModelOptions = None,
    trained_on: Annotated[
        str | None,
        typer.Option(
            "--trained-on",
            help="Training sets of the model, e.g. C+T (see robustflow list models).",
            rich_help_panel=WHAT,
        ),
    ] = None,
    name: Annotated[
        str | None,
        typer.Option("--name", help="Display name of the model in tables and figures.", rich_help_panel=WHAT),
    ] = None,
    corruptions: Corruptions = None,
    severities: Severities = None,
    attacks: Attacks = None,
    severity_scale: SeverityScale = "paper",
    variant: Variant = "default",
    common_draws: CommonDraws = False,
    psf_dir: PsfDir = None,
    seed: Seed = 0,
    seeds: Annotated[
        int,
        typer.Option(
            "--seeds",
            help="Number of runs, with consecutive seeds and one folder each (see compare). With --still, a single "
            "run that also measures the standard deviation of the flow over the seeds.",
            rich_help_panel=WHAT,
        ),
    ] = 1,
    data_option: DataOptions = None,
    depth: Depth = None,
    focal: Focal = None,
    still: Annotated[
        bool,
        typer.Option(
            "--still",
            help="Pair every frame with itself; the true flow is zero, so errors are phantom motion.",
            rich_help_panel=WHAT,
        ),
    ] = False,
    limit: Limit = None,
    subset: Annotated[
        str | None,
        typer.Option(
            "--subset",
            help="quick: a small set of conditions whose ranking of models resembles that of the full set (kitti-fc); "
            "its means are estimates.",
            rich_help_panel=WHAT,
        ),
    ] = None,
    split: Split = None,
    workers: Annotated[
        int | None,
        typer.Option(
            "--workers",
            "-w",
            help="Number of processes; for a model on GPUs, processes that load data. Default: one per CPU, at most "
            "8, for data loading and for single-threaded models (dis, tiny, farneback); 1 for other models on the "
            "CPU; with Ray, one per GPU or CPU of the cluster.",
            rich_help_panel=HOW,
        ),
    ] = None,
    batch_size: Annotated[
        int,
        typer.Option(
            "--batch-size",
            help="Number of corrupted pairs of a sample to predict, or of pairs to attack, per call, for models that "
            "support batches.",
            rich_help_panel=HOW,
        ),
    ] = 1,
    precision: Precision = None,
    engine: Annotated[
        str | None,
        typer.Option(
            help="serial, processes or ray; by default, depends on --device and --workers.", rich_help_panel=HOW
        ),
    ] = None,
    address: Annotated[
        str | None,
        typer.Option(
            help="Address of the Ray cluster: auto, host:port or ray://host:port; by default one on this machine.",
            rich_help_panel=HOW,
        ),
    ] = None,
    timeout: Annotated[
        float | None,
        typer.Option(help="Time limit for a single prediction, batch or attack, in seconds.", rich_help_panel=HOW),
    ] = None,
    allow_invalid: Annotated[
        bool,
        typer.Option(
            "--allow-invalid",
            help="Count and exclude NaN or infinite predicted pixels instead of failing.",
            rich_help_panel=HOW,
        ),
    ] = False,
    confidence: Annotated[
        str | None,
        typer.Option(
            "--confidence",
            help="Measure how well confidence predicts errors. Source of the confidence: forward-backward "
            "(consistency, with one more prediction per cell) or model (the model itself).",
            rich_help_panel=WHAT,
        ),
    ] = None,
    as_json: Annotated[
        bool,
        typer.Option(
            "--json", help="Print name, benchmark, folder and summary of each run as JSON.", rich_help_panel=OUTPUT
        ),
    ] = False,
    examples: Annotated[
        bool,
        typer.Option(
            "--examples/--no-examples",
            help="Draw pictures of the worst and the median sample at the end.",
            rich_help_panel=OUTPUT,
        ),
    ] = True,
) -> None:
    """Measure the robustness of a model, or of several models one after another.

    A run can be stopped at any time; run the same command again to resume it.

    \b
    Examples:
      robustflow run dis
      robustflow run --model farneback --benchmark kitti-fc --data ~/kitti --workers 4
      robustflow run --model dis --model farneback --benchmark kitti-fc --data ~/kitti
      robustflow run --model raft --checkpoint things --device cuda --batch-size 5 --benchmark kitti-fc --data ~/kitti
      robustflow run --model raft --device cuda --engine ray --address auto --benchmark kitti-fc --data /shared/kitti
      robustflow run --model mypackage.flow:MyModel --benchmark folder --data clip.mp4
      robustflow run --model dis --seeds 3 --output runs/dis && robustflow compare runs/dis/seed*
      robustflow run --model dis --data clip.mp4 --still --seeds 3
      robustflow run --model dis --confidence forward-backward
      robustflow run --model tiny --attacks apgd,square --severities 1,3
      robustflow run --model dis -O preset=fast -c weather,psf_blur -s 1-3
    """
    from ..models import ModelSpec

    terminate_as_on_ctrl_c()
    options = model_options(option, checkpoint=checkpoint, device=device, precision=precision, trained_on=trained_on)
    models = [*(models or []), *(model or [])]
    if not models:
        raise UsageError("no model to measure: give one with --model, e.g. --model dis (see robustflow list models)")
    if len(set(models)) < len(models):
        raise UsageError("a model is given twice; give each model once")
    if name is not None and len(models) > 1:
        raise UsageError("--name applies to a single model; leave it out, or run the models one by one")
    if seeds < 1:
        raise UsageError(f"--seeds {seeds}: give 1 or more")
    runs = 1 if still else seeds
    specs = [ModelSpec(each, options) for each in models]
    for spec in specs:
        spec.preflight()  # check before the imports below, which take seconds
    use_psf_dir(psf_dir)
    from ..api import Result, evaluate
    from ..core.text import file_name
    from ..run.progress import TerminalProgress
    from .tables import as_json_text, print_result, print_results

    results: list[Result] = []
    progress = TerminalProgress()
    try:
        for spec in specs:
            of_model = output if output is None or len(models) == 1 else output / file_name(spec.name)
            for number in range(seed, seed + runs):
                folder = of_model if of_model is None or runs == 1 else of_model / f"seed{number}"
                with progress:
                    result = evaluate(
                        spec,
                        benchmark,
                        data,
                        folder,
                        corruptions=names(corruptions),
                        severities=numbers(severities),
                        attacks=names(attacks),
                        limit=limit,
                        subset=subset,
                        split=split,
                        data_options=data_options(data_option, depth, focal),
                        still=still,
                        seed=number,
                        variant=variant,
                        severity_scale=severity_scale,
                        common_draws=common_draws,
                        name=name,
                        workers=workers,
                        batch_size=batch_size,
                        engine=engine,
                        address=address,
                        timeout=timeout,
                        allow_invalid=allow_invalid,
                        confidence=confidence,
                        draws=seeds // runs,
                        examples=examples,
                        progress=progress,
                    )
                if not as_json:
                    print_result(result, with_seed=runs > 1)
                results.append(result)
    except KeyboardInterrupt:
        raise stopped(f"{progress.finished_work()} Run the same command again") from None
    if as_json:
        typer.echo(as_json_text(results))
    elif len(results) > 1:
        print_results(results)
