"""The weights that come with the package, and facts about them."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files

from safetensors import SafetensorError, safe_open

from ...errors import AssetError
from .layers import Weights

SHIPPED = ("tiny", "tiny_no_weather", "tiny_all")
"""Models by the corruptions that their training frames had: none, those of all families but weather, all."""


@dataclass(frozen=True, eq=False)
class ShippedWeights:
    """A file of weights.

    Attributes:
        arrays: float32, by the names of the trained network's state.
        sha256: of the file, 64 hexadecimal digits.
        about: recipe, seed, data, commit and the rest of how they were made.
        trained_on: training sets, as `--trained-on` takes them.
    """

    arrays: Mapping[str, Weights]
    sha256: str
    about: Mapping[str, str]
    trained_on: str = "shapes"


def shipped_weights(name: str) -> ShippedWeights:
    """The weights of a model of `SHIPPED`.

    Raises:
        AssetError: the installation is damaged.

    >>> sum(array.size for array in shipped_weights("tiny").arrays.values())
    379954
    """
    path = files(__package__).joinpath("weights", f"{name}.safetensors")
    try:
        digest = hashlib.sha256(path.read_bytes()).hexdigest()
        with safe_open(str(path), framework="numpy") as file:
            arrays = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118 (it is not a mapping)
            about = dict(file.metadata() or {})
    except (OSError, SafetensorError) as error:
        raise AssetError(f"{path}: missing or damaged ({error}); reinstall robustflow") from error
    return ShippedWeights(arrays, digest, about)
