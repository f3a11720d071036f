"""The losses of attacks: distances between a flow and a reference over the valid pixels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ..core.errors import UsageError, unknown_name
from ..core.types import Flow, Mask

LOSSES = ("epe", "mse", "cosine", "capped")
"""`epe`: mean end-point error; `mse`: mean squared difference of u and v; `cosine`: 1 minus the cosine between flow and
reference; `capped`: the end-point error of each pixel, capped at the frame's diagonal, so that a few pixels with huge
flow cannot dominate the mean."""

_Map = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Loss:
    """The mean distance between a flow and a reference over the valid pixels, with its derivative."""

    reference: Flow
    valid: Mask | None = None
    kind: str = "epe"
    towards: bool = False
    agreeing: bool = False

    def __post_init__(self) -> None:
        if self.kind not in LOSSES:
            raise unknown_name("attack loss", self.kind, LOSSES)
        if self.valid is not None and not self.valid.any():
            raise UsageError("valid", "the ground truth has no valid pixels, so there is nothing to attack")

    def of(self, flow: Flow, weighted: bool = True) -> float:
        """Compute the loss of a flow, float32 (H, W, 2), including CosPGD's weight unless `weighted` is False."""
        values, _ = self._parts(flow, weighted)
        return float(values[self._counted].mean())

    def slope(self, flow: Flow) -> tuple[float, Flow]:
        """Compute the loss of a flow and its gradient with respect to the flow, float32 (H, W, 2)."""
        values, slopes = self._parts(flow, True)
        counted = self._counted
        slopes = np.where(counted[..., None], slopes, 0) / np.count_nonzero(counted)
        return float(values[counted].mean()), slopes.astype(np.float32)

    def score(self, loss: float) -> float:
        """Compute the score, which attacks maximise: the loss, or its negative if the reference is a target."""
        return -loss if self.towards else loss

    @property
    def _counted(self) -> Mask:
        return np.ones(self.reference.shape[:2], bool) if self.valid is None else self.valid

    def _parts(self, flow: Flow, weighted: bool) -> tuple[_Map, _Map]:
        """Return the loss of each pixel (H, W) and its derivative (H, W, 2)."""
        with np.errstate(invalid="ignore", over="ignore"):  # the flow can be infinite
            values, slopes = _DISTANCES[self.kind](flow.astype(np.float64), self.reference.astype(np.float64))
            if not (self.agreeing and weighted):
                return values, slopes
            first, second = _softmax(flow), _softmax(self.reference)
            weight = (first * second).sum(axis=-1) / (np.linalg.norm(first, axis=-1) * np.linalg.norm(second, axis=-1))
        weight = 1 - weight if self.towards else weight
        return weight * values, weight[..., None] * slopes


def _epe(flow: _Map, reference: _Map) -> tuple[_Map, _Map]:
    difference = flow - reference
    lengths = np.hypot(difference[..., 0], difference[..., 1])
    return lengths, _divided(difference, lengths[..., None])


def _capped(flow: _Map, reference: _Map) -> tuple[_Map, _Map]:
    lengths, slopes = _epe(flow, reference)
    most = float(np.hypot(*flow.shape[:2]))
    return np.minimum(lengths, most), np.where(lengths[..., None] < most, slopes, 0)


def _mse(flow: _Map, reference: _Map) -> tuple[_Map, _Map]:
    difference = flow - reference
    return (difference**2).mean(axis=-1), difference


def _cosine(flow: _Map, reference: _Map) -> tuple[_Map, _Map]:
    lengths = np.linalg.norm(flow, axis=-1, keepdims=True)
    along = _divided(flow, lengths)
    direction = _divided(reference, np.linalg.norm(reference, axis=-1, keepdims=True))
    cosines = (along * direction).sum(axis=-1)
    return 1 - cosines, _divided(cosines[..., None] * along - direction, lengths)


_DISTANCES = {"epe": _epe, "mse": _mse, "cosine": _cosine, "capped": _capped}


def _divided(above: _Map, below: _Map) -> _Map:
    """Divide; the result is 0 where the divisor is 0."""
    out: _Map = np.divide(above, below, out=np.zeros_like(above), where=below > 0)
    return out


def _softmax(flow: npt.NDArray[Any]) -> _Map:
    """Apply the softmax over (u, v) of each pixel."""
    powers: _Map = np.exp((flow - flow.max(axis=-1, keepdims=True)).astype(np.float64))
    out: _Map = powers / powers.sum(axis=-1, keepdims=True)
    return out
