"""Load the weights shipped in the package, and their metadata."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files

from safetensors import SafetensorError, safe_open

from ...errors import AssetError
from .layers import Weights

SHIPPED = ("tiny", "tiny_no_weather", "tiny_all")
"""Models trained without corruptions, with all families of corruptions except weather, and with all corruptions.
"""


@dataclass(frozen=True, eq=False)
class ShippedWeights:
    """The contents of a weight file."""

    arrays: Mapping[str, Weights]
    sha256: str
    about: Mapping[str, str]
    trained_on: str = "shapes"


def shipped_weights(name: str) -> ShippedWeights:
    """Return the weights of a model in `SHIPPED`."""
    path = files(__package__).joinpath("weights", f"{name}.safetensors")
    try:
        digest = hashlib.sha256(path.read_bytes()).hexdigest()
        with safe_open(str(path), framework="numpy") as file:
            arrays = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118 (it is not a mapping)
            about = dict(file.metadata() or {})
    except (OSError, SafetensorError) as error:
        raise AssetError(f"{path}: missing or damaged ({error}); reinstall robustflow") from error
    return ShippedWeights(arrays, digest, about)
