"""Build a PyTorch network and load its checkpoint. Importable without the torch extra."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...core.errors import UsageError
from ...core.plugins import require
from ..conventions import InputConvention
from ..devices import Execution
from .find_checkpoint import RANDOM, find_checkpoint, refuse_missing_file

_SEED = ContextVar("seed of random weights", default=0)

if TYPE_CHECKING:
    from .checkpoint import Checkpoint
    from .model import NetworkModel


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
        raise UsageError("random weights are not read from a file: omit sha256, or pass a checkpoint")
    published, settings = published or {}, dict(settings or {})
    refuse_missing_file(name, checkpoint, published, source)
    require("torch", f"model '{name}'")
    file = None if checkpoint == RANDOM else find_checkpoint(name, checkpoint, published, source)
    from .checkpoint import read_checkpoint
    from .model import ConfidentNetwork, NetworkModel
    from .weights import load_weights

    kind = ConfidentNetwork if confident else NetworkModel
    if file is None:
        seed = {"seed_of_weights": _SEED.get()} if _SEED.get() else {}
        return kind(name, _seeded(build), convention, {"checkpoint": RANDOM, **seed, **settings}, execution)
    path, known = file
    read = read_checkpoint(path, sha256 or known)
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
