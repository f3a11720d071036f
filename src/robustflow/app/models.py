"""The models that the page offers, of which one is loaded."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ..core.errors import ModelError, RobustFlowError, UsageError, unknown_name
from ..core.plugins import needed_options
from ..models import MODELS, FlowModel, ModelRef
from ..models.catalog import MethodEntry, checkpoints, is_installed, methods
from ..models.torch.build import RANDOM


class Models:
    """Models by name: first those given on the command line, then all models that this installation can run."""

    def __init__(self, given: Sequence[ModelRef]) -> None:
        catalogued = methods()
        here = [
            name
            for name in MODELS.names()
            if (_runs_on_pairs(catalogued[name]) if name in catalogued else _needs_nothing(name))
        ]
        here.sort(key=lambda name: (name not in ("dis", "farneback"), name))  # models that need no weights
        self._refs = {ref.name: ref for ref in given} | {
            name: ModelRef.parse(name) for name in here if name not in {ref.name for ref in given}
        }
        self._loaded: tuple[tuple[str, str], FlowModel] | None = None

    @property
    def names(self) -> list[str]:
        """Model names in the order in which the page offers them."""
        return list(self._refs)

    @property
    def offers(self) -> list[dict[str, Any]]:
        """Return each model's name, whether it accepts a checkpoint, and its published checkpoints, for the page."""
        catalogued = methods()
        published: dict[str, list[str]] = {}
        for entry in checkpoints():
            published.setdefault(entry.model, []).append(entry.checkpoint)
        return [
            {
                "name": name,
                "takes_checkpoint": name in catalogued and catalogued[name].type != "knowledge",
                "checkpoints": [RANDOM, *published.get(name, [])],
            }
            for name in self.names
        ]

    def check(self, name: str, checkpoint: str = "") -> None:
        """Raise for an unknown name, before any model is imported or loaded."""
        if name not in self._refs:
            raise unknown_name("model of this app", name, self.names)
        method = methods().get(name)
        if checkpoint and method is not None and method.type == "knowledge":
            raise UsageError(name, "has no weights: leave the checkpoint empty")

    def load(self, name: str, checkpoint: str = "") -> FlowModel:
        """Return a model, loading it unless it is already loaded. `checkpoint` takes precedence over the model's
        default checkpoint.
        """
        self.check(name, checkpoint)
        if self._loaded is None or self._loaded[0] != (name, checkpoint):
            self._loaded = None  # two networks may not fit into memory
            ref = self._refs[name]
            if checkpoint:
                ref = ref.with_options({"checkpoint": checkpoint})
            try:
                self._loaded = ((name, checkpoint), _loaded(ref))
            except RobustFlowError as error:
                raise type(error)(_page_message(str(error))) from error
        return self._loaded[1]

    def load_given(self, ref: ModelRef) -> None:
        """Load a model given on the command line, so that an error ends the command."""
        self._loaded = ((ref.name, ""), _loaded(ref))


def _loaded(ref: ModelRef) -> FlowModel:
    model = ref.load()
    if not isinstance(model, FlowModel):
        raise ModelError(f"model '{ref.name}' does not predict from two frames; choose a different model")
    return model


def _page_message(message: str) -> str:
    """Reword an error about a command-line option for the page's field.

    >>> _page_message("model 'raft' needs its checkpoint: get it, and give its path as --checkpoint")
    "model 'raft' needs its checkpoint: get it, and give its path in the Checkpoint field"
    """
    return message.replace("as --checkpoint", "in the Checkpoint field").replace("--checkpoint", "the Checkpoint field")


def _runs_on_pairs(method: MethodEntry) -> bool:
    """Return whether a method is installed and is a two-frame method."""
    return is_installed(method) and method.frames == 2


def _needs_nothing(name: str) -> bool:
    """Return whether a model can be loaded without options, unlike flow files or an exported network."""
    return name != "onnx" and not needed_options(MODELS.get(name))
