"""Find the checkpoint of a PyTorch network, build the network, and load it. Importable without the torch extra."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...core.errors import ModelError, UsageError, first_line, unknown_name
from ...core.paths import user_path
from ...core.plugins import require
from ..catalog import published_names
from ..conventions import InputConvention
from ..execution import Execution

_SEED = ContextVar("seed of random weights", default=0)

if TYPE_CHECKING:
    from .checkpoint import Checkpoint
    from .network_model import NetworkModel


@contextmanager
def weights_seeded(seed: int) -> Iterator[None]:
    """Set the seed for the checkpoint "random" within a `with` block; by default the seed is 0."""
    token = _SEED.set(seed)
    try:
        yield
    finally:
        _SEED.reset(token)


def network_model(
    name: str,
    build: Callable[[], Any],
    convention: InputConvention,
    checkpoint: str | Path | None,
    *,
    source: str,
    sha256: str | None,
    published: Mapping[str, str] | None = None,
    scope: str | None = None,
    settings: Mapping[str, Any] | None = None,
    adapt: Callable[[Any, Checkpoint], Mapping[str, Any]] | None = None,
    confident: bool = False,
    execution: Execution,
) -> NetworkModel:
    """Build a network, load its checkpoint strictly, and wrap it."""
    if checkpoint == RANDOM and sha256 is not None:
        raise UsageError("sha256", "random weights are not read from a file: omit it, or pass a checkpoint")
    published, settings = published or {}, dict(settings or {})
    refuse_missing_file(name, checkpoint, published, source)
    require("torch", f"model '{name}'")
    file = None if checkpoint == RANDOM else find_checkpoint(name, checkpoint, published, source)
    from .checkpoint import load_weights, read_checkpoint
    from .network_model import ConfidentNetwork, NetworkModel

    kind = ConfidentNetwork if confident else NetworkModel
    if file is None:
        seed = {"seed_of_weights": _SEED.get()} if _SEED.get() else {}
        return kind(name, _seeded(build), convention, {"checkpoint": RANDOM, **seed, **settings}, execution)
    path, stated_sha256 = file
    read = read_checkpoint(path, sha256 or stated_sha256)
    net = build()
    if adapt is not None:
        settings |= adapt(net, read)
    cast = load_weights(net, read, name, scope)
    identity = {"checkpoint": read.sha256, **({"weights_cast_from": cast} if cast else {}), **settings}
    model = kind(name, net, convention, identity, execution)
    model.trained_on = read.trained_on
    return model


def _seeded(build: Callable[[], Any]) -> Any:
    import torch

    with torch.random.fork_rng(devices=[]):
        torch.default_generator.manual_seed(_SEED.get())
        return build()


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
    raise ModelError(checkpoint, f"no such file; for model '{model}', {_get(published, source)}, and put it there")


def check_available(model: str, checkpoint: str | Path | None, library: str, source: str, needed: bool = True) -> None:
    """Raise an error if a network's file, library or checkpoint is missing, before heavy libraries are imported."""
    names = published_names(model)
    refuse_missing_file(model, checkpoint, names, source, strict=False)
    require(library, f"model '{model}'")
    if checkpoint is None and needed:
        raise needs_checkpoint(model, names, source)


def find_checkpoint(
    model: str, checkpoint: str | Path | None, published: Mapping[str, str], source: str
) -> tuple[Path, str | None]:
    """Return the file of a checkpoint; a published one is downloaded to PyTorch's cache unless it is there."""
    if checkpoint is None:
        raise needs_checkpoint(model, published, source)
    if str(checkpoint) in published:
        return _cached(model, published[str(checkpoint)])
    refuse_missing_file(model, checkpoint, published, source)
    return user_path(checkpoint), None


def needs_checkpoint(model: str, published: Collection[str], source: str) -> ModelError:
    """Return the error for a network without weights."""
    return ModelError(model, f"the model needs its checkpoint: {_get(published, source)}, and pass it as --checkpoint")


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
            advice = f"save that file as {path}, or pass the path of a copy as --checkpoint"
            raise ModelError(url, f"cannot be downloaded for model '{model}' ({reason}); {advice}") from None
    return path, prefix
