"""Load the weights from a checkpoint into a network; any mismatch between their entries is an error."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import torch
from torch import Tensor, nn

from ...core.errors import ModelError
from .checkpoint import Checkpoint

PREFIXES = ("module.", "_model.", "model.", "_orig_mod.")
"""Prefixes that wrappers such as data-parallel training, ptlflow, Lightning and `torch.compile` add to a network's
parameter names.
"""


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
    inside = dict(_weights_in_scope(checkpoint.weights, scope))
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
            raise ModelError(
                checkpoint.path,
                f"{bad} of {value.numel()} values of '{name}' are NaN or infinite; the training "
                "diverged, or the file is damaged: use a different checkpoint",
            )
    net.load_state_dict(weights, strict=True)
    return ", ".join(sorted(casts)) or None


def _weights_in_scope(weights: Mapping[str, Tensor], scope: str | None) -> Mapping[str, Tensor]:
    if scope is None:
        return weights
    inside = {key: value for key, value in weights.items() if key.removeprefix("module.").startswith(scope)}
    return inside or weights


def _weights_by_bare_name(checkpoint: Checkpoint, weights: Mapping[str, Tensor]) -> dict[str, Tensor]:
    by_name: dict[str, Tensor] = {}
    for key, value in weights.items():
        name = bare_name(key)
        if name in by_name:
            raise ModelError(
                checkpoint.path, f"'{name}' appears under two prefixes; store only one network in the file"
            )
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
        raise ModelError(
            f"{checkpoint.path} is not a checkpoint of {model} ({len(own)} entries): "
            f"{'; '.join(part for part in differences if part)}; use a file trained for this model"
        )


def _refuse_bad_value(checkpoint: Checkpoint, name: str, value: Tensor, target: Tensor) -> None:
    if not is_plain(value) or value.is_floating_point() != target.is_floating_point():
        raise ModelError(
            checkpoint.path,
            f"'{name}' contains {kind_of(value)}, expected {kind_of(target)}; "
            "save the weights as plain floating-point tensors",
        )


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


def _first_names(what: str, names: Iterable[str], shown: int = 3) -> str:
    names = list(names)
    more = f", and {len(names) - shown} more" if len(names) > shown else ""
    few = ", ".join(name[:100] for name in names[:shown])
    return f"{len(names)} {what} ({few}{more})" if names else ""


def _shape(value: Tensor) -> str:
    return "x".join(map(str, value.shape)) or "scalar"
