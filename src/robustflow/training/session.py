"""Set up and run training from a user's request."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any

import torch
from filelock import FileLock, Timeout

from ..core.display import ProgressBar
from ..core.errors import ModelError, RunError, UsageError, first_line
from ..core.files import TEMPORARY, digest_of_bytes, make_folder, write_json
from ..core.paths import refuse_links, user_path
from ..data.datasets import dataset_facts
from ..models.provenance import TRAINING_SETS, training_of
from ..models.torch.build import RANDOM
from .checkpoint import LAST, TrainingProgress, read_progress
from .data.parts import OpenPart, Order, open_part
from .data.training_pairs import TrainingPairs
from .loop import TrainingSetup, TrainingState, train
from .optimization import build_optimizer
from .processes import Process, this_process
from .recipe import Recipe, mix_parts
from .request import Request
from .trained_network import TrainedNetwork, load_network
from .validate import validator


def run_training(request: Request, stop: Callable[[], bool] = lambda: False) -> Path:
    """Train from the start or from the last checkpoint, and return the path of the new last checkpoint."""
    recipe, folder = request.recipe, user_path(request.output)
    parts = [open_part(part, request.data.sources, recipe.objective is None) for part in mix_parts(recipe.mix)]
    order = Order(sum(map(len, parts)), recipe.batch * recipe.accumulate, request.seed)
    pairs = TrainingPairs(
        parts,
        order,
        recipe.crop,
        request.seed,
        request.data.corruption(request.seed),
        request.data.skip_bad,
        recipe.objective,
    )
    content, done = _last_checkpoint(folder, request)
    with this_process(request.device) as process:
        _check_process(recipe, process)
        start = RANDOM if request.resume else _start(request)
        # Each process already corresponds to one device of the original training.
        share = recipe.changed(devices=max(1, recipe.devices // process.world))
        model, network = load_network(share, start, str(process.device), dict(request.options), request.seed)
        identity = _identity(request, parts)
        if done is None:
            done = TrainingProgress(0, {**identity, **_start_record(model, request)})
        _check_same(folder, identity, done.identity)
        optimizer = build_optimizer(network, recipe)
        scaler = torch.amp.GradScaler(process.device.type, enabled=recipe.precision == "fp16")
        if content is not None:
            _load_state(folder / LAST, content, network, optimizer, scaler)
        training = TrainingSetup(
            request=request,
            folder=folder,
            trained_on=_trained_on(done.identity["start_trained_on"], parts),
            pairs=pairs,
            validate=validator(model, request.validation) if request.validation else None,
            stop=stop,
        )
        with _locked(folder) if process.rank == 0 else nullcontext():
            if process.rank == 0 and not request.resume:
                write_json(folder / "recipe.json", {**recipe.model_dump(mode="json"), "training": done.identity})
            train(training, TrainingState(network, optimizer, scaler, done), process, ProgressBar(process.rank == 0))
    return folder / LAST


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Create the folder of a training run, lock it until the process ends, and remove half-written files of a killed
    run."""
    make_folder(folder)
    try:
        lock = FileLock(folder / ".lock", fallback_to_soft=False).acquire(blocking=False)
    except Timeout:
        raise RunError(
            folder, "locked by another training run; wait for it to end, or choose a different --output"
        ) from None
    with lock:
        for unfinished in folder.glob(f"{TEMPORARY}*"):
            unfinished.unlink()
        yield


def _last_checkpoint(folder: Path, request: Request) -> tuple[dict[str, Any] | None, TrainingProgress | None]:
    """Return the last checkpoint's content if training is resumed."""
    refuse_links(folder, "tensorboard")
    if request.resume:
        return read_progress(folder / LAST)
    if (folder / LAST).exists():
        raise UsageError(folder, "contains a training run; continue it with --resume, or choose a different --output")
    return None, None


def _load_state(
    path: Path,
    content: dict[str, Any],
    network: TrainedNetwork,
    optimizer: torch.optim.Optimizer,
    scaler: torch.amp.GradScaler,
) -> None:
    """Load the last checkpoint's content."""
    try:
        network.load_weights(content["model"])
        optimizer.load_state_dict(content["optimizer"])
        scaler.load_state_dict(content["scaler"])
    except (AttributeError, KeyError, TypeError, ValueError, RuntimeError) as error:
        raise ModelError(
            path,
            f"does not match this network and its optimiser ({first_line(error)}); restore it, or restart from "
            "a weights file",
        ) from error


def _start(request: Request) -> str:
    recipe = request.recipe
    if request.start is None and recipe.start != RANDOM:
        raise UsageError(
            "--init",
            f"recipe '{recipe.stage}' of {recipe.method} starts from the weights of its stage '{recipe.start}': give "
            "their file, or 'random' to train from scratch",
        )
    return request.start or RANDOM


def _start_record(model: Any, request: Request) -> dict[str, Any]:
    """Return the initial weights, and the names of their training sets, or None if unknown."""
    checkpoint = str(model.identity()["checkpoint"])
    if _start(request) == RANDOM and request.start_trained_on is None:
        return {"start": checkpoint, "start_trained_on": []}
    sets = training_of(model.identity(), request.start_trained_on or model.trained_on).sets
    return {"start": checkpoint, "start_trained_on": None if sets is None else list(sets)}


def _trained_on(seen: list[str] | None, parts: Sequence[OpenPart]) -> str | None:
    """Return all training sets of the final weights, formatted as for `--trained-on`; None if some are unknown."""
    sets = list(seen or [])
    for part in parts:
        name = dataset_facts(part.dataset.name).training_set
        if seen is None or name not in TRAINING_SETS.values():
            return None
        disjoint = part.part.keys == "training" or getattr(part.dataset, "leaves_out_evaluated", False)
        sets.append(name + (":train" if disjoint else ""))
    return "+".join(dict.fromkeys(sets))


def _identity(request: Request, parts: Sequence[OpenPart]) -> dict[str, Any]:
    """Return everything that determines the final weights, except the initial weights."""
    keys = ("\x1f".join((part.dataset.name, part.part.model_dump_json(), *part.keys)).encode() for part in parts)
    return {
        "recipe": request.recipe.digest(),
        "seed": request.seed,
        "options": {key: str(value) for key, value in request.options},
        "data": digest_of_bytes(*keys, size=8),
        "corruptions": [*request.data.corruptions, request.data.probability] if request.data.corruptions else [],
    }


def _check_same(folder: Path, asked: dict[str, Any], held: dict[str, Any]) -> None:
    differing = ", ".join(key for key, value in asked.items() if held.get(key) != value)
    if differing:
        raise RunError(
            differing,
            f"the training run in {folder} differs; use the options that it was started with, or a different --output",
        )


def _check_process(recipe: Recipe, process: Process) -> None:
    if recipe.batch % process.world:
        raise UsageError(
            "--batch-size", f"{recipe.batch} cannot be split evenly across {process.world} processes; choose another"
        )
    if recipe.precision == "fp16" and process.device.type == "cpu":
        raise UsageError(
            "--precision",
            f"recipe '{recipe.stage}' of {recipe.method} computes in fp16, which requires a GPU; use fp32 or bf16",
        )
