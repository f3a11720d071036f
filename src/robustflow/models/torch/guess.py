"""The input that an undeclared network expects, determined by trying the common conventions on shifted textures."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from ...errors import ModelError
from ..input_convention import ORDERS, SCALINGS, named_convention
from ..signature import flow_layout
from .fit import fitted_images
from .module_net import MODULE_LAYOUTS, ModuleNet, chosen_output, outputs_of
from .reproducible import reproducible
from .shifted import SHIFTS, ShiftedPair, shifted_pair

LAST_OUTPUT = -1
_FIRST_ROUND = 2
"""Number of pairs after which conventions that are far behind are dropped."""
_FAR = 2.0
_CLEAR = 0.9
"""The best is clearly better if its error is below this fraction of the next one's, and it is better on every pair."""
_SEES = 0.5
"""A network measures motion at all if its error is below this fraction of that of zero flow."""


@dataclass(frozen=True)
class Declared:
    """How a module takes a pair and where it returns the flow; None for what was not declared.

    Attributes:
        scaling: a name of `input_convention.SCALINGS`.
        order: "rgb" or "bgr".
        layout: a name of `module_net.LAYOUTS`.
        output: position or key of the flow among several outputs.
    """

    scaling: str | None = None
    order: str | None = None
    layout: str | None = None
    output: str | int | None = None

    @property
    def complete(self) -> bool:
        """Whether colours and range are known, without which nothing can be predicted."""
        return self.scaling is not None and self.order is not None

    def describe(self) -> str:
        """Written as options.

        >>> Declared("0-1", "rgb", "pair", -1).describe()
        'scaling=0-1, order=rgb, layout=pair, output=-1'
        """
        fields = {"scaling": self.scaling, "order": self.order, "layout": self.layout, "output": self.output}
        return ", ".join(f"{key}={value}" for key, value in fields.items() if value is not None)


@dataclass
class _TriedConvention:
    way: Declared
    errors: list[float]

    @property
    def mean(self) -> float:
        return float(np.mean(self.errors))

    def clearly_beats(self, other: _TriedConvention) -> bool:
        every = all(mine < theirs for mine, theirs in zip(self.errors, other.errors, strict=True))
        return every and self.mean <= _CLEAR * other.mean


def complete(
    module: nn.Module, call: Callable[[list[Any]], Any], declared: Declared, device: torch.device, threads: int = 1
) -> tuple[Declared, str]:
    """The declared convention, completed by what works best for the network.

    Args:
        module: in evaluation mode, on `device`.
        call: calls it with its list of inputs.
        declared: what the user declared.
        device: where it is run.
        threads: of the CPU.

    Returns:
        The complete convention; and the evidence in words, "" if everything was declared or only one convention works.

    Raises:
        ModelError: no convention works, or none is clearly best.
    """
    with torch.inference_mode(), reproducible(threads):
        trial = _Trial(module, call, device)
        layouts = trial.working_layouts(declared)
        if declared.complete:
            return replace(declared, layout=layouts[0]), ""
        ways = product(
            SCALINGS if declared.scaling is None else [declared.scaling],
            ORDERS if declared.order is None else [declared.order],
            layouts,
        )
        ranked = trial.rank([Declared(*way, declared.output) for way in ways])
    best, zero = ranked[0], float(np.mean([np.hypot(*shift) for shift in SHIFTS]))
    if best.mean > _SEES * zero:
        raise ModelError(
            f"cannot tell what input this network expects: on shifted textures the best of {len(ranked)} conventions "
            f"is off by {best.mean:.2g} px, and zero flow by {zero:.2g} px, as for networks without trained weights; "
            f"{_ASK}"
        )
    rival = next((other for other in ranked[1:] if not best.clearly_beats(other)), None)
    if rival is not None:
        raise ModelError(
            f"cannot tell what input this network expects: on shifted textures {best.way.describe()} "
            f"({best.mean:.3g} px) is not clearly better than {rival.way.describe()} ({rival.mean:.3g} px); {_ASK}"
        )
    following = f", the next best by {ranked[1].mean:.2g} px" if len(ranked) > 1 else ""
    return best.way, f"on shifted textures it is off by {best.mean:.2g} px{following}"


_ASK = "declare it: robustflow.TorchModel(net, scaling='0-1', order='rgb'), or -O scaling=0-1 -O order=rgb"


class _Trial:
    def __init__(self, module: nn.Module, call: Callable[[list[Any]], Any], device: torch.device) -> None:
        self._module, self._call, self._device = module, call, device
        self._pairs: list[ShiftedPair] = [shifted_pair(i) for i in range(len(SHIFTS))]

    def working_layouts(self, declared: Declared) -> list[str]:
        """Those for which the network returns a flow at all; a declared one is trusted."""
        if declared.layout is not None:
            return [declared.layout]
        working, failures = [], []
        for layout in MODULE_LAYOUTS:
            way = Declared(declared.scaling or "0-1", declared.order or "rgb", layout, declared.output)
            try:
                self._errors(way, self._pairs[0])
                working.append(layout)
            except ModelError as error:
                failures.append(f"{layout}: {error}")
        if not working:
            raise ModelError(f"the network accepts a pair in none of the common ways ({failures[0]}); wrap it in one")
        return working

    def rank(self, ways: Sequence[Declared]) -> list[_TriedConvention]:
        """Those not dropped after the first pairs, with their errors on every pair, the best first."""
        candidates: dict[Declared, _TriedConvention] = {}
        for number, pair in enumerate(self._pairs):
            if number == _FIRST_ROUND and candidates:
                limit = _FAR * min(one.mean for one in candidates.values()) + 0.01
                kept = {(way.scaling, way.order, way.layout) for way, one in candidates.items() if one.mean <= limit}
                ways = [way for way in ways if (way.scaling, way.order, way.layout) in kept]
            for way in ways:
                for completed, error in self._errors(way, pair).items():
                    candidates.setdefault(completed, _TriedConvention(completed, [])).errors.append(error)
        whole = [one for one in candidates.values() if len(one.errors) == len(self._pairs)]
        return sorted(self._last_unless_clear(whole), key=lambda one: one.mean)

    def _last_unless_clear(self, candidates: list[_TriedConvention]) -> list[_TriedConvention]:
        """One of the outputs under a convention: the last, unless another is clearly better."""
        chosen: dict[tuple[Any, ...], _TriedConvention] = {}
        for one in candidates:
            key = (one.way.scaling, one.way.order, one.way.layout)
            before = chosen.setdefault(key, one)
            if one is not before and (one.clearly_beats(before) or not before.clearly_beats(one)):
                chosen[key] = one
        return list(chosen.values())

    def _errors(self, way: Declared, pair: ShiftedPair) -> dict[Declared, float]:
        """The error of every output that is a flow."""
        net = ModuleNet(self._module, self._call, way.layout or "pair", None, batched=True)
        convention = named_convention(order=way.order or "rgb", scaling=way.scaling or "0-1", multiple=1)
        images = [fitted_images([frame], convention, self._device) for frame in pair[:2]]
        returned = net.returned(*images)
        errors: dict[Declared, float] = {}
        for output in [way.output] if way.output is not None else _outputs(returned):
            flow = _as_flow(returned, output, pair.frame1.shape[:2])
            if flow is not None:
                errors[replace(way, output=output)] = pair.error(flow)
        if not errors:
            what = ", ".join(outputs_of(returned)) or type(returned).__name__
            raise ModelError(f"none of the outputs ({what[:200]}) is a flow (N, 2, H, W) at the frames' resolution")
        return errors


def _outputs(returned: Any) -> list[str | int]:
    if isinstance(returned, dict):
        return [str(key) for key in returned]
    return [0, LAST_OUTPUT] if isinstance(returned, list | tuple) and len(returned) > 1 else [LAST_OUTPUT]


def _as_flow(returned: Any, output: str | int, size: tuple[int, ...]) -> Any:
    """Float32 (H, W, 2), or None for what is not a flow of this size."""
    try:
        flow: Tensor = chosen_output(returned, output)
        if flow.ndim == 5 and flow.shape[1] == 1:
            flow = flow[:, 0]
        channels_last = flow_layout(flow.shape, 1, size[0], size[1]) == "nhwc"
    except ModelError:
        return None
    return (flow[0] if channels_last else flow[0].permute(1, 2, 0)).float().cpu().numpy()
