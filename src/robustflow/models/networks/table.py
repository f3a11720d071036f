"""Table of the networks implemented in this project: network, checkpoint file, input convention and options.

Each entry defines a model whose network is part of this package. Building a model requires the torch extra.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

from ...core.arguments import check_count, check_switch, parse_size
from ...core.errors import UsageError
from ..base import AnyModel
from ..conventions import InputConvention
from ..devices import Execution, with_execution
from ..tiling import tiled
from ..torch.network import network_model


class Option(NamedTuple):
    """An option of a network."""

    default: Any
    check: Callable[[str, Any], None]
    fit: Callable[[InputConvention, Any], InputConvention] | None = None


@dataclass(frozen=True)
class Network:
    """A network implemented in this project."""

    net: str
    source: str
    convention: InputConvention
    options: Mapping[str, Option] = field(default_factory=dict)
    fixed: Mapping[str, Any] = field(default_factory=dict)
    scope: str | None = None
    tile: str | None = None

    def build(self, options: Mapping[str, Any]) -> Any:
        """Build the network with random weights."""
        module, _, attribute = self.net.partition(":")
        return getattr(import_module(f".{module}", __package__), attribute)(**options)


def _seed(name: str, value: Any) -> None:
    if type(value) is not int:  # in Python, True is an int
        raise UsageError(name, f"must be an integer, not {value!r}")


def _fraction(name: str, value: Any) -> None:
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value <= 1:
        raise UsageError(name, f"must be a number from 0 to 1, not {value!r}")


def _vertical(name: str, value: Any) -> None:
    if value not in ("bottom", "both"):
        raise UsageError(name, f"must be bottom (KITTI) or both (Sintel), not {value!r}")


def _size(name: str, value: Any) -> None:
    if value != "native":
        parse_size(value, 64)


def _stretched(convention: InputConvention, value: Any) -> InputConvention:
    return replace(convention, size=None if value == "native" else parse_size(value, 64))


_ITERATIONS = Option(12, check_count)
_SAMFLOW = Network(
    "samflow:SamFlow",
    "the authors' file of this size, linked from https://github.com/zslzx/SAMFlow",
    InputConvention(scale=1.0, fit="pad", multiple=16),
    {"iterations": _ITERATIONS},  # SAMFlow's authors evaluate with 24 iterations on KITTI and 32 on Sintel
    tile="432x960",  # the ViT encoders accept frames of up to 1024 pixels per side
)

NETWORKS = {
    # Liu et al., "Learning by Analogy", CVPR 2020. The paper's costs are for 256x832, the authors' size for KITTI;
    # their size for Sintel is 448x1024. "native" is the frame's size, rounded up to a multiple of 64.
    "arflow": Network(
        "arflow:ARFlow",
        "pwclite_ar.tar (or pwclite_raw.tar) from the folder checkpoints/ of https://github.com/lliuz/ARFlow",
        InputConvention(fit="stretch", multiple=64),
        {"size": Option("256x832", _size, _stretched)},
    ),
    # Luo et al., CVPR 2021. align_corners: the weights were trained with True; on PyTorch 1.3 and later, the authors'
    # code uses False. mask_threshold: warped features are set to zero where the bilinear weights inside the frame sum
    # to less than this; with the authors' value 1.0, rounding also zeroes some pixels inside the frame, and which ones
    # depends on the machine.
    "upflow": Network(
        "upflow:UPFlow",
        "upflow_kitti2015.pth from https://github.com/coolbeam/UPFlow_pytorch",
        InputConvention(mean=(104.920005, 110.1753, 114.785955), scale=0.0039216),
        {"align_corners": Option(True, check_switch), "mask_threshold": Option(0.9999, _fraction)},
    ),
    # Marsal et al., WACV 2023: RAFT trained without labels. The file also contains a brightness corrector, which is
    # ignored.
    "brightflow": Network(
        "brightflow:BrightFlow",
        "the RAFT checkpoint from https://github.com/CEA-LIST/BrightFlow",
        InputConvention(mean=(127.5, 127.5, 127.5), scale=2 / 255, fit="pad", multiple=8),
        {"iterations": _ITERATIONS},
        scope="model.",
    ),
    # Zhou et al., AAAI 2024. The network fine-tuned on Sintel differs: its file contains `wadd_1.add_weight`.
    "samflow_t": replace(_SAMFLOW, fixed={"size": "tiny", "finetuned": False}),
    "samflow_b": replace(_SAMFLOW, fixed={"size": "base", "finetuned": False}),
    "samflow_h": replace(
        _SAMFLOW,
        fixed={"size": "huge"},
        options={"finetuned": Option(False, check_switch), "iterations": _ITERATIONS},
    ),
    # Luo et al., CVPR 2024, at the frame's size; the numbers of steps and iterations are part of the method. All pairs
    # of equal size start from the same noise, drawn from `seed`. vertical: position of the padding rows; the authors
    # use "bottom" for KITTI and "both" for Sintel.
    "flowdiffuser": Network(
        "flowdiffuser:FlowDiffuser",
        "the authors' file, linked from https://github.com/LA30/FlowDiffuser",
        InputConvention(scale=1.0, fit="pad", multiple=8, vertical="bottom"),
        {
            "seed": Option(0, _seed),
            "vertical": Option("bottom", _vertical, lambda convention, value: replace(convention, vertical=value)),
        },
    ),
}
"""The networks, keyed by the names used to load them."""

_UNRECORDED = ("size",)
"""Fixed keyword arguments that are implied by the model's name."""


@with_execution
def load_network(
    name: str,
    checkpoint: str | Path | None = None,
    *,
    sha256: str | None = None,
    execution: Execution,
    **options: Any,
) -> AnyModel:
    """Load a network with its checkpoint."""
    network = NETWORKS[name]
    tile = options.pop("tile", network.tile)
    convention, keywords = network.convention, dict(network.fixed)
    for key, option in network.options.items():
        value = options.get(key, option.default)
        option.check(key, value)
        if option.fit is None:
            keywords[key] = value
        else:
            convention = option.fit(convention, value)
    model = network_model(
        name,
        lambda: network.build(keywords),
        convention,
        checkpoint,
        source=network.source,
        sha256=sha256,
        scope=network.scope,
        settings={key: value for key, value in keywords.items() if key not in _UNRECORDED},
        execution=execution,
    )
    return model if network.tile is None else tiled(model, tile)


def network_factory(name: str) -> Callable[..., AnyModel]:
    """Return the factory of a network by name; its signature includes the network's options.

    >>> [key for key in inspect.signature(network_factory("arflow")).parameters if key in ("size", "tile")]
    ['size']
    """
    network, factory = NETWORKS[name], partial(load_network, name)
    options = {key: option.default for key, option in network.options.items()}
    options |= {"tile": network.tile} if network.tile is not None else {}
    shared = inspect.signature(factory)
    first, *rest = (one for one in shared.parameters.values() if one.kind is not inspect.Parameter.VAR_KEYWORD)
    named = [inspect.Parameter(key, inspect.Parameter.KEYWORD_ONLY, default=value) for key, value in options.items()]
    factory.__signature__ = shared.replace(parameters=[first, *named, *rest])  # type: ignore[attr-defined]
    return factory


def __getattr__(name: str) -> Any:
    """Provide attributes such as `table.arflow`, to which the model registry refers."""
    if name not in NETWORKS:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    return network_factory(name)
