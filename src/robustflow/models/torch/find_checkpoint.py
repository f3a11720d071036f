"""Locate a checkpoint: a given path, or the cached download of a published name."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from pathlib import Path

from ...core.errors import ModelError, first_line, unknown_name
from ...core.paths import user_path

SOURCES = {"ptlflow": "the authors' file", "torchvision": "a file from https://download.pytorch.org/models"}
"""Source of the published weights of library models, for messages."""

RANDOM = "random"
"""Value of `checkpoint` for seeded random weights, which are used in tests and for measuring cost."""


def refuse_missing_file(
    model: str, checkpoint: str | Path | None, published: Collection[str], source: str, *, strict: bool = True
) -> None:
    """Raise an error if the given checkpoint does not exist. This check is done before heavy libraries are imported."""
    if checkpoint is None or str(checkpoint) in (RANDOM, *published) or user_path(checkpoint).exists():
        return
    path = Path(checkpoint)
    if not path.suffix and len(path.parts) == 1 and (published or not strict):
        if strict:
            raise unknown_name(f"checkpoint of {model}", str(checkpoint), [*published, RANDOM])
        return
    raise ModelError(f"model '{model}': there is no file {checkpoint}; {_get(published, source)}, and put it there")


def find_checkpoint(
    model: str, checkpoint: str | Path | None, published: Mapping[str, str], source: str
) -> tuple[Path, str | None]:
    """Return the file of a checkpoint; published checkpoints are downloaded to PyTorch's cache unless they are already
    there.
    """
    if checkpoint is None:
        raise needs_checkpoint(model, published, source)
    if str(checkpoint) in published:
        return _cached(model, published[str(checkpoint)])
    refuse_missing_file(model, checkpoint, published, source)
    return user_path(checkpoint), None


def needs_checkpoint(model: str, published: Collection[str], source: str) -> ModelError:
    """Return the error for a network without weights."""
    return ModelError(
        f"model '{model}' needs its checkpoint: {_get(published, source)}, and pass its path as --checkpoint"
    )


def _get(published: Collection[str], source: str) -> str:
    return f"choose one of {', '.join(published)}, or get {source}" if published else f"get {source}"


def _cached(model: str, url: str) -> tuple[Path, str | None]:
    import torch

    name = url.rpartition("/")[2]
    path = Path(torch.hub.get_dir()) / "checkpoints" / name
    stated = re.search(r"-([0-9a-f]{8,64})\.\w+$", name)
    prefix = stated[1] if stated else None
    if not path.exists():
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            torch.hub.download_url_to_file(url, str(path), hash_prefix=prefix, progress=False)
        except Exception as error:  # connection, permission and hash errors raise different exceptions
            reason = getattr(error, "reason", None) or first_line(error)
            raise ModelError(
                f"model '{model}': cannot download {url} ({reason}); save that file as {path}, or pass the path of a "
                "copy "
                "as --checkpoint"
            ) from None
    return path, prefix
