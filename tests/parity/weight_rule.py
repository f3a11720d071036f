"""The weights of the parity packs, made by rule v2 of the packs' README."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import torch

BIAS, FREE = 0.03, 0.2
"""Defaults of rule v2, for keys files that leave them out."""


def weights(keys: Path) -> dict[str, np.ndarray]:
    """The value of every entry of a keys file, in its order, except those a network makes itself (kind "keep")."""
    header = json.loads(keys.read_text())
    values = {}
    for entry in header["entries"]:
        if entry["kind"] == "keep":
            continue
        shape = tuple(entry["shape"])
        if entry["dtype"].startswith("float"):
            source = entry.get("alias_of", entry["key"])
            bias, free = header.get("bias", BIAS), header.get("free", FREE)
            values[entry["key"]] = _value(source, shape, header["gain"], bias, free)
        else:
            values[entry["key"]] = np.zeros(shape, entry["dtype"])
    return values


def fill_by_rule(net: torch.nn.Module, gain: float) -> None:
    """Give every parameter of a network, except FlowDiffuser's two constants, its value by the rule."""
    import torch

    with torch.no_grad():
        for name, value in net.named_parameters():
            if name not in ("zero", "scale"):
                key = name.removeprefix("model.")
                value.copy_(torch.from_numpy(_value(key, tuple(value.shape), gain, BIAS, FREE)))


def _value(key: str, shape: tuple[int, ...], gain: float, bias: float, free: float) -> np.ndarray:
    if key.endswith("running_mean"):
        return np.zeros(shape, np.float32)
    if key.endswith("running_var"):
        return np.ones(shape, np.float32)
    seed = int.from_bytes(hashlib.sha256(key.encode()).digest()[:8], "little")
    normal = np.asarray(np.random.default_rng(seed).standard_normal(shape))
    match (len(shape) >= 2, key.endswith("weight")):
        case (True, True):
            value = normal * (gain / np.sqrt(float(np.prod(shape[1:]))))
        case (True, False):
            value = normal * free
        case (False, True):
            value = 1 + 0.1 * normal
        case _:
            value = bias * normal
    return value.astype(np.float32)


def digest(values: dict[str, np.ndarray]) -> str:
    """SHA-256 over names and bytes, in the order of the names."""
    total = hashlib.sha256()
    for key in sorted(values):
        total.update(key.encode())
        total.update(np.ascontiguousarray(values[key]).tobytes())
    return total.hexdigest()
