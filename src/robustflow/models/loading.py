"""Find a model by name, by `module.path:Attribute`, in the file of an exported network or in a folder of flow files."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..digest import digest_of_bytes
from ..errors import ModelError, RobustFlowError, UsageError, unknown_name
from ..registry import Registry
from ..sample import Flow, Frame
from ..target import import_target, source_of_target
from .base import AnyModel, model_identity
from .early import refuse_early
from .own.networks import OWN
from .provenance import DECLARED
from .tiling import tiled

MODELS: Registry[Callable[..., AnyModel]] = Registry("model", entry_point_group="robustflow.models")
MODELS.add("farneback", "robustflow.models.opencv:Farneback")
MODELS.add("dis", "robustflow.models.opencv:Dis")
MODELS.add("dis_rgb", "robustflow.models.dis.model:DisRgb")
MODELS.add("precomputed", "robustflow.models.precomputed:Precomputed")
for _name in OWN:
    MODELS.add(_name, f"robustflow.models.own.networks:{_name}")
for _name in ("raft", "gma", "csflow", "skflow", "gmflownet", "craft", "flowformer", "flowformer_pp"):
    MODELS.add(_name, f"robustflow.models.ptlflow.pairs:{_name}")
for _name in ("videoflow_bof", "videoflow_mof", "memflow", "memflow_t", "streamflow", "memfof"):
    MODELS.add(_name, f"robustflow.models.ptlflow.clips:{_name}")
MODELS.add("raft_large", "robustflow.models.torch.torchvision:raft_large")
MODELS.add("raft_small", "robustflow.models.torch.torchvision:raft_small")
MODELS.add("onnx", "robustflow.models.exported.onnx:OnnxModel")
MODELS.add("torch_export", "robustflow.models.exported.pt2:torch_export")

PTLFLOW = "ptlflow:"
"""Before the name of any model of ptlflow."""

EXPORTED = {".onnx": "onnx", ".pt2": "torch_export"}
"""Endings of files that are a model by themselves, and the model that reads them."""

TORCH_OPTIONS = (
    *("scaling", "order", "multiple", "layout", "output", "checkpoint", "sha256", "batched"),
    *("device", "precision", "compile", "threads"),
)
"""Options of `TorchModel` that a `module:factory` of a bare PyTorch module takes from the command line."""

_NOT_FOR_ALL = {
    "device": "runs on the CPU only",
    "precision": "has no precision to choose",
    "checkpoint": "has no weights to load",
}
"""Options that the command line offers for every model, and why some models do not take them."""

TORCHSCRIPT = (".ts", ".torchscript")
"""Endings of TorchScript files. They are refused: PyTorch's reader runs `__setstate__` methods of the file while it
reads, before anything could be checked, and TorchScript's operators can write files."""


def load_model(name: str, **options: Any) -> AnyModel:
    """Load a model.

    Args:
        name: a registered name (`robustflow list models`), `ptlflow:NAME` for any model of that library,
            `module.path:Attribute` (an object with `predict`, a PyTorch module, a class or factory that makes one, or
            a function of two frames), an exported network (a .onnx or .pt2 file), or a folder of flow files.
        options: passed to the model's constructor (`preset="fast"` for `dis`). Every model also takes
            `tile="HEIGHTxWIDTH"`, to predict in tiles (see `tiling.TiledModel`).

    Raises:
        UsageError: unknown name or option.
        ModelError: the model cannot be loaded.

    >>> load_model("dis", preset="fast").identity()["preset"]
    'fast'
    """
    registered = name in MODELS.names()
    exported = None if registered else EXPORTED.get(Path(name).suffix.lower())
    if not registered and (name == "torchscript" or Path(name).suffix.lower() in TORCHSCRIPT):
        raise UsageError(
            f"model '{name}': TorchScript is not read, because reading such a file can run what its author put there; "
            "export the network with torch.export.save (.pt2) or to ONNX"
        )
    if exported is not None:
        if "checkpoint" in options:
            raise UsageError(
                f"'{name}' is the network itself; leave out the checkpoint, or give it to model '{exported}'"
            )
        return load_model(exported, checkpoint=name, **options)
    if "tile" in options and not (registered and "tile" in _parameters(MODELS.get(name))):
        tile = options.pop("tile")
        return tiled(load_model(name, **options), tile)
    if name.startswith(PTLFLOW):
        from .ptlflow.clips import ptlflow_factory

        return _construct(ptlflow_factory(name, name.removeprefix(PTLFLOW)), name, options)
    if ":" in name and not Path(name).exists():
        return _load_attribute(name, options)
    if not registered and Path(name).expanduser().is_dir():
        return _construct(MODELS.get("precomputed"), name, {"folder": name, **options})
    if not registered and ("/" in name or Path(name).suffix):
        raise _no_such_path(name)
    if not registered and name.isidentifier():
        from .ptlflow.pairs import is_of_ptlflow

        if is_of_ptlflow(name):
            raise UsageError(f"unknown model '{name}': the library ptlflow has one of this name, {PTLFLOW}{name}")
    return _construct(MODELS.get(name), name, options)


@dataclass(frozen=True)
class ModelSpec:
    """A model by name and options: what a worker process is given so that it can load its own copy.

    The option `trained_on` declares the training sets of any model (see `provenance`); it is not given to the model.
    """

    name: str
    options: tuple[tuple[str, Any], ...] = ()

    def load(self) -> AnyModel:
        """Load the model; every call makes a new one. Of a list of devices it takes the first."""
        options = {key: value for key, value in self.options if key != DECLARED}
        if len(self.devices()) > 1:
            options["device"] = self.devices()[0]
        return load_model(self.name, **options)

    def devices(self) -> tuple[str, ...]:
        """The devices that the option `device` lists; none where it is not given.

        >>> ModelSpec("raft", (("device", "cuda:0,cuda:1"),)).devices()
        ('cuda:0', 'cuda:1')
        """
        given = dict(self.options).get("device")
        return tuple(one.strip() for one in str(given).split(",") if one.strip()) if given is not None else ()

    def on(self, device: str) -> ModelSpec:
        """The same model on one device.

        >>> ModelSpec("raft", (("device", "cuda"),)).on("cuda:1").devices()
        ('cuda:1',)
        """
        kept = [(key, value) for key, value in self.options if key != "device"]
        return ModelSpec(self.name, (*kept, ("device", device)))

    def refuse_early(self) -> None:
        """Say what is missing without importing the libraries that would read it; see `early`."""
        refuse_early(self.name, dict(self.options), EXPORTED)

    @property
    def is_own(self) -> bool:
        """Whether it names the user's own code, `module.path:Attribute`."""
        return ":" in self.name and not self.name.startswith(PTLFLOW) and not Path(self.name).exists()

    def identity(self, model: AnyModel) -> dict[str, Any]:
        """What names `model` in a run's identity. A user's own module counts with the hash of its source file, so
        that an edited model never continues the run of the unedited one. What the model says itself about an option
        counts instead of the option: a checkpoint by its hash, wherever the file is."""
        identity = model_identity(model)
        known = set(identity)
        identity["options"] = {key: str(value) for key, value in self.options if key not in known | {DECLARED}}
        if len(self.devices()) > 1 and "device" in identity["options"]:  # how many there are changes no number
            identity["options"]["device"] = self.devices()[0].partition(":")[0]
        users = ":" in self.name and not self.name.startswith(PTLFLOW)
        source = source_of_target(self.name) if users else None
        if source is not None:
            identity |= {"spec": self.name, "source": digest_of_bytes(source)}
        return identity


class FunctionModel:
    """A plain function of two frames, as a model."""

    def __init__(self, function: Callable[[Frame, Frame], Flow], identity: dict[str, Any] | None = None) -> None:
        self._function = function
        self._identity = identity or model_identity(function)

    def identity(self) -> dict[str, Any]:
        """See `FlowModel`: where the function is defined, unless stated otherwise."""
        return self._identity

    def predict(self, frame1: Frame, frame2: Frame) -> Flow:
        """See `FlowModel.predict`."""
        return self._function(frame1, frame2)


def as_model(found: Any, what: str) -> AnyModel:
    """Anything with `predict`, `predict_clip` or `lookup` as it is; a class built, a module or function wrapped.

    Args:
        found: what should be a model.
        what: to call it in messages.

    Raises:
        ModelError: none of these, or a class that cannot be built.
        UsageError: a class that needs an option.
    """
    if inspect.isclass(found):
        found = _construct(found, what, {})
    if isinstance(found, AnyModel):
        return found
    if is_module(found):
        from .torch.user_model import TorchModel

        return TorchModel(found)
    if callable(found):
        return FunctionModel(found)
    raise ModelError(
        f"{what} has no method predict(frame1, frame2), nor a window with predict_clip(frames, index), and is not "
        "callable; see the guide 'add your model'"
    )


def _no_such_path(name: str) -> UsageError:
    if Path(name).expanduser().exists():
        return UsageError(
            f"model '{name}' is a file, but no exported network ({', '.join(EXPORTED)}); weights are given as "
            "--model NAME --checkpoint FILE"
        )
    return UsageError(
        f"model '{name}': no such file or folder, nor a model of this name (see 'robustflow list models')"
    )


def is_module(thing: Any) -> bool:
    """Whether something is a PyTorch module, without importing PyTorch to find out.

    >>> is_module(print)
    False
    """
    torch = sys.modules.get("torch")
    return torch is not None and isinstance(thing, torch.nn.Module)


def _load_attribute(name: str, options: dict[str, Any]) -> AnyModel:
    module_name, _, attribute = name.partition(":")
    if module_name.endswith(".py"):
        meant = f"{module_name.removesuffix('.py').replace('/', '.')}:{attribute}"
        raise UsageError(f"model '{name}' names a file; name its module, from the folder it is in: {meant}")
    found = import_target(name, "model", ModelError)
    if is_module(found) and not isinstance(found, AnyModel):
        return _as_torch_model(found, name, options)
    if inspect.isclass(found) or (callable(found) and not _takes_two_frames(found)):
        parameters = _parameters(found)
        takes_any = any(parameter.kind is parameter.VAR_KEYWORD for parameter in parameters.values())
        # Where the factory makes a bare module, what it does not take itself says how the module is to be used.
        rest = {} if takes_any else {key: options[key] for key in options if key not in parameters}
        factory_options = {key: options[key] for key in options if key not in rest}
        if rest and not any(key in TORCH_OPTIONS for key in rest):
            factory_options, rest = options, {}
        built = _construct(found, name, factory_options)
        if is_module(built) and not isinstance(built, AnyModel):
            return _as_torch_model(built, name, rest)
        if rest:
            raise unknown_name(f"option of model '{name}'", next(iter(rest)), parameters or ["(it takes none)"])
        found = built
    elif options:
        raise UsageError(f"model '{name}' is already built, so it takes no options: {', '.join(options)}")
    return as_model(found, f"model '{name}'")


def _as_torch_model(module: Any, name: str, options: dict[str, Any]) -> AnyModel:
    from .torch.user_model import TorchModel

    for option in options:
        if option not in TORCH_OPTIONS:
            raise unknown_name(f"option of model '{name}'", option, TORCH_OPTIONS)
    return TorchModel(module, **options)


def _construct(factory: Callable[..., Any], name: str, options: dict[str, Any]) -> Any:
    parameters = _parameters(factory)
    takes_any = any(parameter.kind is parameter.VAR_KEYWORD for parameter in parameters.values())
    for option in options:
        if takes_any or option in parameters:
            continue
        if option in _NOT_FOR_ALL and name in MODELS.names():
            raise UsageError(f"model '{name}' {_NOT_FOR_ALL[option]}; leave out --{option}")
        raise unknown_name(f"option of model '{name}'", option, parameters or ["(it takes none)"])
    needed = [key for key in needed_options(factory) if key not in options]
    if needed:
        raise UsageError(f"model '{name}' needs the option {needed[0]}: give -O {needed[0]}=VALUE")
    try:
        return factory(**options)
    except RobustFlowError:
        raise
    except (Exception, SystemExit) as error:
        raise ModelError(f"model '{name}' cannot be built: {type(error).__name__}: {error}") from error


def needed_options(factory: Callable[..., Any]) -> list[str]:
    """The options without which a model cannot be built.

    >>> needed_options(lambda file, threads=1: None)
    ['file']
    """
    by_name = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)
    return [key for key, one in _parameters(factory).items() if one.kind in by_name and one.default is one.empty]


def _takes_two_frames(function: Callable[..., Any]) -> bool:
    if isinstance(function, AnyModel):
        return True
    positional = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)
    parameters = _parameters(function).values()
    return len([p for p in parameters if p.default is p.empty and p.kind in positional]) == 2


def _parameters(function: Callable[..., Any]) -> Mapping[str, inspect.Parameter]:
    """A callable's parameters; none where Python cannot tell (some built-in types)."""
    try:
        return inspect.signature(function).parameters
    except (TypeError, ValueError):
        return {}
