"""Put a PyTorch network together with its checkpoint. Importable without the torch extra."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...errors import ModelError, UsageError
from ..input_convention import InputConvention

if TYPE_CHECKING:
    from .checkpoint import Checkpoint
    from .model import TorchModel

RANDOM = "random"
"""The checkpoint that is none: seeded random weights, for measuring cost and for tests."""


def require(library: str, extra: str, model: str) -> None:
    """Say which extra a model needs where its library is not installed.

    >>> require("numpy", "none", "dis")

    Raises:
        ModelError: the library is not there.
    """
    if find_spec(library) is None:
        title = "PyTorch" if library == "torch" else library
        raise ModelError(
            f"model '{model}' needs {title}, which is not installed: pip install 'robustflow[{extra}]' "
            "(with -c constraints.txt from a checkout)"
        )


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
    **execution: Any,
) -> TorchModel:
    """Build a network, load its checkpoint strictly, and wrap it.

    Args:
        name: of the model.
        build: makes the network; imports it, so that nothing here needs torch.
        convention: how the network wants its images.
        checkpoint: a file, a name among `published`, or "random" for seeded random weights, which the model's
            identity shows; there are no silent random weights.
        source: which file is meant and where its authors keep it, for the message when there is none.
        sha256: what the file's hash has to begin with, where it is known.
        published: checkpoints that can be fetched, by name: their addresses.
        scope: see `load_weights`.
        settings: what else changes the network's numbers.
        adapt: changes the network by what the checkpoint says beside its weights, before they are loaded; returns what
            is to be recorded.
        execution: `device`, `precision`, `compile`, `threads` of `TorchModel`.

    Raises:
        ModelError: without torch, without a checkpoint, or with one that does not fit.
        UsageError: a name that is not published.
    """
    require("torch", "torch", name)
    from .model import TorchModel

    settings = dict(settings or {})
    if checkpoint == RANDOM:
        if sha256 is not None:
            raise UsageError("random weights have no file: leave out sha256, or give a checkpoint")
        return TorchModel(name, _seeded(build), convention, {"checkpoint": RANDOM, **settings}, **execution)
    from .checkpoint import read_checkpoint
    from .find_checkpoint import find_checkpoint
    from .weights import load_weights

    path, known = find_checkpoint(name, checkpoint, published or {}, source)
    read = read_checkpoint(path, sha256 or known)
    net = build()
    if adapt is not None:
        settings |= adapt(net, read)
    cast = load_weights(net, read, name, scope)
    identity = {"checkpoint": read.sha256, **({"weights_cast_from": cast} if cast else {}), **settings}
    return TorchModel(name, net, convention, identity, **execution)


def _seeded(build: Callable[[], Any]) -> Any:
    import torch

    with torch.random.fork_rng(devices=[]):
        torch.default_generator.manual_seed(0)
        return build()
