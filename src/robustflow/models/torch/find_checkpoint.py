"""Where a checkpoint lies: the path that was given, or the cache for one that is published under a name."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

from ...errors import ModelError, unknown_name
from .network import RANDOM


def find_checkpoint(
    model: str, checkpoint: str | Path | None, published: Mapping[str, str], source: str
) -> tuple[Path, str | None]:
    """The file of a checkpoint, fetched into PyTorch's cache where it is published by name and not there yet.

    A name goes before a file of the same name in the current folder, which `./NAME` reaches.

    Args:
        model: for messages.
        checkpoint: a path, or a name among `published`.
        published: addresses by name; a file name that ends in `-XXXXXXXX.ext` states the beginning of its SHA-256.
        source: which file is meant and where its authors keep it.

    Returns:
        The path, and the digits its SHA-256 has to begin with, or None where they are not known.

    Raises:
        ModelError: no checkpoint, no such file, or one that cannot be fetched: says where to put it.
        UsageError: a name that is not published.
    """
    names = f"name one of {', '.join(published)}, or get" if published else "get"
    if checkpoint is None:
        raise ModelError(f"model '{model}' needs its checkpoint: {names} {source}, and give its path as --checkpoint")
    if str(checkpoint) in published:
        return _cached(model, published[str(checkpoint)])
    path = Path(checkpoint).expanduser()
    if not path.exists():
        if published and not path.suffix and len(path.parts) == 1:
            raise unknown_name(f"checkpoint of {model}", str(checkpoint), [*published, RANDOM])
        raise ModelError(f"model '{model}': no file {checkpoint}; {names} {source}, and put it there")
    return path, None


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
        except Exception as error:  # no network, no permission, another hash: each has a class of its own
            reason = getattr(error, "reason", None) or next(iter(str(error).splitlines()), type(error).__name__)
            raise ModelError(
                f"model '{model}': cannot fetch {url} ({reason}); put that file at {path}, or give the path of a copy "
                "as --checkpoint"
            ) from None
    return path, prefix
