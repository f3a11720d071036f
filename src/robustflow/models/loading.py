"""Load a model. A text is parsed once, as a `ModelRef` of one of the `KINDS`, each with one loader; every process loads
its own copy from the reference.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

from ..core.errors import UsageError
from ..core.files import digest_of_bytes
from ..core.paths import user_path
from ..core.plugins import accepts, require, source_of_target
from .catalog import PTLFLOW, is_in_ptlflow, methods
from .model_file import require_file
from .networks.loaders import NETWORKS
from .objects import construct, load_object
from .protocols import AnyModel, model_identity
from .provenance import DECLARED
from .ptlflow.loaders import BESIDES, is_of_ptlflow, ptlflow_loader
from .registered import MODELS
from .tiling import tiled
from .torch.build import SOURCES, check_available

EXPORTED = ".onnx"
"""File extension of exported networks."""
_TORCHSCRIPT = (".ts", ".torchscript")
"""Extensions of TorchScript, which is not supported: PyTorch's reader runs code from the file before any check."""
_NOT_FOR_ALL = {
    "device": "runs on the CPU only",
    "precision": "does not have a selectable precision",
    "checkpoint": "has no weights to load",
}
"""Command-line options for all models, and the reasons why some models do not support them."""


@dataclass(frozen=True)
class ModelRef:
    """A model that a user named, parsed: every process loads its own copy from it.

    Attributes:
        name: the text, which names the model in messages and tables.
        kind: one of `KINDS`.
        target: what the text refers to: a registered name, an architecture of ptlflow, a path, or
            `module.path:Attribute`.
        checkpoint: name or path of the weights, if given.
        options: the other options, as (name, value).

    >>> ref = ModelRef.parse("ptlflow:raft", {"checkpoint": "things", "iterations": 24})
    >>> ref.kind, ref.target, ref.checkpoint, ref.options
    ('ptlflow', 'raft', 'things', (('iterations', 24),))
    """

    name: str
    kind: str
    target: str
    checkpoint: Any = None
    options: tuple[tuple[str, Any], ...] = ()

    @classmethod
    def parse(cls, text: str | Path, options: Mapping[str, Any] | Iterable[tuple[str, Any]] = ()) -> ModelRef:
        """Decide which kind of model a text names.

        Raises:
            UsageError: it names none; the message lists the kinds.
        """
        name = str(text)
        for kind, row in KINDS.items():
            target = row.target(name)
            if target is not None:
                return cls(name, kind, target).with_options(options)
        raise _unknown(name)

    @property
    def keywords(self) -> dict[str, Any]:
        """All options by name, with the checkpoint."""
        return dict(self.options) | ({} if self.checkpoint is None else {"checkpoint": self.checkpoint})

    def with_options(self, options: Mapping[str, Any] | Iterable[tuple[str, Any]]) -> ModelRef:
        """Return a copy with these options, which take precedence over its own."""
        keywords = self.keywords | dict(options)
        checkpoint = keywords.pop("checkpoint", None)
        return replace(self, checkpoint=checkpoint, options=tuple(keywords.items()))

    def load(self) -> AnyModel:
        """Load a new instance of the model. If several devices are listed, the first is used."""
        options = {key: value for key, value in self.keywords.items() if key != DECLARED}
        if len(self.devices()) > 1:
            options["device"] = self.devices()[0]
        return _load(self, options)

    def preflight(self) -> None:
        """Raise an error if a file or library is missing, without importing heavy libraries."""
        if self.kind == "exported":
            require_file(user_path(self.target), "file; pass the path of the exported network")
            require("onnxruntime", f"model '{self.name}'")
        elif self.kind == "flows":
            self.load()
        elif self.kind in ("registered", "ptlflow"):
            method = methods().get(self.name)
            library = "ptlflow" if self.kind == "ptlflow" else method and method.source
            if self.name in NETWORKS:
                check_available(self.name, self.checkpoint, "torch", NETWORKS[self.name].source)
            elif library in SOURCES:
                needed = self.target not in BESIDES
                check_available(self.name, self.checkpoint, library, SOURCES[library], needed)

    def devices(self) -> tuple[str, ...]:
        """The devices listed in the option `device`; empty if it is not given."""
        device = dict(self.options).get("device")
        return tuple(name.strip() for name in str(device).split(",") if name.strip()) if device is not None else ()

    def on(self, device: str) -> ModelRef:
        """Return a copy of this reference for one device."""
        return self.with_options({"device": device})

    @property
    def is_own(self) -> bool:
        """Whether the name refers to user code, `module.path:Attribute`."""
        return self.kind == "object"

    def identity(self, model: AnyModel) -> dict[str, Any]:
        """Return the identity of `model` in a run. For user code, it includes the hash of the source file, so a run
        cannot be resumed after the code was edited. Values that the model itself reports replace the options; a
        checkpoint is identified by its hash, independent of its path.
        """
        identity = model_identity(model)
        reported = {*identity, DECLARED}
        identity["options"] = {key: str(value) for key, value in self.keywords.items() if key not in reported}
        if len(self.devices()) > 1 and "device" in identity["options"]:  # the number of devices does not affect results
            identity["options"]["device"] = self.devices()[0].partition(":")[0]
        source = source_of_target(self.target) if self.is_own else None
        if source is not None:
            identity |= {"spec": self.name, "source": digest_of_bytes(source)}
        return identity


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
    return _load(ModelRef.parse(name), options)


def _load(ref: ModelRef, options: dict[str, Any]) -> AnyModel:
    tile = None
    if not (ref.kind == "registered" and accepts(MODELS.get(ref.target), "tile")):
        tile = options.pop("tile", None)
    return tiled(KINDS[ref.kind].load(ref, options), tile)


class Kind(NamedTuple):
    """A kind of model that a text can name.

    Attributes:
        form: how a user writes it.
        target: function that returns what a text of this kind refers to; None for a text of a different kind.
        load: function that loads the target of a reference with options.
    """

    form: str
    target: Callable[[str], str | None]
    load: Callable[[ModelRef, dict[str, Any]], AnyModel]


def _registered(text: str) -> str | None:
    return text if text in MODELS else None


def _load_registered(ref: ModelRef, options: dict[str, Any]) -> AnyModel:
    factory = MODELS.get(ref.target)
    for option in options:
        if option in _NOT_FOR_ALL and not accepts(factory, option):
            raise UsageError(f"--{option}", f"model '{ref.name}' {_NOT_FOR_ALL[option]}; omit this option")
    return construct(factory, ref.name, options)


def _exported(text: str) -> str | None:
    suffix = Path(text).suffix.lower()
    if suffix in _TORCHSCRIPT:
        message = "TorchScript is not supported, because such a file can run code; export the network to ONNX"
        raise UsageError(text, f"{message}, or pass package.module:Class")
    return text if suffix == EXPORTED else None


def _load_exported(ref: ModelRef, options: dict[str, Any]) -> AnyModel:
    if "checkpoint" in options:
        raise UsageError("checkpoint", f"'{ref.name}' is itself the network; omit the checkpoint")
    return construct(MODELS.get("onnx"), ref.name, {"checkpoint": ref.target, **options})


def _of_ptlflow(text: str) -> str | None:
    architecture = text.removeprefix(PTLFLOW)
    if architecture != text:
        if architecture not in methods() or methods()[architecture].frames > 2:
            raise UsageError(text, f"use {architecture}; the prefix is only for names that refer to a different model")
        return architecture
    if is_in_ptlflow(text) or (text.isidentifier() and not user_path(text).exists() and is_of_ptlflow(text)):
        return text
    return None


def _load_from_ptlflow(ref: ModelRef, options: dict[str, Any]) -> AnyModel:
    return construct(ptlflow_loader(ref.name, ref.target), ref.name, options)


def _object(text: str) -> str | None:
    return text if ":" in text and not user_path(text).exists() else None


def _folder(text: str) -> str | None:
    return text if text and user_path(text).is_dir() else None


def _load_flows(ref: ModelRef, options: dict[str, Any]) -> AnyModel:
    return construct(MODELS.get("precomputed"), ref.name, {"folder": ref.target, **options})


KINDS = {
    "registered": Kind("a name listed by 'robustflow list models'", _registered, _load_registered),
    "exported": Kind("an exported network, FILE.onnx", _exported, _load_exported),
    "ptlflow": Kind("a model of ptlflow, NAME or ptlflow:NAME", _of_ptlflow, _load_from_ptlflow),
    "object": Kind("module.path:Attribute", _object, lambda ref, options: load_object(ref.target, options)),
    "flows": Kind("a folder of flow files", _folder, _load_flows),
}
"""The kinds of models; a text is of the first one that recognises it."""


def _unknown(text: str) -> UsageError:
    """Return the error for a text that names no model."""
    tried = f"tried as: {'; '.join(kind.form for kind in KINDS.values())}"
    if not text:
        return UsageError("model", f"the name is empty; {tried}")
    if user_path(text).exists():
        return UsageError(text, f"not an exported network; give --model NAME --checkpoint FILE ({tried})")
    if "/" in text or Path(text).suffix:
        return UsageError(text, f"no file, folder or model with this name exists ({tried})")
    error = MODELS.unknown(text)
    error.args = (*error.args[:-1], f"{error.args[-1]} ({tried})")
    return error
