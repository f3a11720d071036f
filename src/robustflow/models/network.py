"""Put one of the project's own networks together with its checkpoint. Importable without the torch extra."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import ModelError
from .input_convention import InputConvention

if TYPE_CHECKING:
    from .torch_model import TorchModel


def own_model(
    name: str,
    build: Callable[[], Any],
    convention: InputConvention,
    checkpoint: str | Path | None,
    *,
    source: str,
    sha256: str | None,
    scope: str | None = None,
    settings: Mapping[str, Any] | None = None,
    **execution: Any,
) -> TorchModel:
    """Build a network, load its checkpoint strictly, and wrap it.

    Args:
        name: of the model.
        build: makes the network; imports it, so that nothing here needs torch.
        convention: how the network wants its images.
        checkpoint: the file; there are no silent random weights.
        source: which file is meant and where its authors keep it, for the message when there is none.
        sha256: what the file's hash has to begin with, where it is known.
        scope: see `load_weights`.
        settings: what else changes the network's numbers.
        execution: `device`, `precision`, `compile`, `threads` of `TorchModel`.

    Raises:
        ModelError: without torch, without a checkpoint, or with one that does not fit.
    """
    if find_spec("torch") is None:
        raise ModelError(f"model '{name}' needs PyTorch, which is not installed: pip install 'robustflow[torch]'")
    if checkpoint is None:
        raise ModelError(f"model '{name}' needs its checkpoint: get {source}, and give its path as checkpoint=PATH")
    if not Path(checkpoint).expanduser().exists():
        raise ModelError(f"model '{name}': no file {checkpoint}; get {source}, and put it there")
    from .checkpoint import read_checkpoint
    from .torch_model import TorchModel
    from .weights import load_weights

    read = read_checkpoint(checkpoint, sha256)
    net = build()
    cast = load_weights(net, read, name, scope)
    identity = {"checkpoint": read.sha256, **({"weights_cast_from": cast} if cast else {}), **(settings or {})}
    return TorchModel(name, net, convention, identity, **execution)
