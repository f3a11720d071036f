"""The training loop and its log: from the next update to the last, with checkpoints from which it can resume exactly.

The loop uses plain PyTorch: the features of a training library (launching, precision, clipping) need only a few lines,
while exact resuming requires control over the order of the data, the random numbers and the checkpoints. The log has
one line of JSON per update, and files for TensorBoard if it is installed.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, nullcontext
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from types import TracebackType
from typing import Any

import torch
from torch import nn
from torch.nn.parallel import DistributedDataParallel

from ..core.display import ProgressBar
from ..core.errors import DataError, ModelError, RobustFlowError, class_and_message
from ..core.files import write_bytes
from ..core.rng import key_of
from ..models.calls import traceback_hint
from .checkpoint import BEST, LAST, TrainingProgress, save_training, save_weights
from .data.loader import Batch, Share, batches
from .data.training_pairs import TrainingPairs
from .draws import prepared
from .network_with_loss import NetworkWithLoss
from .optimization import rate_of, set_rate
from .processes import Process
from .recipe import Recipe
from .request import Request
from .trained_network import TrainedNetwork, learning_parameters
from .unsupervised.methods import TrainingStep
from .validate import ValidationScores

METRICS_FILE = "metrics.jsonl"
_VALIDATION = '"validation_epe"'


class MetricsLog:
    """A context manager that appends to `metrics.jsonl`."""

    def __init__(self, folder: Path, first: int, validates: bool = False) -> None:
        self._path = folder / METRICS_FILE
        if self._path.exists():
            text = self._path.read_text(encoding="utf-8", errors="replace")  # a crash may leave any bytes
            again = first - validates
            lines = [line for line in text.splitlines() if _update(line) < (again if _VALIDATION in line else first)]
            write_bytes(self._path, "".join(f"{line}\n" for line in lines).encode())
        try:
            self._file = open(self._path, "a", encoding="utf-8")  # noqa: SIM115  # closed by __exit__
        except OSError as error:
            raise DataError(self._path, f"cannot be written ({error.strerror}); choose a different --output") from error
        self._board: Any = None
        if find_spec("tensorboard") is not None:
            from torch.utils.tensorboard import SummaryWriter

            self._board = SummaryWriter(str(folder / "tensorboard"), purge_step=first)

    def __enter__(self) -> MetricsLog:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._file.close()
        if self._board is not None:
            self._board.close()

    def write(self, update: int, values: dict[str, float]) -> None:
        """Write one line for an update, or for a validation after it. Values that are NaN or infinite, such as the EPE
        of pairs without valid pixels, are null, because JSON has no such numbers.
        """
        try:
            numbers = {name: value if math.isfinite(value) else None for name, value in values.items()}
            line = {"update": update} | numbers | {"update": update}  # a user's loss may return a value of this name
            self._file.write(json.dumps(line, allow_nan=False) + "\n")
            self._file.flush()
        except OSError as error:
            raise DataError(
                self._path, f"cannot be written ({error.strerror}); free up disk space and resume"
            ) from error
        if self._board is not None:
            for name, value in values.items():
                self._board.add_scalar(name, value, update)


def _update(line: str) -> float:
    """Return the update number of a line; an incomplete line counts as the last one."""
    try:
        return int(json.loads(line)["update"])
    except (ValueError, KeyError, TypeError):
        return float("inf")


@dataclass(frozen=True)
class TrainingSetup:
    """Everything that the loop needs, except the state that changes during training."""

    request: Request
    folder: Path
    trained_on: str | None
    pairs: TrainingPairs
    validate: Callable[[int], ValidationScores] | None = None
    stop: Callable[[], bool] = lambda: False


@dataclass
class TrainingState:
    """The state that changes during training."""

    network: TrainedNetwork
    optimizer: torch.optim.Optimizer
    scaler: torch.amp.GradScaler
    done: TrainingProgress


def train(training: TrainingSetup, state: TrainingState, process: Process, progress: ProgressBar) -> None:
    """Perform the remaining updates."""
    request, network = training.request, state.network
    recipe, checkpoints = request.recipe, request.checkpoints
    called: nn.Module = NetworkWithLoss(network, recipe)
    if process.world > 1:
        called = DistributedDataParallel(called, find_unused_parameters=True)  # GMA has unused parameters
    first, last = state.done.updates, recipe.updates
    share = Share(recipe.batch, process.rank, process.world)
    steps = range(first * recipe.accumulate, last * recipe.accumulate)
    network.train()
    leads = process.rank == 0
    with (
        closing(batches(training.pairs, share, steps, request.data.loaders)) as stream,  # ends its children
        MetricsLog(training.folder, first, _lacks_validation(training, state)) if leads else nullcontext() as log,
        progress,
    ):
        progress.start("update", last, first)
        if log is not None:
            _validate(training, state, log)
        for update in range(first, last):
            began = time.perf_counter()
            rate = rate_of(recipe, update)
            set_rate(state.optimizer, rate)
            numbers = _update_weights(called, state, stream, training, share, update)
            state.done = replace(state.done, updates=update + 1)
            numbers |= {"rate": rate, "seconds": round(time.perf_counter() - began, 4)}
            if log is not None:
                log.write(update, numbers)
                shown = f"loss {numbers['loss']:.3g}, EPE {numbers['epe']:.3g} px" if "epe" in numbers else ""
                progress.update("update", update + 1, shown)
            stopped = process.any(training.stop())
            if leads and (stopped or _due(update + 1, checkpoints.every, last) or _lacks_validation(training, state)):
                _save(training, state)
            if leads and checkpoints.keep_every and (update + 1) % checkpoints.keep_every == 0:
                path = training.folder / f"update-{update + 1}.pth"
                save_weights(path, network.weights(), state.done, training.trained_on)
            if stopped:
                return
            if log is not None:
                _validate(training, state, log)


def _update_weights(
    called: nn.Module, state: TrainingState, stream: Iterator[Batch], training: TrainingSetup, share: Share, update: int
) -> dict[str, float]:
    """Update the weights once, and return the values for the log."""
    recipe, seed, device = training.request.recipe, training.request.seed, next(called.parameters()).device
    state.optimizer.zero_grad(set_to_none=True)
    total: dict[str, float] = {}
    for part in range(recipe.accumulate):
        number = update * recipe.accumulate + part
        positions = share.positions(number)
        batch = next(stream)
        torch.manual_seed(key_of(seed, "network", number, share.rank) % 2**63)
        step = TrainingStep(seed, number, tuple(positions), update / recipe.updates)
        last = part == recipe.accumulate - 1
        with nullcontext() if last or share.world == 1 else called.no_sync(), _computing(recipe, update):
            batch = prepared(batch.to(device), recipe, seed, number, positions)
            loss, numbers = called(batch, step)
            numbers["loss"] = loss.item()
            _check_finite("loss", numbers["loss"], update, batch)
            if not loss.requires_grad:
                raise ModelError(
                    "loss", "it does not depend on any trained weight; compute it from the network's output"
                )
            state.scaler.scale(loss / recipe.accumulate).backward()
        for name, value in numbers.items():
            total[name] = total.get(name, 0.0) + value / recipe.accumulate
    state.scaler.unscale_(state.optimizer)
    clip = recipe.optimizer.clip
    norm = nn.utils.clip_grad_norm_(learning_parameters(state.network), clip if clip is not None else math.inf)
    if not state.scaler.is_enabled():  # with loss scaling, overflows are expected; the update is skipped
        _check_finite("gradient", norm.item(), update, batch)
    state.scaler.step(state.optimizer)
    state.scaler.update()
    return {**total, "gradient_norm": norm.item()}


@contextmanager
def _computing(recipe: Recipe, update: int) -> Iterator[None]:
    """Raise a ModelError for any error of the network or its loss."""
    try:
        yield
    except RobustFlowError:
        raise
    except Exception as error:  # any operator can fail
        advice = "correct the network or its loss, or try a larger --crop"
        if isinstance(error, torch.OutOfMemoryError):
            advice = "use a smaller --batch-size (with --accumulate), a smaller --crop or --precision bf16"
        reason = f"{class_and_message(error)[:300]}{traceback_hint(error)}"
        raise ModelError(
            recipe.method,
            f"fails at update {update} on crops of {recipe.crop[0]}x{recipe.crop[1]} ({reason}); the "
            f"last checkpoint is kept: {advice}",
        ) from error


def _check_finite(what: str, value: float, update: int, batch: Batch) -> None:
    if not math.isfinite(value):
        raise ModelError(
            what,
            f"{value} at update {update}, on {', '.join(batch.names)}; the last checkpoint is kept: "
            "try a lower --learning-rate or --precision fp32, or check these pairs",
        )


def _due(update: int, every: int | None, last: int) -> bool:
    return every is not None and (update % every == 0 or update == last)


def _lacks_validation(training: TrainingSetup, state: TrainingState) -> bool:
    """Return whether a validation is due after the last update; a run that was stopped before it makes up for it."""
    request, done = training.request, state.done
    return done.validated < done.updates and _due(done.updates, request.validate_every, request.recipe.updates)


def _validate(training: TrainingSetup, state: TrainingState, log: MetricsLog) -> None:
    """Validate the network if it is due. The checkpoint of the last update has been saved, because a validation may
    fail."""
    if training.validate is None or not _lacks_validation(training, state):
        return
    state.network.eval()
    scores = training.validate(state.done.updates)
    state.network.train()
    log.write(state.done.updates - 1, {f"validation_{name}": value for name, value in scores.numbers.items()})
    error = scores.numbers["epe"]
    state.done = replace(state.done, validated=state.done.updates)
    if state.done.best is None or state.done.best_on != scores.pairs or error < state.done.best:
        state.done = replace(state.done, best=error, best_on=scores.pairs)
        save_weights(training.folder / BEST, state.network.weights(), state.done, training.trained_on)
    _save(training, state)


def _save(training: TrainingSetup, state: TrainingState) -> None:
    weights = state.network.weights()
    save_training(training.folder / LAST, weights, state.done, training.trained_on, state.optimizer, state.scaler)
