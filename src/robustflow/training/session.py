"""A training, set up from what a user asks for, and carried out."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from ..atomic import make_folder, write_json
from ..corruptions.transforms.transform import CorruptionTransform
from ..datasets import dataset_facts
from ..errors import RunError, UsageError
from ..layout import user_path
from ..models.provenance import TRAINING_SETS, training_of
from ..models.torch.find_checkpoint import RANDOM
from ..models.torch.model import NetworkModel
from .checkpoint import LAST, Progressed, read_progress
from .data.find import OpenPart, open_part
from .data.order import Order
from .data.pairs import TrainingPairs
from .loop import State, Training, train
from .networks import load_network
from .optimizers import build_optimizer
from .processes import Process, this_process
from .progress import TrainingProgress
from .recipe import Recipe, mix_parts
from .validate import validator

PAIRS_OF_VALIDATION = 20


@dataclass(frozen=True)
class Request:
    """What a user asks for.

    Attributes:
        recipe: with the user's changes.
        data: folders, see `open_part`.
        output: the training's folder.
        start: a checkpoint to begin with, or "random"; None for what the recipe begins with.
        start_trained_on: what those weights have seen, where their file does not say.
        resume: go on from `last.pth`.
        seed: of every draw.
        device: as `run --device` takes it.
        options: of the model.
        loaders: processes that read ahead.
        save_every, keep_every, validate_every: updates, see `loop.Training`.
        validate: a benchmark, or None.
        validate_data: its data.
        validate_corruptions: besides the clean frames.
        validate_limit: its first pairs only.
        corrupt: corruptions laid over training frames.
        corrupt_probability: of a pair being corrupted.
        skip_bad: see `TrainingPairs`.
    """

    recipe: Recipe
    data: Sequence[str | Path]
    output: Path
    start: str | None = None
    start_trained_on: str | None = None
    resume: bool = False
    seed: int = 0
    device: str = "auto"
    options: tuple[tuple[str, Any], ...] = ()
    loaders: int = 1
    save_every: int = 1000
    keep_every: int | None = None
    validate: str | None = None
    validate_data: str | Path | None = None
    validate_every: int | None = None
    validate_corruptions: Sequence[str] = ()
    validate_limit: int | None = PAIRS_OF_VALIDATION
    corrupt: Sequence[str] = ()
    corrupt_probability: float = 0.5
    skip_bad: bool = False


def run_training(request: Request, stop: Callable[[], bool] = lambda: False) -> Path:
    """Train, from the start or from the last checkpoint; the path of that checkpoint.

    Args:
        request: what is asked for.
        stop: asked after each update; True ends the training there, with a checkpoint.

    Raises:
        UsageError: parts that do not go together, or a folder that holds another training.
        DataError: data that are missing or cannot be read, or a folder that cannot be written.
        ModelError: weights that cannot be loaded, or a loss that is not finite.
        RunError: nothing to resume, or another training.
    """
    recipe, folder = request.recipe, user_path(request.output)
    parts = [open_part(part, request.data) for part in mix_parts(recipe.mix)]
    order = Order(sum(map(len, parts)), recipe.batch * recipe.accumulate, request.seed)
    pairs = TrainingPairs(
        parts, order, recipe.crop, request.seed, _corruption(request), request.skip_bad, recipe.objective
    )
    content, done = _earlier(folder, request)
    with this_process(request.device) as process:
        _check_process(recipe, process)
        start = RANDOM if request.resume else _start(request)
        parted = recipe.changed(devices=max(1, recipe.devices // process.world))  # each process is one of them already
        model, network = load_network(parted, start, str(process.device), dict(request.options), request.seed)
        identity = _identity(request, parts)
        if done is None:
            done = Progressed(0, {**identity, **_start_record(model, request)})
        _check_same(folder, identity, done.identity)
        optimizer = build_optimizer(network, recipe)
        scaler = torch.amp.GradScaler(process.device.type, enabled=recipe.precision == "fp16")
        if content is not None:
            network.load_weights(content["model"])
            optimizer.load_state_dict(content["optimizer"])
            scaler.load_state_dict(content["scaler"])
        if process.rank == 0 and not request.resume:
            make_folder(folder)
            write_json(folder / "recipe.json", {**recipe.model_dump(mode="json"), "training": done.identity})
        training = Training(
            recipe=recipe,
            seed=request.seed,
            trained_on=_trained_on(done.identity["start_trained_on"], parts),
            folder=folder,
            pairs=pairs,
            loaders=request.loaders,
            save_every=request.save_every,
            keep_every=request.keep_every,
            validate_every=request.validate_every or request.save_every,
            validate=_validator(model, folder, request),
            stop=stop,
        )
        train(training, State(network, optimizer, scaler, done), process, TrainingProgress(process.rank == 0))
    return folder / LAST


def _earlier(folder: Path, request: Request) -> tuple[dict[str, Any] | None, Progressed | None]:
    """The last checkpoint's content where a training is resumed."""
    if request.resume:
        return read_progress(folder / LAST)
    if (folder / LAST).exists():
        raise UsageError(f"{folder} holds a training; continue it with --resume, or choose another --output")
    return None, None


def _start(request: Request) -> str:
    recipe = request.recipe
    if request.start is None and recipe.start != RANDOM:
        raise UsageError(
            f"recipe '{recipe.stage}' of {recipe.method} begins with the weights of its stage '{recipe.start}': give "
            "them with --init FILE, or train from scratch with --init random"
        )
    return request.start or RANDOM


def _start_record(model: NetworkModel, request: Request) -> dict[str, Any]:
    """Which weights a training begins with, and what they have seen: names of training sets, None where unknown."""
    checkpoint = str(model.identity()["checkpoint"])
    if _start(request) == RANDOM and request.start_trained_on is None:
        return {"start": checkpoint, "start_trained_on": []}
    sets = training_of(model.identity(), request.start_trained_on or model.trained_on).sets
    return {"start": checkpoint, "start_trained_on": None if sets is None else list(sets)}


def _trained_on(seen: list[str] | None, parts: Sequence[OpenPart]) -> str | None:
    """What the weights will have seen, as `--trained-on` takes it; None where some of it is not known."""
    sets = list(seen or [])
    for part in parts:
        name = dataset_facts(part.dataset.name).training_set
        if seen is None or name not in TRAINING_SETS.values():
            return None
        apart = part.part.keys == "training" or getattr(part.dataset, "leaves_out_evaluated", False)
        sets.append(name + (":train" if apart else ""))
    return "+".join(dict.fromkeys(sets))


def _identity(request: Request, parts: Sequence[OpenPart]) -> dict[str, Any]:
    """What decides the weights, besides those it begins with."""
    keys = hashlib.blake2b(digest_size=8)
    for part in parts:
        keys.update("\x1f".join((part.dataset.name, part.part.spelled(), *part.keys)).encode())
    return {
        "recipe": request.recipe.digest(),
        "seed": request.seed,
        "options": {key: str(value) for key, value in request.options},
        "data": keys.hexdigest(),
        "corruptions": [*request.corrupt, request.corrupt_probability] if request.corrupt else [],
    }


def _check_same(folder: Path, asked: dict[str, Any], held: dict[str, Any]) -> None:
    differing = ", ".join(key for key, value in asked.items() if held.get(key) != value)
    if differing:
        raise RunError(
            f"{folder} holds a training that differs in: {differing}; give the options it was started with, or another "
            "--output"
        )


def _check_process(recipe: Recipe, process: Process) -> None:
    if recipe.batch % process.world:
        raise UsageError(
            f"a batch of {recipe.batch} cannot be parted over {process.world} processes; give another --batch-size"
        )
    if recipe.precision == "fp16" and process.device.type == "cpu":
        raise UsageError(
            f"recipe '{recipe.stage}' of {recipe.method} computes in fp16, which needs a GPU; give --precision fp32 or "
            "bf16"
        )


def _corruption(request: Request) -> CorruptionTransform | None:
    if not request.corrupt:
        return None
    return CorruptionTransform(list(request.corrupt), probability=request.corrupt_probability, seed=request.seed)


def _validator(model: NetworkModel, folder: Path, request: Request) -> Callable[[int], dict[str, float]] | None:
    if request.validate is None:
        return None
    return validator(
        model,
        folder,
        request.validate,
        request.validate_data,
        request.validate_corruptions,
        request.validate_limit,
    )
