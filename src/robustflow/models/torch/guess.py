"""Determine or check a network's input convention by measuring its error on shifted textures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np
import torch
from torch import nn

from ...core.errors import ModelError
from ...core.text import first_of
from ...core.types import Flow
from ...metrics.photometric import Misread, Pair, Reading, misread
from ..conventions import ORDERS, SCALINGS, named_convention
from .fit import fitted_images, unfitted_flow
from .model import reproducible
from .module_net import MODULE_LAYOUTS, ModuleNet, as_flow, chosen_output, outputs_of
from .shifted import SHIFTS, ShiftedPair, shifted_pair

LAST_OUTPUT = -1
_FIRST_ROUND = 2
"""Number of pairs after which conventions with a much larger error are discarded."""
_FAR = 2.0
_CLEAR = 0.9
"""The best convention is clearly better if its error is below this fraction of the second-best error, and lower on
every pair.
"""
_WRONG = 0.5
"""A declared convention is considered wrong if a different one has an error below this fraction of the declared one's,
and a lower error on every pair.
"""
_SURE = 0.05
"""A declared convention is accepted without further comparison if its error is below this fraction of the error of zero
flow.
"""
_WELL = 0.1
"""A declared convention causes a warning if its error is above this fraction of the error of zero flow."""
_SEES = 0.5
"""A network is considered to measure motion if its error is below this fraction of the error of zero flow."""
_ZERO = float(np.mean([np.hypot(*shift) for shift in SHIFTS]))
_MOST_NAMED = 4


@dataclass(frozen=True)
class Declared:
    """The input and output convention of a module; None for values that were not declared."""

    scaling: str | None = None
    order: str | None = None
    layout: str | None = None
    output: str | int | None = None

    @property
    def complete(self) -> bool:
        """Whether the colour order and value range are known, which prediction requires."""
        return self.scaling is not None and self.order is not None

    def describe(self) -> str:
        """Return the convention as keyword options."""
        return ", ".join(f"{key}={value}" for key, value in self._set_fields().items())

    def line(self) -> str:
        """Return the line of code and the command-line options that declare this convention."""
        given = {key: value for key, value in self._set_fields().items() if (key, value) != ("output", LAST_OUTPUT)}
        code = ", ".join(f"{key}={value!r}" for key, value in given.items())
        return f"robustflow.TorchModel(net, {code}) or {' '.join(f'-O {key}={value}' for key, value in given.items())}"

    def _set_fields(self) -> dict[str, str | int]:
        fields = {"scaling": self.scaling, "order": self.order, "layout": self.layout, "output": self.output}
        return {key: value for key, value in fields.items() if value is not None}


@dataclass
class _TriedConvention:
    way: Declared
    errors: list[float]
    pairs: list[Pair]

    @property
    def mean(self) -> float:
        return float(np.mean(self.errors))

    @property
    def sees(self) -> bool:
        return self.mean <= _SEES * _ZERO

    @cached_property
    def misread(self) -> Misread | None:
        return misread(self.pairs)

    def clearly_beats(self, other: _TriedConvention, factor: float = _CLEAR) -> bool:
        every = all(mine < theirs for mine, theirs in zip(self.errors, other.errors, strict=False))
        return every and self.mean <= factor * float(np.mean(other.errors[: len(self.errors)]))


def infer_convention(
    module: nn.Module,
    declared: Declared,
    multiple: int,
    device: torch.device,
    threads: int = 1,
) -> tuple[Declared, str]:
    """Check the declared convention, and fill in missing values with those that work best for the network."""
    with torch.inference_mode(), reproducible(threads):
        trial = _Trial(module, device, multiple)
        layouts = trial.working_layouts(declared)
        if declared.complete:
            return _checked(trial, replace(declared, layout=layouts[0]))
        ways = product(
            SCALINGS if declared.scaling is None else [declared.scaling],
            ORDERS if declared.order is None else [declared.order],
            layouts,
        )
        ranked = trial.rank([Declared(*way, declared.output) for way in ways])
    best = ranked[0]
    if not best.sees:
        _refuse_misread(*ranked)
        raise ModelError(
            f"cannot determine what input this network expects: on shifted textures, the best of {len(ranked)} "
            f"conventions has an error of {best.mean:.2g} px, compared with {_ZERO:.2g} px for zero flow, as is "
            "typical of networks without trained weights; "
            f"declare the input, for example with {Declared('0-1', 'rgb').line()}"
        )
    rival = next((other for other in ranked[1:] if not best.clearly_beats(other)), None)
    if rival is not None:
        raise ModelError(
            "cannot determine what input this network expects, because several conventions work about equally well on "
            f"shifted textures; best first: {_named(ranked)}; declare the one used in training, for example the first "
            f"with {best.way.line()}"
        )
    following = f" (the next best: {ranked[1].mean:.2g} px)" if len(ranked) > 1 else ""
    return best.way, (
        f"the model does not declare its expected input; {best.way.describe()} is used, because its error on shifted "
        f"textures is {best.mean:.2g} px{following}. To be sure, declare it: {best.way.line()}"
    )


def _checked(trial: _Trial, declared: Declared) -> tuple[Declared, str]:
    """Check a convention whose input is completely declared; return the convention with its output, and a warning."""
    try:
        outputs = trial.outputs(declared)
    except ModelError as error:
        return declared, f"could not be checked on shifted textures: {error}"
    named = [one for one in outputs if one.way.output == declared.output]
    chosen = named[0] if named else trial.preferred(outputs)[0]
    remark = ""
    if declared.output is None and chosen is not outputs[-1]:
        declared = chosen.way
        remark = (
            f"output {chosen.way.output} is used, because its error on shifted textures is {chosen.mean:.2g} px, and "
            f"that of the last output is {outputs[-1].mean:.2g} px. To be sure, declare it: {chosen.way.line()}"
        )
    if chosen.mean <= _SURE * _ZERO:
        return declared, remark
    _refuse_misread(chosen)
    ways = [replace(declared, scaling=scaling, order=order) for scaling, order in product(SCALINGS, ORDERS)]
    others = [*outputs, *trial.rank([way for way in ways if way != declared], better_than=chosen)]
    others = sorted((one for one in others if one.sees), key=lambda one: one.mean)
    better = [one for one in others if one.clearly_beats(chosen, _WRONG)]
    if better:
        message = (
            f"on shifted textures, the declared {chosen.way.describe()} has an error of {chosen.mean:.2g} px, compared "
            f"with {_ZERO:.2g} px for zero flow; better conventions, best first: {_named(better, chosen)}; declare the "
            f"one used in training, for example the first with {better[0].way.line()}"
        )
        if not chosen.sees:
            raise ModelError(message)
        return declared, message
    if chosen.mean > _WELL * _ZERO:
        like = "" if chosen.sees else "as is typical of networks without trained weights"
        like = f"it looks {chosen.misread.reading.describe()}" if chosen.misread else like
        return declared, (
            f"on shifted textures, its error with {chosen.way.describe()} is {chosen.mean:.2g} px, while that of zero "
            f"flow is {_ZERO:.2g} px{like and f' ({like})'}, and no other convention or output is better: check the "
            "weights, and that the network returns its finest flow, (u right, v down) in pixels from frame 1 to frame 2"
        )
    return declared, remark


def _refuse_misread(*ranked: _TriedConvention) -> None:
    """Raise if a network measures the motion in a wrong format. Weak networks may underestimate it by a factor of 2."""
    for one in ranked:
        if not one.sees and one.misread and one.misread.reading not in (Reading(factor=2.0), Reading(factor=0.5)):
            raise ModelError(
                f"this network measures the motion of shifted textures with {one.way.describe()}, but its output is "
                f"not (u right, v down) in pixels from frame 1 to frame 2: it looks {one.misread.reading.describe()}; "
                "return flow in this format from the module, or wrap it in a module that does"
            )


def _named(ranked: Sequence[_TriedConvention], beside: _TriedConvention | None = None) -> str:
    """Format the best conventions and their errors; omit layout and output if all conventions, including `beside`,
    agree on them.
    """
    fitting = [one for one in ranked if one.mean <= max(_FAR * ranked[0].mean, _SURE * _ZERO)] or ranked[:1]
    listed = [*fitting, *([beside] if beside else [])]
    same = {field: None for field in ("layout", "output") if len({getattr(one.way, field) for one in listed}) == 1}
    shown = [f"{replace(one.way, **same).describe()} ({one.mean:.2g} px)" for one in fitting]
    return first_of(shown, _MOST_NAMED, "; ")


@dataclass
class _Trial:
    module: nn.Module
    device: torch.device
    multiple: int

    def __post_init__(self) -> None:
        self._pairs = [shifted_pair(i) for i in range(len(SHIFTS))]

    def working_layouts(self, declared: Declared) -> list[str]:
        """Return the conventions for which the network returns a flow, without changing the declared values."""
        if declared.layout is not None:
            return [declared.layout]
        working, failures = [], []
        for layout in MODULE_LAYOUTS:
            way = Declared(declared.scaling or "0-1", declared.order or "rgb", layout, declared.output)
            try:
                self._flows(way, self._pairs[0])
                working.append(layout)
            except ModelError as error:
                failures.append(f"{layout}: {error}")
        if not working:
            raise ModelError(
                f"the network does not accept a pair in any common way ({failures[0]}); wrap it in a module that does"
            )
        return working

    def rank(self, ways: Sequence[Declared], better_than: _TriedConvention | None = None) -> list[_TriedConvention]:
        """Rank the conventions that were not discarded after the first pairs, best first, with their errors on every
        pair.
        """
        candidates: dict[Declared, _TriedConvention] = {}
        for number, pair in enumerate(self._pairs):
            if number == _FIRST_ROUND and candidates:
                limit = _FAR * min(one.mean for one in candidates.values()) + 0.01
                promising = {
                    (way.scaling, way.order, way.layout)
                    for way, one in candidates.items()
                    if one.mean <= limit and (better_than is None or one.clearly_beats(better_than, _WRONG))
                }
                ways = [way for way in ways if (way.scaling, way.order, way.layout) in promising]
            for way in ways:
                self._try(way, pair, candidates)
        whole = [one for one in candidates.values() if len(one.errors) == len(self._pairs)]
        return sorted(self.preferred(whole), key=lambda one: one.mean)

    def outputs(self, declared: Declared) -> list[_TriedConvention]:
        """Return one convention for each output that is a flow; a declared output comes first."""
        candidates: dict[Declared, _TriedConvention] = {}
        for pair in self._pairs:
            self._try(declared, pair, candidates, every=True)
        return list(candidates.values())

    def preferred(self, candidates: list[_TriedConvention]) -> list[_TriedConvention]:
        """Choose among the outputs: the last one, unless a different one is clearly better."""
        chosen: dict[tuple[Any, ...], _TriedConvention] = {}
        for one in candidates:
            key = (one.way.scaling, one.way.order, one.way.layout)
            before = chosen.setdefault(key, one)
            if one is not before and (one.clearly_beats(before) or not before.clearly_beats(one)):
                chosen[key] = one
        return list(chosen.values())

    def _try(
        self, way: Declared, pair: ShiftedPair, candidates: dict[Declared, _TriedConvention], every: bool = False
    ) -> None:
        for completed, flow in self._flows(way, pair, every).items():
            one = candidates.setdefault(completed, _TriedConvention(completed, [], []))
            one.errors.append(pair.error(flow))
            one.pairs.append((pair.frame1, pair.frame2, pair.smoothed(flow)))

    def _flows(self, way: Declared, pair: ShiftedPair, every: bool = False) -> dict[Declared, Flow]:
        """Return the declared output, or, if `every` is true or no output is declared, each output that is a flow,
        float32 (H, W, 2).
        """
        net = ModuleNet(self.module, way.layout or "pair", None, batched=True)
        convention = named_convention(order=way.order or "rgb", scaling=way.scaling or "0-1", multiple=self.multiple)
        images = [fitted_images([frame], convention, self.device) for frame in pair[:2]]
        returned = net.returned(*images)
        flows: dict[Declared, Flow] = {}
        declared = [] if way.output is None else [way.output]
        for output in dict.fromkeys([*declared, *(_outputs(returned) if every or not declared else [])]):
            try:
                flow = as_flow(chosen_output(returned, output), images[0])
            except ModelError:
                continue
            height, width = pair.frame1.shape[:2]
            fitted = unfitted_flow(flow, convention, height, width)[0].permute(1, 2, 0)
            flows[replace(way, output=output)] = fitted.float().cpu().numpy()
        if not flows:
            what = ", ".join(outputs_of(returned)) or type(returned).__name__
            raise ModelError(f"none of the outputs ({what[:200]}) is a flow (N, 2, H, W) at the frames' resolution")
        return flows


def _outputs(returned: Any) -> list[str | int]:
    if isinstance(returned, dict):
        return [str(key) for key in returned]
    return [0, LAST_OUTPUT] if isinstance(returned, list | tuple) and len(returned) > 1 else [LAST_OUTPUT]
