"""Where a checkpoint is: the given path, or the cache for one that is published under a name."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from pathlib import Path

from ...errors import ModelError, first_line, unknown_name

SOURCES = {"ptlflow": "the authors' file", "torchvision": "a file of https://download.pytorch.org/models"}
"""Where the weights of a library's networks are published, for messages."""

RANDOM = "random"
"""Instead of a checkpoint: seeded random weights, for measuring cost and for tests."""


def refuse_missing_file(
    model: str, checkpoint: str | Path | None, published: Collection[str], source: str, *, strict: bool = True
) -> None:
    """Raise if a given checkpoint does not exist. It needs no library, so it is called before their imports.

    Args:
        model: for messages.
        checkpoint: a path, a name among `published`, "random", or None, which passes.
        published: names of checkpoints that can be fetched.
        source: which file is meant and where its authors publish it.
        strict: `published` is complete, so any other name is unknown.

    Raises:
        ModelError: no such file.
        UsageError: a name that is not published.
    """
    if checkpoint is None or str(checkpoint) in (RANDOM, *published) or Path(checkpoint).expanduser().exists():
        return
    path = Path(checkpoint)
    if not path.suffix and len(path.parts) == 1 and (published or not strict):
        if strict:
            raise unknown_name(f"checkpoint of {model}", str(checkpoint), [*published, RANDOM])
        return
    raise ModelError(f"model '{model}': no file {checkpoint}; {_get(published, source)}, and put it there")


def find_checkpoint(
    model: str, checkpoint: str | Path | None, published: Mapping[str, str], source: str
) -> tuple[Path, str | None]:
    """The file of a checkpoint, downloaded into PyTorch's cache if it is published by name and not there yet.

    A name takes precedence over a file of the same name in the current folder, for which write `./NAME`.

    Args:
        model: for messages.
        checkpoint: a path, or a name among `published`.
        published: addresses by name; a file name that ends in `-XXXXXXXX.ext` states the beginning of its SHA-256.
        source: which file is meant and where its authors publish it.

    Returns:
        The path, and the digits that its SHA-256 must begin with, or None if they are not known.

    Raises:
        ModelError: no checkpoint, no such file, or one that cannot be downloaded; it says where to put it.
        UsageError: a name that is not published.
    """
    if checkpoint is None:
        raise needs_checkpoint(model, published, source)
    if str(checkpoint) in published:
        return _cached(model, published[str(checkpoint)])
    refuse_missing_file(model, checkpoint, published, source)
    return Path(checkpoint).expanduser(), None


def needs_checkpoint(model: str, published: Collection[str], source: str) -> ModelError:
    """The error for a network without weights."""
    return ModelError(
        f"model '{model}' needs its checkpoint: {_get(published, source)}, and give its path as --checkpoint"
    )


def _get(published: Collection[str], source: str) -> str:
    return f"name one of {', '.join(published)}, or get {source}" if published else f"get {source}"


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
        except Exception as error:  # no connection, no permission, a wrong hash: each raises a different exception
            reason = getattr(error, "reason", None) or first_line(error)
            raise ModelError(
                f"model '{model}': cannot fetch {url} ({reason}); put that file at {path}, or give the path of a copy "
                "as --checkpoint"
            ) from None
    return path, prefix
