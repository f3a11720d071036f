"""Convert an object to a model: instantiate a class with its options, or wrap a function or a PyTorch module."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Callable
from typing import Any

from ..errors import ModelError, RobustFlowError, UsageError
from ..sample import Flow, Frame
from ..target import accepts, check_options, parameters_of, working_folder_kept
from .base import AnyModel, model_identity
from .registry import MODELS

_NOT_FOR_ALL = {
    "device": "runs on the CPU only",
    "precision": "does not have a selectable precision",
    "checkpoint": "has no weights to load",
}
"""Command-line options for all models, and the reasons why some models do not support them."""


class FunctionModel:
    """A model that calls a plain function of two frames."""

    def __init__(self, function: Callable[[Frame, Frame], Flow], identity: dict[str, Any] | None = None) -> None:
        self._function = function
        self._identity = identity or model_identity(function)

    def identity(self) -> dict[str, Any]:
        """Return the identity as for `FlowModel`; by default, the location of the function's definition."""
        return self._identity

    def predict(self, frame1: Frame, frame2: Frame) -> Flow:
        """Predict a flow as in `FlowModel.predict`."""
        return self._function(frame1, frame2)


def as_model(candidate: Any, what: str) -> AnyModel:
    """Return an object with `predict`, `predict_clip` or `lookup` unchanged, instantiate a class, or wrap a module or
    function.
    """
    if inspect.isclass(candidate):
        candidate = construct(candidate, candidate.__name__, {})
    if isinstance(candidate, AnyModel):
        return candidate
    if is_module(candidate):
        from .torch.user_model import TorchModel

        return TorchModel(candidate)
    if callable(candidate):
        return FunctionModel(candidate)
    raise ModelError(
        f"{what} has neither a method predict(frame1, frame2) nor a window with predict_clip(frames, index), and it is "
        "not callable; see the guide 'add your model'"
    )


def is_module(thing: Any) -> bool:
    """Return whether an object is a PyTorch module, without importing PyTorch.

    >>> is_module(print)
    False
    """
    torch = sys.modules.get("torch")
    return torch is not None and isinstance(thing, torch.nn.Module)


def construct(factory: Callable[..., Any], name: str, options: dict[str, Any]) -> Any:
    """Call a model's class or factory with its options."""
    for option in options:
        if option in _NOT_FOR_ALL and name in MODELS.names() and not accepts(factory, option):
            raise UsageError(f"model '{name}' {_NOT_FOR_ALL[option]}; omit --{option}")
    check_options(factory, f"model '{name}'", options, "-O")
    try:
        with working_folder_kept():
            return factory(**options)
    except RobustFlowError:
        raise
    except (Exception, SystemExit) as error:
        raise ModelError(f"model '{name}' cannot be built: {type(error).__name__}: {error}") from error


def takes_two_frames(function: Callable[..., Any]) -> bool:
    """Return whether a callable predicts flow directly: a model, or a function with exactly two required arguments."""
    if isinstance(function, AnyModel):
        return True
    positional = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)
    parameters = parameters_of(function).values()
    return len([p for p in parameters if p.default is p.empty and p.kind in positional]) == 2
