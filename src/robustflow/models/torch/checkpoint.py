"""Read a checkpoint file safely, as an untrusted download that should contain only tensors, and load it strictly."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from ...core.errors import ModelError
from ...core.paths import user_path
from ...media.tensor_file import RefusedError, load_tensors
from ..model_file import damaged, opened

HELD_AS = ("state_dict", "model_state_dict", "model")
"""Keys under which checkpoint files store the weights."""

TRAINED_ON = "robustflow_trained_on"
"""Key under which `robustflow train` stores the training sets of the weights."""


@dataclass(frozen=True)
class Checkpoint:
    """The contents of a checkpoint file."""

    path: Path
    sha256: str
    weights: dict[str, Tensor]
    hyper_parameters: dict[str, Any] = field(default_factory=dict)
    trained_on: str | None = None


def read_checkpoint(path: str | Path, sha256: str | None = None) -> Checkpoint:
    """Read a safetensors file, or a state dict saved with `torch.save`, possibly under a key in `HELD_AS`."""
    path = user_path(path)
    content, digest = read_content(path, sha256)
    hyper_parameters = content.get("hyper_parameters") if isinstance(content, dict) else None
    declared = content.get(TRAINED_ON) if isinstance(content, dict) else None
    return Checkpoint(
        path,
        digest,
        _weights(path, content),
        hyper_parameters if isinstance(hyper_parameters, dict) else {},
        declared if isinstance(declared, str) else None,
    )


def read_content(path: Path, sha256: str | None = None) -> tuple[Any, str]:
    """Return the contents of a file, read with the same checks, and the file's SHA-256."""
    with opened(path, sha256) as (file, digest):
        try:
            return load_tensors(file), digest
        except RefusedError as error:
            what = f"it contains more than plain weights ({str(error)[:200]}), which may run code or exhaust the memory"
            raise ModelError(path, f"{what}; use the authors' file, or save only the state_dict") from None
        except Exception as error:  # parsers raise any exception on a damaged file
            raise damaged(path, error) from None


def _weights(path: Path, content: Any) -> dict[str, Tensor]:
    for _ in HELD_AS:
        entries = content if isinstance(content, dict) else {}
        content = next((entries[name] for name in HELD_AS if isinstance(entries.get(name), dict)), content)
    if not isinstance(content, dict) or not content:
        raise ModelError(path, f"contains {type(content).__name__}, not named weights; save the network's state_dict()")
    for key, value in content.items():
        if not (isinstance(key, str) and isinstance(value, Tensor)):
            what = f"{type(value).__name__}, not a tensor" if isinstance(key, str) else "under a non-string key"
            raise ModelError(path, f"entry {str(key)[:60]!r} is {what}; save the network's state_dict()")
    return dict(content)


PREFIXES = ("module.", "_model.", "model.", "_orig_mod.")
"""Prefixes that data-parallel training, ptlflow, Lightning and `torch.compile` add to parameter names."""


def bare_name(key: str) -> str:
    """Strip the wrappers' prefixes from a name.

    >>> bare_name("module.model.fnet.conv1.weight")
    'fnet.conv1.weight'
    """
    while key.startswith(PREFIXES):
        key = key.partition(".")[2]
    return key


def load_weights(net: nn.Module, checkpoint: Checkpoint, model: str, scope: str | None = None) -> str | None:
    """Load a checkpoint into a network, strictly."""
    expected = dict(net.state_dict())
    scoped = {
        key: value for key, value in checkpoint.weights.items() if key.removeprefix("module.").startswith(scope or "")
    }
    inside = scoped or dict(checkpoint.weights)
    as_named = inside.keys() == expected.keys()  # a network's own names may start with a wrapper's prefix
    own = {key if as_named else bare_name(key): key for key in expected}
    by_name = inside if as_named else _weights_by_bare_name(checkpoint, inside)
    _refuse_other_names(checkpoint, model, by_name, expected, own)
    casts = set()
    weights = {}
    for name, key in own.items():
        value, target = by_name[name], expected[key]
        _refuse_bad_value(checkpoint, name, value, target)
        if value.dtype != target.dtype:
            casts.add(str(value.dtype).removeprefix("torch."))
        weights[key] = value.to(target.dtype)
        if not torch.isfinite(weights[key]).all():
            bad = int((~torch.isfinite(weights[key])).sum())
            what = f"{bad} of {value.numel()} values of '{name}' are NaN or infinite"
            raise ModelError(checkpoint.path, f"{what}; the training diverged, or the file is damaged")
    net.load_state_dict(weights, strict=True)
    return ", ".join(sorted(casts)) or None


def _weights_by_bare_name(checkpoint: Checkpoint, weights: Mapping[str, Tensor]) -> dict[str, Tensor]:
    by_name: dict[str, Tensor] = {}
    for key, value in weights.items():
        name = bare_name(key)
        if name in by_name:
            raise ModelError(checkpoint.path, f"'{name}' has two prefixes; store only one network in the file")
        by_name[name] = value
    return by_name


def _refuse_other_names(
    checkpoint: Checkpoint,
    model: str,
    weights: Mapping[str, Tensor],
    wanted: Mapping[str, Tensor],
    own: Mapping[str, str],
) -> None:
    shapes = [
        f"{name} {_shape(weights[name])} instead of {_shape(wanted[key])}"
        for name, key in own.items()
        if name in weights and weights[name].shape != wanted[key].shape
    ]
    differences = [
        _first_names("missing", (name for name in own if name not in weights)),
        _first_names("unexpected", (name for name in weights if name not in own)),
        _first_names("with a different shape", shapes),
    ]
    if any(differences):
        what = "; ".join(part for part in differences if part)
        message = f"not a checkpoint of {model} ({len(own)} entries): {what}; use a file trained for this model"
        raise ModelError(checkpoint.path, message)


def _refuse_bad_value(checkpoint: Checkpoint, name: str, value: Tensor, target: Tensor) -> None:
    if not is_plain(value) or value.is_floating_point() != target.is_floating_point():
        what = f"'{name}' contains {kind_of(value)}, expected {kind_of(target)}"
        raise ModelError(checkpoint.path, f"{what}; save the weights as plain floating-point tensors")


def is_plain(value: Tensor) -> bool:
    """Return whether a tensor is dense, real, not quantised, and has values.

    >>> is_plain(torch.zeros(2)), is_plain(torch.zeros(2).to_sparse()), is_plain(torch.zeros(2, device="meta"))
    (True, False, False)
    """
    return value.layout is torch.strided and not (value.is_meta or value.is_quantized or value.is_complex())


def kind_of(value: Tensor) -> str:
    """Describe the elements of a tensor for messages.

    >>> kind_of(torch.zeros(2)), kind_of(torch.zeros(2, device="meta"))
    ('float32', 'float32 without values (on the device meta)')
    """
    kind = str(value.dtype if value.layout is torch.strided else value.layout).removeprefix("torch.")
    return kind + (" without values (on the device meta)" if value.is_meta else "")


def _first_names(what: str, names: Iterable[str]) -> str:
    names = list(names)
    more = f", and {len(names) - 3} more" if len(names) > 3 else ""
    few = ", ".join(name[:100] for name in names[:3])
    return f"{len(names)} {what} ({few}{more})" if names else ""


def _shape(value: Tensor) -> str:
    return "x".join(map(str, value.shape)) or "scalar"
