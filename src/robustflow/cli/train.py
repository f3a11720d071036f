"""`robustflow train`: a network by a recipe."""

from __future__ import annotations

import signal
from pathlib import Path
from typing import Annotated, Any

import typer

from ..errors import UsageError
from .options import Device, ModelOptions, Seed, keyword_options, names


def train(
    method: Annotated[str, typer.Argument(help="What is trained (robustflow list recipes).")],
    recipe: Annotated[str, typer.Option(help="Stage: ood or id of the paper; chairs, things, ... of the authors.")],
    like: Annotated[
        str | None, typer.Option("--like", help="Whose recipe a module:attribute of your own is trained by.")
    ] = None,
    option: ModelOptions = None,
    data: Annotated[
        list[str] | None,
        typer.Option("--data", "-d", help="A folder that holds data sets, or NAME=FOLDER; may be given several times."),
    ] = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="The training's folder; in trainings/ by default.")
    ] = None,
    init: Annotated[
        str | None, typer.Option("--init", help="Weights to begin with: a checkpoint as run takes it, or random.")
    ] = None,
    init_trained_on: Annotated[
        str | None,
        typer.Option("--init-trained-on", help="What they have seen, e.g. C+T, if the file does not say."),
    ] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Go on from the last checkpoint, to the bit.")] = False,
    plan: Annotated[bool, typer.Option("--plan", help="Say what would be done and what is missing, and stop.")] = False,
    mix: Annotated[
        str | None, typer.Option(help="Data other than the recipe's: chairs, things, ... or a TOML file.")
    ] = None,
    steps: Annotated[int | None, typer.Option(help="Instead of the recipe's; the schedule is shortened.")] = None,
    batch_size: Annotated[int | None, typer.Option("--batch-size", help="Pairs a step, over all devices.")] = None,
    crop: Annotated[str | None, typer.Option(help="HEIGHTxWIDTH instead of the recipe's.")] = None,
    learning_rate: Annotated[float | None, typer.Option("--learning-rate", help="Instead of the recipe's.")] = None,
    iterations: Annotated[int | None, typer.Option(help="Of a recurrent network, instead of the recipe's.")] = None,
    accumulate: Annotated[int | None, typer.Option(help="Steps for one update.")] = None,
    precision: Annotated[str | None, typer.Option(help="fp32, fp16 or bf16, instead of the recipe's.")] = None,
    device: Device = None,
    seed: Seed = 0,
    loaders: Annotated[int, typer.Option("--loaders", help="Processes that read and augment ahead.")] = 1,
    save_every: Annotated[int, typer.Option("--save-every", help="Updates between checkpoints.")] = 1000,
    keep_every: Annotated[
        int | None, typer.Option("--keep-every", help="Updates between files of weights that stay.")
    ] = None,
    validate: Annotated[str | None, typer.Option(help="A benchmark to validate on, e.g. sintel.")] = None,
    validate_data: Annotated[str | None, typer.Option("--validate-data", help="Its data.")] = None,
    validate_every: Annotated[
        int | None, typer.Option("--validate-every", help="Updates between validations; as --save-every by default.")
    ] = None,
    validate_corruptions: Annotated[
        str | None, typer.Option("--validate-corruptions", help="Besides the clean frames, e.g. fog,snow.")
    ] = None,
    corrupt: Annotated[
        str | None, typer.Option("--corrupt", help="Corruptions or families laid over training frames, e.g. noise,fog.")
    ] = None,
    corrupt_probability: Annotated[
        float, typer.Option("--corrupt-probability", help="Of a pair being corrupted.")
    ] = 0.5,
    skip_bad: Annotated[
        bool, typer.Option("--skip-bad", help="Take another pair in place of one that cannot be read.")
    ] = False,
) -> None:
    """Train a network by a recipe of the paper or of its authors.

    Ctrl-C ends it after the update at hand, with a checkpoint; --resume goes on, to the bit. On several GPUs start it
    with torchrun.

    \b
    Examples:
      robustflow train raft --recipe ood --data ~/flow --init raft-things.pth --plan
      robustflow train raft --recipe ood --data ~/flow --init raft-things.pth --output trainings/raft
      robustflow train raft --recipe ood --data ~/flow --output trainings/raft --resume
      robustflow train mypackage.flow:MyNet --like raft --recipe chairs --data ~/flow --init random
      robustflow train raft --recipe kitti --data kitti2015=~/kitti --init random --steps 100 --batch-size 2
      torchrun --nproc-per-node 2 -m robustflow train gma --recipe ood --data ~/flow --init gma-things.pth
    """
    from ..models.extras import require
    from ..size import parse_size

    require("torch", "torch", "train")
    from ..training.recipe import load_recipe

    chosen = load_recipe(like or method, recipe).changed(
        method=method if like else None,
        mix=mix,
        steps=steps,
        batch=batch_size,
        crop=parse_size(crop, 8) if crop is not None else None,
        learning_rate=learning_rate,
        iterations=iterations,
        accumulate=accumulate,
        precision=precision,
    )
    from ..training.data.find import needs_data

    if plan:
        from ..training.plan import plan_text

        typer.echo(plan_text(chosen, data or []))
        return
    if not data and needs_data(chosen):
        raise UsageError("nothing to train on: give --data FOLDER, which holds the data sets; --plan says which")
    from ..training.session import Request, run_training

    request = Request(
        recipe=chosen,
        data=data or [],
        output=output or Path("trainings") / f"{method}-{recipe}",
        start=init,
        start_trained_on=init_trained_on,
        resume=resume,
        seed=seed,
        device=device or "auto",
        options=keyword_options(option),
        loaders=loaders,
        save_every=save_every,
        keep_every=keep_every,
        validate=validate,
        validate_data=validate_data,
        validate_every=validate_every,
        validate_corruptions=names(validate_corruptions) or [],
        corrupt=_corruptions(corrupt),
        corrupt_probability=corrupt_probability,
        skip_bad=skip_bad,
    )
    interrupted = Interrupted()
    checkpoint = run_training(request, interrupted)
    if interrupted():
        kept = f"robustflow: stopped; {checkpoint} is kept. Give the same command with --resume to continue."
        typer.echo(kept, err=True)
        raise typer.Exit(130)
    typer.echo(f"trained; measure it with: robustflow run --model {chosen.method} --checkpoint {checkpoint}")


class Interrupted:
    """Whether Ctrl-C or a request to terminate came; the second one ends the process at once."""

    def __init__(self) -> None:
        self._came = False
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._note)

    def __call__(self) -> bool:
        return self._came

    def _note(self, number: int, frame: Any) -> None:
        if self._came:
            raise KeyboardInterrupt
        self._came = True
        typer.echo("robustflow: stopping after this update; once more to stop at once", err=True)


def _corruptions(text: str | None) -> list[str]:
    """Names of corruptions; a family stands for those of its corruptions that a pair of images can have."""
    from ..corruptions.registry import FAMILIES, IMAGE_PAIR

    chosen: list[str] = []
    for name in names(text) or []:
        chosen += [each for each in FAMILIES[name] if each in IMAGE_PAIR] if name in FAMILIES else [name]
    return list(dict.fromkeys(chosen))
