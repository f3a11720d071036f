"""Read a checkpoint file safely: it is treated as an untrusted download that should contain only tensors."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO

import safetensors.torch
import torch
from torch import Tensor

from ...core.errors import ModelError
from ...core.paths import user_path
from ...core.pickle_scan import IGNORED, RefusedError, scan_torch_file
from ..model_file import damaged, opened


class _Unread:
    """A placeholder for objects that training scripts store with the weights; it ignores all its arguments."""

    def __new__(cls, *args: Any) -> _Unread:
        return super().__new__(cls)

    def __setstate__(self, state: Any) -> None:
        pass


HELD_AS = ("state_dict", "model_state_dict", "model")
"""Keys under which checkpoint files store the weights."""

TRAINED_ON = "robustflow_trained_on"
"""Key under which `robustflow train` stores the training sets of the weights."""


@dataclass(frozen=True)
class Checkpoint:
    """The contents of a checkpoint file."""

    path: Path
    sha256: str
    weights: dict[str, Tensor]
    hyper_parameters: dict[str, Any] = field(default_factory=dict)
    trained_on: str | None = None


def read_checkpoint(path: str | Path, sha256: str | None = None) -> Checkpoint:
    """Read a safetensors file, or a file saved with `torch.save`: a state dict, or a dict that contains one under a key
    in `HELD_AS`.
    """
    path = user_path(path)
    content, digest = read_content(path, sha256)
    hyper_parameters = content.get("hyper_parameters") if isinstance(content, dict) else None
    declared = content.get(TRAINED_ON) if isinstance(content, dict) else None
    return Checkpoint(
        path,
        digest,
        _weights(path, content),
        hyper_parameters if isinstance(hyper_parameters, dict) else {},
        declared if isinstance(declared, str) else None,
    )


def read_content(path: Path, sha256: str | None = None) -> tuple[Any, str]:
    """Return the contents of a file, read with the same checks, and the file's SHA-256."""
    with opened(path, sha256) as (file, digest):
        if _is_safetensors(file):
            return _load_safetensors(path, file), digest
        _check(path, file)
        return _load(path, file), digest


def _is_safetensors(file: BinaryIO) -> bool:
    """Return whether a file starts like safetensors: the length of its header in 8 bytes, then the header in JSON."""
    start = file.read(9)
    file.seek(0)
    return start[4:] == b"\0\0\0\0{"


def _load_safetensors(path: Path, file: BinaryIO) -> dict[str, Tensor]:
    try:
        return safetensors.torch.load(file.read())
    except Exception as error:  # SafetensorError, or KeyError for a data type that PyTorch does not have
        raise damaged(path, error) from None


def _check(path: Path, file: BinaryIO) -> None:
    """Raise unless PyTorch can read the file at a cost that its size bounds, and without running code."""
    try:
        scan_torch_file(file)
    except RefusedError as error:
        raise ModelError(
            path,
            f"not loaded, because it contains more than plain weights ({str(error)[:200]}), which may run "
            "code or exhaust the memory; use the authors' file, or, if you trust this one, save only its state_dict "
            "with torch.save",
        ) from None
    except Exception as error:  # the parsers of zip files and pickles raise any exception on a damaged file
        raise damaged(path, error) from None


def _load(path: Path, file: BinaryIO) -> Any:
    try:
        with warnings.catch_warnings(), torch.serialization.safe_globals([(_Unread, name) for name in IGNORED]):
            warnings.simplefilter("ignore")  # pickle protocol warnings; unreadable files raise an error anyway
            return torch.load(file, weights_only=True, map_location="cpu")
    except Exception as error:  # torch has no specific exception type for truncated or inconsistent files
        raise damaged(path, error) from None


def _weights(path: Path, content: Any) -> dict[str, Tensor]:
    for _ in HELD_AS:
        entries = content if isinstance(content, dict) else {}
        content = next((entries[name] for name in HELD_AS if isinstance(entries.get(name), dict)), content)
    if not isinstance(content, dict) or not content:
        raise ModelError(path, f"contains {type(content).__name__}, not named weights; save the network's state_dict()")
    for key, value in content.items():
        if not (isinstance(key, str) and isinstance(value, Tensor)):
            what = f"{type(value).__name__}, not a tensor" if isinstance(key, str) else "under a non-string key"
            raise ModelError(
                path,
                f"entry {str(key)[:60]!r} is {what}; expected a state dict, or a dict that contains one under "
                "one of the keys "
                f"{', '.join(HELD_AS)}",
            )
    return dict(content)
