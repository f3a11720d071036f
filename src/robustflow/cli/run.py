"""`robustflow run`: evaluate a model on a benchmark."""

from typing import Annotated, Any

from typer import Argument, Option

from ..core.errors import UsageError
from ..core.output import echo
from ..core.text import file_name
from ..run.config import OUTPUT, WHAT
from . import complete
from .interrupt import stopped, terminate_as_on_ctrl_c
from .options import RUN, model_options, run_arguments, shared


@shared(*RUN)
def run(
    models: Annotated[
        list[str] | None, Argument(metavar="MODEL...", help="Models, as with --model.", autocompletion=complete.models)
    ] = None,
    seeds: Annotated[
        int,
        Option(
            help="Number of runs, with consecutive seeds and one folder each. With --still, a single run that also "
            "measures the standard deviation of the flow over the seeds.",
            rich_help_panel=WHAT,
        ),
    ] = 1,
    as_json: Annotated[bool, Option("--json", help="Print the runs as JSON.", rich_help_panel=OUTPUT)] = False,
    **given: Any,
) -> None:
    """Measure the robustness of a model, or of several models one after another.

    A run can be stopped at any time; run the same command again to resume it.

    \b
    Examples:
      robustflow run dis
      robustflow run --model dis --model farneback --benchmark kitti-fc --data ~/kitti --workers 4
      robustflow run --model raft --checkpoint things --device cuda --batch-size 5 --benchmark kitti-fc --data ~/kitti
      robustflow run --model mypackage.flow:MyModel --data clip.mp4 --still
      robustflow run --model dis --seeds 3 --output runs/dis && robustflow compare runs/dis/seed*
      robustflow run --model tiny --attacks apgd,square --severities 1,3
      robustflow run --model dis -O preset=fast -c weather,psf_blur -s 1-3
    """
    from ..models import ModelRef

    terminate_as_on_ctrl_c()
    options = model_options(given)
    models = [*(models or []), *(given["model_list"] or [])]
    if not models:
        raise UsageError("--model", "no model to measure: give one, e.g. --model dis (see robustflow list models)")
    if len(set(models)) < len(models):
        raise UsageError("--model", "a model is given twice; give each model once")
    if given["name"] is not None and len(models) > 1:
        raise UsageError("--name", "applies to a single model; leave it out, or run the models one by one")
    if seeds < 1:
        raise UsageError("--seeds", f"{seeds}: give 1 or more")
    refs = [ModelRef.parse(model, options) for model in models]
    for ref in refs:
        ref.preflight()  # check before the imports below, which take seconds
    from ..api import Result, evaluate
    from ..run.progress import TerminalProgress

    arguments = run_arguments(given)
    output, first, runs = given["output"], given["seed"], 1 if given["still"] else seeds
    results: list[Result] = []

    def show_numbers(result: Result) -> None:
        from .tables import print_result  # imported while no worker waits for it

        print_result(result, with_seed=runs > 1)

    progress = TerminalProgress() if as_json else TerminalProgress(show_numbers)
    try:
        for ref in refs:
            of_model = output if output is None or len(models) == 1 else output / file_name(ref.name)
            for seed in range(first, first + runs):
                folder = of_model if of_model is None or runs == 1 else of_model / f"seed{seed}"
                arguments_of_run = arguments | {"output": folder, "seed": seed, "draws": seeds // runs}
                with progress:
                    results.append(evaluate(ref, **arguments_of_run, progress=progress))
    except KeyboardInterrupt:
        raise stopped(f"{progress.finished_work()} Run the same command again") from None
    from .tables import as_json_text, print_results

    if as_json:
        echo(as_json_text(results))
    elif len(results) > 1:
        print_results(results)
