"""Python objects as models: classes, factories, functions and PyTorch modules, also those that a user names as
`module.path:Attribute`."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Callable
from typing import Any

from ..core.errors import ModelError, RobustFlowError, UsageError, class_and_message, raise_interrupt, unknown_name
from ..core.plugins import accepts, check_options, import_target, parameters_of, working_folder_kept
from ..core.types import Flow, Frame
from .protocols import AnyModel, model_identity


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
    """Return a model unchanged, instantiate a class, or wrap a PyTorch module or a function."""
    if inspect.isclass(candidate):
        candidate = construct(candidate, candidate.__name__, {})
    if isinstance(candidate, AnyModel):
        return candidate
    if is_module(candidate):
        from .torch.user_model import TorchModel

        return TorchModel(candidate)
    if callable(candidate):
        return FunctionModel(candidate)
    raise ModelError(what, "it has no method predict(frame1, frame2) or predict_clip; see the guide 'add your model'")


def is_module(thing: Any) -> bool:
    """Return whether an object is a PyTorch module, without importing PyTorch.

    >>> is_module(print)
    False
    """
    torch = sys.modules.get("torch")
    return torch is not None and isinstance(thing, torch.nn.Module)


def construct(factory: Callable[..., Any], name: str, options: dict[str, Any]) -> Any:
    """Call a model's class or factory with its options."""
    check_options(factory, f"model '{name}'", options, "-O")
    try:
        with working_folder_kept():
            return factory(**options)
    except RobustFlowError:
        raise
    except BaseException as error:
        raise_interrupt(error)
        raise ModelError(name, f"the model cannot be built: {class_and_message(error)}") from error


def takes_two_frames(function: Callable[..., Any]) -> bool:
    """Return whether a callable predicts flow directly: a model, or a function with exactly two required arguments."""
    if isinstance(function, AnyModel):
        return True
    positional = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)
    parameters = parameters_of(function).values()
    return len([p for p in parameters if p.default is p.empty and p.kind in positional]) == 2


TORCH_OPTIONS = (
    *("scaling", "order", "multiple", "layout", "output", "checkpoint", "sha256", "batched"),
    *("device", "precision", "compile", "threads"),
)
"""Options of `TorchModel` that the command line accepts for a `module:factory` that returns a plain PyTorch module."""


def load_object(name: str, options: dict[str, Any]) -> AnyModel:
    """Import an attribute of a module, and make a model of it."""
    target = import_target(name, "model")
    if is_module(target) and not isinstance(target, AnyModel):
        return _as_torch_model(target, name, options)
    if inspect.isclass(target) or (callable(target) and not takes_two_frames(target)):
        # If the factory builds a plain module, options that the factory does not accept are passed to `TorchModel`.
        rest = {key: options[key] for key in options if not accepts(target, key)}
        factory_options = {key: options[key] for key in options if key not in rest}
        if rest and not any(key in TORCH_OPTIONS for key in rest):
            factory_options, rest = options, {}
        built = construct(target, name, factory_options)
        if is_module(built) and not isinstance(built, AnyModel):
            return _as_torch_model(built, name, rest)
        if rest:
            check_options(target, f"model '{name}'", options, "-O")
        target = built
    elif options:
        raise UsageError(next(iter(options)), f"model '{name}' is already built, so it does not accept options")
    return as_model(target, f"model '{name}'")


def _as_torch_model(module: Any, name: str, options: dict[str, Any]) -> AnyModel:
    from .torch.user_model import TorchModel

    for option in options:
        if option not in TORCH_OPTIONS:
            raise unknown_name(f"option of model '{name}'", option, TORCH_OPTIONS)
    return TorchModel(module, **options)
