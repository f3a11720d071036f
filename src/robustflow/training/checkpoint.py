"""Checkpoints of a training: everything needed to continue, in a file that `run --checkpoint` can also read.

`last.pth` holds weights, optimiser, loss scaling and the number of updates; random numbers have no state, because every
draw is a function of the seed and the step. Files with weights only (`best.pth`, `update-N.pth`) hold the same entries
without the rest. All are read with `weights_only=True`.
"""

from __future__ import annotations

import json
import pickle
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import torch
from torch import Tensor

from ..atomic import write_with
from ..errors import ModelError, RunError, first_line
from ..models.torch.checkpoint import TRAINED_ON

LAST = "last.pth"
BEST = "best.pth"
_ABOUT = "robustflow_training"


@dataclass(frozen=True)
class Progressed:
    """The progress of a training.

    Attributes:
        updates: number made so far.
        identity: what determines the weights: recipe, seed, data.
        best: the smallest validation error so far, pixels; None before the first validation.
    """

    updates: int
    identity: dict[str, Any]
    best: float | None = None


def save_weights(path: Path, weights: dict[str, Tensor], about: Progressed, trained_on: str | None) -> None:
    """Write weights and their origin, completely or not at all.

    Raises:
        DataError: the folder cannot be written, or the disk is full.
    """
    write_with(path, lambda file: _save(_content(weights, about, trained_on), file))


def save_training(
    path: Path,
    weights: dict[str, Tensor],
    about: Progressed,
    trained_on: str | None,
    optimizer: torch.optim.Optimizer,
    scaler: torch.amp.GradScaler,
) -> None:
    """Likewise, with everything needed to continue."""
    state = {"optimizer": optimizer.state_dict(), "scaler": scaler.state_dict()}
    write_with(path, lambda file: _save({**_content(weights, about, trained_on), **state}, file))


def read_progress(path: Path) -> tuple[dict[str, Any], Progressed]:
    """Read what `save_training` wrote: the complete content, and the progress.

    Raises:
        RunError: no such file, or one that no training wrote.
        ModelError: it is damaged.
    """
    try:
        content = torch.load(path, weights_only=True, map_location="cpu")
    except FileNotFoundError:
        raise RunError(f"{path.parent}: no training to resume (no {path.name}); start one without --resume") from None
    except (RuntimeError, OSError, EOFError, ValueError, pickle.UnpicklingError) as error:
        raise ModelError(
            f"{path} is damaged ({first_line(error)}); restore it, or start again from a file of weights"
        ) from error
    try:
        about = json.loads(content[_ABOUT])
        return content, Progressed(int(about["updates"]), dict(about["identity"]), about["best"])
    except (KeyError, TypeError, ValueError) as error:
        raise RunError(
            f"{path} holds weights but no training to continue; start from them with --init {path}"
        ) from error


def _save(content: dict[str, Any], file: BinaryIO) -> None:
    try:
        torch.save(content, file)
    except RuntimeError as error:
        # Where the disk is full torch fails twice: on a write, and again when it closes the archive that was cut short.
        if isinstance(error.__context__, OSError):
            raise error.__context__ from None
        raise


def _content(weights: dict[str, Tensor], about: Progressed, trained_on: str | None) -> dict[str, Any]:
    entries: dict[str, Any] = {
        "model": weights,
        _ABOUT: json.dumps({"updates": about.updates, "identity": about.identity, "best": about.best}, sort_keys=True),
    }
    return entries if trained_on is None else {**entries, TRAINED_ON: trained_on}
