"""`tiny` and its variants: the project's small network with the weights shipped in the package.

The network runs in PyTorch if the torch extra is installed, otherwise in NumPy. Both use single precision, and the
network amplifies rounding errors: on real pairs the flows differ by up to about 4e-3 px (docs/tiny.md). A run's
identity records the runtime.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from ...core.errors import UsageError, unknown_name
from ...core.plugins import install_command
from ..base import AnyModel
from ..conventions import InputConvention
from ..devices import Execution, with_execution
from ..tiny.layers import MULTIPLE
from ..tiny.model import SHIPPED, NumpyTiny, shipped_weights
from ..torch.network import network_model

RUNTIMES = ("auto", "torch", "numpy")
_CONVENTION = InputConvention(mean=(127.5, 127.5, 127.5), scale=2 / 255, fit="pad", multiple=MULTIPLE)


@with_execution
def small_network(
    name: str,
    checkpoint: str | Path | None = None,
    *,
    runtime: str = "auto",
    sha256: str | None = None,
    execution: Execution,
) -> AnyModel:
    """Build the small network."""
    if runtime not in RUNTIMES:
        raise unknown_name("runtime", str(runtime), RUNTIMES)
    if runtime == "auto":
        runtime = "torch" if checkpoint is not None or find_spec("torch") is not None else "numpy"
    if runtime == "numpy":
        _check_for_numpy(name, checkpoint, execution)
        return NumpyTiny(name, shipped_weights(name))
    if checkpoint is None:
        return _with_shipped_weights(name, execution)
    source = "a file written by robustflow train tiny"
    return network_model(name, _net, _CONVENTION, checkpoint, source=source, sha256=sha256, execution=execution)


def _with_shipped_weights(name: str, execution: Execution) -> AnyModel:
    import torch

    from ..torch.model import NetworkModel

    weights, net = shipped_weights(name), _net()
    net.load_state_dict({key: torch.from_numpy(array.copy()) for key, array in weights.arrays.items()})
    model = NetworkModel(name, net, _CONVENTION, {"checkpoint": weights.sha256, "runtime": "torch"}, execution)
    model.trained_on = weights.trained_on
    return model


def _net() -> Any:
    from .tiny import Tiny as Network

    return Network()


def _check_for_numpy(name: str, checkpoint: str | Path | None, execution: Execution) -> None:
    if checkpoint is not None:
        raise UsageError(f"{name} with a user-supplied checkpoint needs PyTorch: omit runtime=numpy")
    if execution.device not in ("auto", "cpu") or execution.precision != "fp32" or execution.compile:
        raise UsageError(
            f"{name} without PyTorch only runs on the CPU in fp32; omit device, precision and compile, or install "
            f"PyTorch: {install_command('torch')}"
        )


def __getattr__(name: str) -> Callable[..., AnyModel]:
    """Provide attributes such as `tiny.tiny_all`, to which the model registry refers."""
    if name not in SHIPPED:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    return partial(small_network, name)
