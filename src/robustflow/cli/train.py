"""`robustflow train`: train a network by a recipe."""

import shlex
from pathlib import Path
from typing import Annotated, Any

import typer
from typer import Argument, Option

from ..core.arguments import parse_size
from ..core.errors import UsageError
from ..core.output import echo
from ..core.plugins import require
from . import complete
from .interrupt import Interrupted, stopped
from .options import keyword_options, names, refuse_unused, shared


@shared(
    *("option", "device"),
    seed="Random seed of the weights, the order of the pairs and the augmentation.",
    output="Folder of the training; in trainings/ by default.",
    precision="fp32, fp16 or bf16, instead of the recipe's.",
)
def train(
    context: typer.Context,
    method: Annotated[
        str,
        Argument(metavar="METHOD", autocompletion=complete.methods, help="Method to train (robustflow list recipes)."),
    ],
    recipe: Annotated[str, Option(help="Training stage: ood or id (the paper's); chairs, things, ... (the authors').")],
    like: Annotated[str | None, Option(help="Method whose recipe is used for your own module:attribute.")] = None,
    data: Annotated[
        list[str] | None,
        Option("--data", "-d", help="Folder that contains datasets, or NAME=FOLDER. Repeatable."),
    ] = None,
    init: Annotated[str | None, Option(help="Initial weights: a checkpoint as for run, or random.")] = None,
    init_trained_on: Annotated[str | None, Option(help="Training sets of the initial weights, e.g. C+T.")] = None,
    resume: Annotated[bool, Option("--resume", help="Continue from the last checkpoint, bit for bit.")] = False,
    plan: Annotated[bool, Option("--plan", help="Print the training plan and missing items, and exit.")] = False,
    mix: Annotated[str | None, Option(help="Training data: chairs, things, ... or a TOML file.")] = None,
    steps: Annotated[int | None, Option(help="Number of steps; the schedule is scaled to match.")] = None,
    batch_size: Annotated[int | None, Option(help="Pairs per step, summed over all devices.")] = None,
    crop: Annotated[str | None, Option(help="Crop size, HEIGHTxWIDTH.")] = None,
    learning_rate: Annotated[float | None, Option(help="Learning rate.")] = None,
    iterations: Annotated[int | None, Option(help="Iterations of a recurrent network.")] = None,
    accumulate: Annotated[int | None, Option(help="Steps per update (gradient accumulation).")] = None,
    loaders: Annotated[int, Option(help="Number of processes that load and augment data.")] = 1,
    save_every: Annotated[int, Option(help="Updates between checkpoints.")] = 1000,
    keep_every: Annotated[int | None, Option(help="Number of updates between saved weight files.")] = None,
    validate: Annotated[str | None, Option(help="Benchmark for validation, e.g. sintel.")] = None,
    validate_data: Annotated[str | None, Option(help="Its data.")] = None,
    validate_every: Annotated[int | None, Option(help="Updates between validations; --save-every by default.")] = None,
    validate_corruptions: Annotated[str | None, Option(help="Corruptions for validation, e.g. fog,snow.")] = None,
    corrupt: Annotated[str | None, Option(help="Corruptions or families for training, e.g. noise,fog.")] = None,
    corrupt_probability: Annotated[float, Option(help="Probability that a pair is corrupted.")] = 0.5,
    skip_bad: Annotated[bool, Option("--skip-bad", help="Replace unreadable pairs with different ones.")] = False,
    **given: Any,
) -> None:
    """Train a network with a recipe of the paper or of the network's authors.

    Options replace values of the recipe. Ctrl-C stops training after the current update and writes a checkpoint;
    --resume continues bit for bit. For several GPUs, start with torchrun.

    \b
    Examples:
      robustflow train raft --recipe ood --data ~/flow --init raft-things.pth --output trainings/raft
      robustflow train raft --recipe ood --data ~/flow --output trainings/raft --resume
      robustflow train mypackage.flow:MyNet --like raft --recipe chairs --data ~/flow --init random
      torchrun --nproc-per-node 2 -m robustflow train gma --recipe ood --data ~/flow --init gma-things.pth
    """

    if corrupt is None:
        refuse_unused(context, {"corrupt_probability"}, "without --corrupt")
    require("torch", "training")
    from ..corruptions.registry import IMAGE_PAIR, with_families
    from ..training.data.parts import needs_data
    from ..training.recipe import is_own, load_recipe, takes_iterations
    from ..training.request import Checkpoints, DataPlan, Request, Validation

    if iterations is not None and not takes_iterations(method):
        raise UsageError(
            "--iterations", f"not an option of {method}; omit it, or give an option of your network with -O"
        )
    if like is None and is_own(method):
        raise UsageError("--like", f"give the method whose recipe trains {method}, for example raft")
    original = load_recipe(like or method, recipe)
    chosen = original.changed(
        method=method if like else None,
        mix=mix,
        steps=steps,
        batch=batch_size,
        crop=parse_size(crop, 8) if crop is not None else None,
        learning_rate=learning_rate,
        iterations="none" if is_own(method) else iterations,
        accumulate=accumulate,
        precision=given["precision"],
    )
    corrupted = with_families(names(corrupt) or [], IMAGE_PAIR)
    reading = DataPlan(data or [], corrupted, corrupt_probability, skip_bad, loaders)
    if plan:
        from ..training.plan_text import plan_text

        echo(plan_text(chosen, reading, original))
        return
    if not data and needs_data(chosen):
        raise UsageError("--data", "nothing to train on: give the folder that contains the datasets; --plan lists them")
    if validate is None:
        refuse_unused(context, {"validate_data", "validate_every", "validate_corruptions"}, "without --validate")
    from ..training.session import run_training

    validation = validate and Validation(validate, validate_data, validate_every, names(validate_corruptions) or [])
    request = Request(
        recipe=chosen,
        data=reading,
        output=given["output"] or Path("trainings") / f"{method}-{recipe}",
        start=init,
        start_trained_on=init_trained_on,
        resume=resume,
        seed=given["seed"],
        device=given["device"] or "auto",
        options=keyword_options(given["option"]),
        checkpoints=Checkpoints(save_every, keep_every),
        validation=validation or None,
    )
    interrupted = Interrupted()
    checkpoint = run_training(request, interrupted)
    if interrupted():
        raise stopped(f"{checkpoint} is kept. Run the same command with --resume")
    options = [word for text in given["option"] or [] for word in ("-O", text)]
    measure = ["robustflow", "run", "--model", chosen.method, *options, "--checkpoint", str(checkpoint)]
    echo(f"trained; measure it with: {shlex.join(measure)}")
