"""`robustflow train`: train a network by a recipe."""

import shlex
from pathlib import Path
from typing import Annotated

import typer

from ..core.errors import UsageError
from . import complete
from .complete import Interrupted, stopped
from .options import Device, ModelOptions, keyword_options, names, refuse_unused


def train(
    context: typer.Context,
    method: Annotated[
        str,
        typer.Argument(
            metavar="METHOD",
            autocompletion=complete.methods,
            help="Method to train (robustflow list recipes).",
        ),
    ],
    recipe: Annotated[
        str, typer.Option(help="Training stage: ood or id (the paper's); chairs, things, ... (the authors').")
    ],
    like: Annotated[
        str | None, typer.Option("--like", help="Method whose recipe is used for your own module:attribute.")
    ] = None,
    option: ModelOptions = None,
    data: Annotated[
        list[str] | None,
        typer.Option("--data", "-d", help="Folder that contains datasets, or NAME=FOLDER. Repeatable."),
    ] = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Folder of the training; in trainings/ by default.")
    ] = None,
    init: Annotated[
        str | None, typer.Option("--init", help="Initial weights: a checkpoint as for run, or random.")
    ] = None,
    init_trained_on: Annotated[
        str | None,
        typer.Option(
            "--init-trained-on", help="Training sets of the initial weights, e.g. C+T, if the file does not list them."
        ),
    ] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Continue from the last checkpoint, bit for bit.")] = False,
    plan: Annotated[bool, typer.Option("--plan", help="Print the training plan and missing items, and exit.")] = False,
    mix: Annotated[
        str | None, typer.Option(help="Training data instead of the recipe's: chairs, things, ... or a TOML file.")
    ] = None,
    steps: Annotated[
        int | None, typer.Option(help="Number of steps, instead of the recipe's; the schedule is scaled to match.")
    ] = None,
    batch_size: Annotated[
        int | None, typer.Option("--batch-size", help="Pairs per step, summed over all devices.")
    ] = None,
    crop: Annotated[str | None, typer.Option(help="Crop size, HEIGHTxWIDTH, instead of the recipe's.")] = None,
    learning_rate: Annotated[
        float | None, typer.Option("--learning-rate", help="Learning rate, instead of the recipe's.")
    ] = None,
    iterations: Annotated[
        int | None, typer.Option(help="Iterations of a recurrent network, instead of the recipe's.")
    ] = None,
    accumulate: Annotated[int | None, typer.Option(help="Steps per update (gradient accumulation).")] = None,
    precision: Annotated[str | None, typer.Option(help="fp32, fp16 or bf16, instead of the recipe's.")] = None,
    device: Device = None,
    seed: Annotated[
        int, typer.Option(help="Random seed of the weights, the order of the pairs and the augmentation.")
    ] = 0,
    loaders: Annotated[int, typer.Option("--loaders", help="Number of processes that load and augment data.")] = 1,
    save_every: Annotated[int, typer.Option("--save-every", help="Updates between checkpoints.")] = 1000,
    keep_every: Annotated[
        int | None, typer.Option("--keep-every", help="Number of updates between saved weight files.")
    ] = None,
    validate: Annotated[str | None, typer.Option(help="Benchmark for validation, e.g. sintel.")] = None,
    validate_data: Annotated[str | None, typer.Option("--validate-data", help="Its data.")] = None,
    validate_every: Annotated[
        int | None,
        typer.Option("--validate-every", help="Number of updates between validations; --save-every by default."),
    ] = None,
    validate_corruptions: Annotated[
        str | None,
        typer.Option(
            "--validate-corruptions", help="Corruptions for validation in addition to clean frames, e.g. fog,snow."
        ),
    ] = None,
    corrupt: Annotated[
        str | None,
        typer.Option("--corrupt", help="Corruptions or families applied to training frames, e.g. noise,fog."),
    ] = None,
    corrupt_probability: Annotated[
        float, typer.Option("--corrupt-probability", help="Probability that a pair is corrupted.")
    ] = 0.5,
    skip_bad: Annotated[bool, typer.Option("--skip-bad", help="Replace unreadable pairs with different ones.")] = False,
) -> None:
    """Train a network with a recipe of the paper or of the network's authors.

    Ctrl-C stops training after the current update and writes a checkpoint; --resume continues bit for bit. For several
    GPUs, start with torchrun.

    \b
    Examples:
      robustflow train raft --recipe ood --data ~/flow --init raft-things.pth --plan
      robustflow train raft --recipe ood --data ~/flow --init raft-things.pth --output trainings/raft
      robustflow train raft --recipe ood --data ~/flow --output trainings/raft --resume
      robustflow train mypackage.flow:MyNet --like raft --recipe chairs --data ~/flow --init random
      robustflow train raft --recipe kitti --data kitti2015=~/kitti --init random --steps 100 --batch-size 2
      torchrun --nproc-per-node 2 -m robustflow train gma --recipe ood --data ~/flow --init gma-things.pth
    """
    from ..core.arguments import parse_size
    from ..core.plugins import require

    if corrupt is None:
        refuse_unused(context, {"corrupt_probability"}, "without --corrupt")
    require("torch", "training")
    from ..training.recipe import is_own, load_recipe, takes_iterations

    if iterations is not None and not takes_iterations(method):
        raise UsageError(
            f"--iterations is not an option of {method}; omit it, or give an option of your network with -O"
        )
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
        precision=precision,
    )
    from ..training.data.find import needs_data
    from ..training.request import Checkpoints, DataPlan, Request, Validation

    reading = DataPlan(data or [], _corruptions(corrupt), corrupt_probability, skip_bad, loaders)
    if plan:
        from ..training.plan import plan_text

        typer.echo(plan_text(chosen, reading, original))
        return
    if not data and needs_data(chosen):
        raise UsageError("nothing to train on: give --data FOLDER, which contains the datasets; --plan lists them")
    if validate is None:
        alone = {"data": validate_data, "every": validate_every, "corruptions": validate_corruptions}
        for name, value in alone.items():
            if value is not None:
                raise UsageError(f"--validate-{name} needs --validate BENCHMARK")
    from ..training.session import run_training

    request = Request(
        recipe=chosen,
        data=reading,
        output=output or Path("trainings") / f"{method}-{recipe}",
        start=init,
        start_trained_on=init_trained_on,
        resume=resume,
        seed=seed,
        device=device or "auto",
        options=keyword_options(option),
        checkpoints=Checkpoints(save_every, keep_every),
        validation=Validation(validate, validate_data, validate_every, names(validate_corruptions) or [])
        if validate
        else None,
    )
    interrupted = Interrupted()
    checkpoint = run_training(request, interrupted)
    if interrupted():
        raise stopped(f"{checkpoint} is kept. Run the same command with --resume")
    options = [word for text in option or [] for word in ("-O", text)]
    measure = ["robustflow", "run", "--model", chosen.method, *options, "--checkpoint", str(checkpoint)]
    typer.echo(f"trained; measure it with: {shlex.join(measure)}")


def _corruptions(text: str | None) -> list[str]:
    """Return names of corruptions; a family expands to all of its corruptions that apply to image pairs."""
    from ..corruptions.registry import IMAGE_PAIR, with_families

    return with_families(names(text) or [], IMAGE_PAIR)
