"""Save checkpoints of a training run: everything needed to resume it, in a file that `run --checkpoint` can also read.
`python -m robustflow.training.checkpoint` converts trained weights to a file that is distributed with the package.

`last.pth` contains weights, optimiser, loss scaling and the number of updates; it needs no random state, because every
random draw is a function of the seed and the step. Files that contain only weights (`best.pth`, `update-N.pth`) contain
the entries needed for prediction. Each file contains a digest of its entries, and is checked when it is read, like any
untrusted checkpoint.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import torch
from safetensors.torch import save
from torch import Tensor

from ..core.errors import ModelError, RunError, first_line
from ..core.files import quick_digest_of_bytes, write_bytes, write_with
from ..models.torch.checkpoint import TRAINED_ON, read_content

LAST = "last.pth"
BEST = "best.pth"
_ABOUT = "robustflow_training"
_DIGEST = "robustflow_digest"
_RESTORE = "restore it, or start a new training from a weights file with --init"
_STATE = ("model", "optimizer", "scaler")


@dataclass(frozen=True)
class TrainingProgress:
    """The progress of a training run."""

    updates: int
    identity: dict[str, Any]
    best: float | None = None
    best_on: str = ""
    validated: int = 0


def save_weights(path: Path, weights: dict[str, Tensor], about: TrainingProgress, trained_on: str | None) -> None:
    """Write weights and their provenance atomically."""
    write_with(path, lambda file: _save(_content(weights, about, trained_on), file))


def save_training(
    path: Path,
    weights: dict[str, Tensor],
    about: TrainingProgress,
    trained_on: str | None,
    optimizer: torch.optim.Optimizer,
    scaler: torch.amp.GradScaler,
) -> None:
    """Write a checkpoint with everything needed to resume training."""
    state = {"optimizer": optimizer.state_dict(), "scaler": scaler.state_dict()}
    write_with(path, lambda file: _save({**_content(weights, about, trained_on), **state}, file))


def read_progress(path: Path) -> tuple[dict[str, Any], TrainingProgress]:
    """Read a file written by `save_training`; return its entire content and the progress."""
    if not path.exists():
        raise RunError(path.parent, f"no training run to resume ({path.name} not found); start one without --resume")
    try:
        content, _ = read_content(path)
    except ModelError as error:
        raise ModelError(path, f"{str(error.args[-1]).partition(';')[0]}; {_RESTORE}") from error
    if not isinstance(content, dict) or not {_ABOUT, *_STATE} <= content.keys():
        raise RunError(path, f"contains weights but no training state; start from the weights with --init {path}")
    try:
        _refuse_views(content, path.stat().st_size)
        if content.pop(_DIGEST, None) != _digest(content):
            raise ValueError("its content does not match its digest")
        about = json.loads(content[_ABOUT])
        best = None if about["best"] is None else float(about["best"])
        if any(not isinstance(content[name], dict) for name in _STATE):
            raise ValueError("its parts have the wrong types")
        updates, validated = int(about["updates"]), int(about["validated"])
        return content, TrainingProgress(updates, dict(about["identity"]), best, str(about["best_on"]), validated)
    except (KeyError, TypeError, ValueError, RuntimeError, RecursionError) as error:
        raise ModelError(path, f"damaged ({first_line(error)}); {_RESTORE}") from error


def _save(content: dict[str, Any], file: BinaryIO) -> None:
    try:
        torch.save({**content, _DIGEST: _digest(content)}, file)
    except RuntimeError as error:
        # On a full disk, torch fails twice: on a write, and again when it closes the incomplete archive.
        if isinstance(error.__context__, OSError):
            raise error.__context__ from None
        raise


def _digest(content: dict[str, Any]) -> str:
    return quick_digest_of_bytes(*_encoded(content))


def _encoded(value: Any) -> Iterator[bytes | memoryview]:
    """Encode a value as a unique byte string."""
    if isinstance(value, Tensor):
        yield f"{value.dtype}{tuple(value.shape)}".encode()
        if value.numel():
            yield memoryview(value.detach().cpu().contiguous().reshape(-1).view(torch.uint8).numpy())
    elif isinstance(value, dict):
        yield f"dict {len(value)}".encode()
        for key, part in value.items():
            yield from _encoded(key)
            yield from _encoded(part)
    elif isinstance(value, list | tuple):
        yield f"{type(value).__name__} {len(value)}".encode()
        for part in value:
            yield from _encoded(part)
    elif value is None or isinstance(value, bool | int | float | str):
        yield f"{type(value).__name__} {value!r};".encode()
    else:
        raise TypeError(f"it contains a {type(value).__name__}")


def _refuse_views(content: Any, size: int) -> None:
    """Raise if the tensors are larger than their file: a view of a few values can have any shape, and copying it would
    allocate memory for its full size. A module that a network registers under several names is stored once, and
    counts once."""
    views = {
        (tensor.data_ptr(), tensor.dtype, tensor.shape, tensor.stride()): tensor.nbytes for tensor in _tensors(content)
    }
    if sum(views.values()) > size:
        raise ValueError("its tensors are larger than the file")


def _tensors(value: Any) -> Iterator[Tensor]:
    if isinstance(value, Tensor):
        yield value
    elif isinstance(value, dict | list | tuple):
        for part in value.values() if isinstance(value, dict) else value:
            yield from _tensors(part)


def _content(weights: dict[str, Tensor], about: TrainingProgress, trained_on: str | None) -> dict[str, Any]:
    entries: dict[str, Any] = {
        "model": weights,
        _ABOUT: json.dumps(vars(about), sort_keys=True),
    }
    return entries if trained_on is None else {**entries, TRAINED_ON: trained_on}


def ship_weights(checkpoint: Path, target: Path, command: str, commit: str) -> None:
    """Write weights as safetensors, with the settings that determine them."""
    content, about = read_progress(checkpoint)
    record = {
        "made_by": command,
        "commit": commit,
        "updates": str(about.updates),
        "training": json.dumps(about.identity, sort_keys=True),
    }
    write_bytes(target, save({key: value.contiguous() for key, value in content["model"].items()}, record))


if __name__ == "__main__":
    if len(sys.argv) != 5:
        sys.exit("usage: python -m robustflow.training.checkpoint CHECKPOINT TARGET.safetensors 'COMMAND' COMMIT")
    ship_weights(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3], sys.argv[4])
