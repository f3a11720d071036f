"""Load a model: by name, by `module.path:Attribute`, from an exported network, a folder of flow files, or an object.

What is missing is reported before any heavy library is imported.
"""

from __future__ import annotations

import inspect
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..core.errors import ModelError, RobustFlowError, UsageError, class_and_message, raise_interrupt, unknown_name
from ..core.files import digest_of_bytes
from ..core.paths import user_path
from ..core.plugins import (
    accepts,
    check_options,
    import_target,
    is_target,
    parameters_of,
    require,
    source_of_target,
    working_folder_kept,
)
from ..core.types import Flow, Frame
from .base import AnyModel, model_identity
from .catalog import PTLFLOW, is_in_ptlflow, methods
from .model_file import require_file
from .networks.table import NETWORKS
from .provenance import DECLARED
from .ptlflow.models import BESIDES
from .registry import EXPORTED, MODELS, TORCHSCRIPT
from .tiling import tiled
from .torch.network import SOURCES, check_available

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
    for option in options:
        if option in _NOT_FOR_ALL and name in MODELS.names() and not accepts(factory, option):
            raise UsageError(f"--{option}", f"model '{name}' {_NOT_FOR_ALL[option]}; omit this option")
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


def preflight(name: str, options: Mapping[str, Any]) -> None:
    """Raise an error if a model's file, library or checkpoint is missing."""
    checkpoint, method = options.get("checkpoint"), methods().get(name)
    if method is None:
        if Path(name).suffix.lower() in EXPORTED:
            require_file(user_path(name), "file; pass the path of the exported network")
            require("onnxruntime", f"model '{name}'")
        if not is_in_ptlflow(name):
            _check_name(name)
            return
    library = "ptlflow" if method is None else method.source
    source = NETWORKS[name].source if name in NETWORKS else SOURCES.get(library)
    if source is None:
        return
    check_available(name, checkpoint, library if library in SOURCES else "torch", source, name not in BESIDES)


TORCH_OPTIONS = (
    *("scaling", "order", "multiple", "layout", "output", "checkpoint", "sha256", "batched"),
    *("device", "precision", "compile", "threads"),
)
"""Options of `TorchModel` that the command line accepts for a `module:factory` that returns a plain PyTorch module."""


def list_models() -> list[str]:
    """Return the registered model names, including those from installed packages; ptlflow provides more (see
    `robustflow list models`).

    >>> "dis" in list_models()
    True
    """
    return list(MODELS.names())


def load_model(name: str | Path, **options: Any) -> AnyModel:
    """Load a model.

    Args:
        name: name listed by `robustflow list models`, including all ptlflow models; `module.path:Attribute` (an object
            with `predict`, a PyTorch module, a class or factory that returns one of these, or a function of two
            frames); path of an exported network (.onnx); or a folder of flow files.
        options: keyword arguments of the model's constructor (`preset="fast"` for `dis`). Every model also accepts
            `tile="HEIGHTxWIDTH"`, which makes it predict in tiles (see `tiling.TiledModel`).

    Raises:
        UsageError: the name or an option is unknown.
        ModelError: the model cannot be loaded.

    >>> load_model("dis", preset="fast").identity()["preset"]
    'fast'
    """
    name = str(name)
    if not name:
        raise UsageError("model", "the name is empty; give a name (see 'robustflow list models')")
    registered = name in MODELS.names()
    exported = None if registered else EXPORTED.get(Path(name).suffix.lower())
    if not registered and (name == "torchscript" or Path(name).suffix.lower() in TORCHSCRIPT):
        message = "TorchScript is not supported, because such a file can run code; export the network to ONNX"
        raise UsageError(name, f"{message}, or pass package.module:Class")
    if exported is not None:
        if "checkpoint" in options:
            raise UsageError("checkpoint", f"'{name}' is itself the network; omit the checkpoint")
        return load_model(exported, checkpoint=name, **options)
    if "tile" in options and not (registered and "tile" in parameters_of(MODELS.get(name))):
        tile = options.pop("tile")
        return tiled(load_model(name, **options), tile)
    architecture = name.removeprefix(PTLFLOW)
    if name.startswith(PTLFLOW) and (architecture not in methods() or methods()[architecture].frames > 2):
        raise UsageError(name, f"use {architecture}; the prefix is only for names that refer to a different model")
    if architecture != name or is_in_ptlflow(name):
        return _load_from_ptlflow(name, architecture, options)
    if ":" in name and not user_path(name).exists():
        return _load_attribute(name, options)
    if not registered and user_path(name).is_dir():
        return construct(MODELS.get("precomputed"), name, {"folder": name, **options})
    _check_name(name)
    if not registered and name.isidentifier():
        from .ptlflow.models import is_of_ptlflow

        if is_of_ptlflow(name):
            return _load_from_ptlflow(name, name, options)
    return construct(MODELS.get(name), name, options)


def _check_name(name: str) -> None:
    """Raise an error if no model has this name, before any model is run."""
    path, suffix = user_path(name), Path(name).suffix.lower()
    if not name or name in MODELS or is_target(name) or name.startswith(PTLFLOW) or suffix in (*EXPORTED, *TORCHSCRIPT):
        return
    if path.is_dir():
        construct(MODELS.get("precomputed"), name, {"folder": name})
    elif path.exists():
        endings = ", ".join(EXPORTED)
        raise UsageError(name, f"a file but not an exported network ({endings}); pass --model NAME --checkpoint FILE")
    elif "/" in name or suffix:
        raise UsageError(name, "no file, folder or model with this name exists (see 'robustflow list models')")
    else:
        from .ptlflow.models import is_of_ptlflow

        if not (name.isidentifier() and is_of_ptlflow(name)):
            raise MODELS.unknown(name)


@dataclass(frozen=True)
class ModelSpec:
    """A model's name and options, from which every worker process loads its own copy."""

    name: str
    options: tuple[tuple[str, Any], ...] = ()

    def load(self) -> AnyModel:
        """Load a new instance of the model. If several devices are listed, the first is used."""
        options = {key: value for key, value in self.options if key != DECLARED}
        if len(self.devices()) > 1:
            options["device"] = self.devices()[0]
        return load_model(self.name, **options)

    def devices(self) -> tuple[str, ...]:
        """The devices listed in the option `device`; empty if it is not given."""
        device = dict(self.options).get("device")
        return tuple(one.strip() for one in str(device).split(",") if one.strip()) if device is not None else ()

    def on(self, device: str) -> ModelSpec:
        """Return a copy of this specification for one device."""
        other_options = [(key, value) for key, value in self.options if key != "device"]
        return ModelSpec(self.name, (*other_options, ("device", device)))

    def preflight(self) -> None:
        """Raise an error if a file or library is missing, without importing heavy libraries; see `preflight`."""
        preflight(self.name, dict(self.options))

    @property
    def is_own(self) -> bool:
        """Whether the name refers to user code, `module.path:Attribute`."""
        return ":" in self.name and not self.name.startswith(PTLFLOW) and not user_path(self.name).exists()

    def identity(self, model: AnyModel) -> dict[str, Any]:
        """Return the identity of `model` in a run. For user code, it includes the hash of the source file, so a run
        cannot be resumed after the code was edited. Values that the model itself reports replace the options; a
        checkpoint is identified by its hash, independent of its path.
        """
        identity = model_identity(model)
        known = set(identity)
        identity["options"] = {key: str(value) for key, value in self.options if key not in known | {DECLARED}}
        if len(self.devices()) > 1 and "device" in identity["options"]:  # the number of devices does not affect results
            identity["options"]["device"] = self.devices()[0].partition(":")[0]
        source = source_of_target(self.name) if self.is_own else None
        if source is not None:
            identity |= {"spec": self.name, "source": digest_of_bytes(source)}
        return identity


def _load_from_ptlflow(name: str, architecture: str, options: dict[str, Any]) -> AnyModel:
    from .ptlflow.models import ptlflow_factory

    return construct(ptlflow_factory(name, architecture), name, options)


def _load_attribute(name: str, options: dict[str, Any]) -> AnyModel:
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


def device_of(model: Any) -> str:
    """Return the device of a model ("cuda:0", "cuda", ...); "cpu" if it does not declare one."""
    device = getattr(model, "device", None)
    if isinstance(device, str):
        return device.strip() or "cpu"
    return str(device) if isinstance(getattr(device, "type", None), str) else "cpu"


def is_accelerator(device: str) -> bool:
    """Return whether a device is not the CPU.

    >>> is_accelerator("cuda:0"), is_accelerator("cpu")
    (True, False)
    """
    return device.partition(":")[0] not in ("cpu", "auto", "meta")


def devices_of(spec: ModelSpec | None, model: Any) -> tuple[str, ...]:
    """Return the accelerators that a run uses, each with its own prediction process; none for a model on the CPU."""
    listed = spec.devices() if spec is not None else ()
    if len(listed) > 1:
        if not all(is_accelerator(device) for device in listed):
            raise UsageError("--device", f"only GPUs can be listed, not {','.join(listed)}; pass cpu alone")
        return listed
    own = device_of(model)
    if not is_accelerator(own):
        return ()
    if spec is not None and ":" not in own and (listed or not spec.is_own):
        return tuple(f"{own}:{number}" for number in range(_visible(own))) or (own,)
    return (own,)


def _visible(kind: str) -> int:
    """Return the number of devices of one kind that PyTorch finds; 0 if the model does not use PyTorch."""
    torch = sys.modules.get("torch")
    return int(torch.cuda.device_count()) if torch is not None and kind == "cuda" else 0
