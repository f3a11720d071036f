"""Measure how well a confidence map predicts flow errors (sparsification, AUSE, rank correlation), and check
forward-backward consistency.

Sparsification removes the least confident pixels first, and reports the mean error of the remaining pixels after
removing 0, 1, ... 99 % of them. The oracle removes the largest errors first. AUSE is the mean difference between the
two curves, i.e. the area between them; the curves meet at 0 % and at 100 % (Ilg et al., Uncertainty Estimates and
Multi-Hypotheses Networks for Optical Flow, ECCV 2018). Ties in confidence are averaged over all orderings of the tied
pixels, so the pixel order does not affect the result, and a constant confidence scores the same as a random one does on
average.

The forward-backward check is that of Sundaram, Brox and Keutzer (Dense Point Trajectories by GPU-accelerated Large
Displacement Optical Flow, ECCV 2010): a pixel is rejected where

    |w + w'|^2 >= 0.01 (|w|^2 + |w'|^2) + 0.5

where w is the forward flow at the pixel and w' the backward flow, interpolated bilinearly at the pixel's target. UnFlow
and ARFlow use the same constants.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ..core.errors import DataError
from ..core.types import Flow, Mask, unmasked

STEPS = 100
"""Number of steps of the sparsification curve."""

ALPHA_1 = 0.01
"""Weight of the sum of the squared flow magnitudes in the consistency tolerance."""
ALPHA_2 = 0.5
"""Constant term of the consistency tolerance, in squared pixels."""

Values = npt.NDArray[np.float64]


class Sparsification(NamedTuple):
    """Mean errors, in pixels, of the pixels that remain after removing 0, 1, ... 99 % of them."""

    by_confidence: Values
    by_error: Values

    @property
    def ause(self) -> float:
        """Return the area between the two curves, in pixels."""
        return max(0.0, float(np.cumsum(self.by_confidence - self.by_error)[-1]) / STEPS)


def sparsification(error: Any, confidence: Any) -> Sparsification | None:
    """Return the sparsification curves of an image, or None if every error is NaN."""
    errors, sure = _finite_values(error, confidence)
    if not errors.size:
        return None
    return Sparsification(_curve(errors, -sure), _curve(errors, errors))


def ause(error: Any, confidence: Any) -> float | None:
    """Return the area between the sparsification curve and the oracle curve, in pixels, or None if every error is NaN.
    Takes the same arguments and raises the same errors as `sparsification`.
    """
    curves = sparsification(error, confidence)
    return None if curves is None else curves.ause


def error_at(error: Any, confidence: Any, coverage: float) -> float | None:
    """Return the mean error of the most confident fraction of the pixels, or None if every error is NaN."""
    if not 0.5 / STEPS < coverage <= 1:  # also NaN
        raise DataError("coverage", f"{coverage:g} is out of range: choose a value from 0.01 to 1")
    removed = round(STEPS * (1 - coverage))
    curves = sparsification(error, confidence)
    return None if curves is None else float(curves.by_confidence[removed])


def confidence_correlation(error: Any, confidence: Any) -> float | None:
    """Return Spearman's rank correlation between confidence and error, or None if either is constant; -1 is best, and
    tied values get their mean rank. Takes the same arguments and raises the same errors as `sparsification`.
    """
    errors, sure = _finite_values(error, confidence)
    if not errors.size:
        return None
    of_errors, of_sure = _ranks(errors), _ranks(sure)
    scale = _product(of_errors, of_errors) * _product(of_sure, of_sure)
    return _product(of_errors, of_sure) / float(scale) ** 0.5 if scale else None


def forward_backward(flow: Flow, back: Flow) -> tuple[Values, Mask]:
    """Measure how well the backward flow inverts the forward flow."""
    if flow.shape != back.shape or flow.ndim != 3 or flow.shape[2] != 2:
        raise DataError(
            "back", f"the forward flow {flow.shape} and the backward flow {back.shape} must both be (H, W, 2)"
        )
    there = flow.astype(np.float64)
    height, width = flow.shape[:2]
    y, x = np.mgrid[:height, :width]
    known = np.isfinite(there).all(axis=2)
    at_x = np.where(known, x + there[..., 0], -1.0)
    at_y = np.where(known, y + there[..., 1], -1.0)
    inside = (at_x >= 0) & (at_x <= width - 1) & (at_y >= 0) & (at_y <= height - 1)
    home = np.full(there.shape, np.nan)
    with np.errstate(invalid="ignore"):
        home[inside] = _bilinear(back.astype(np.float64), at_x[inside], at_y[inside])
    miss = (there + home) ** 2
    squared = miss[..., 0] + miss[..., 1]
    with np.errstate(invalid="ignore"):
        allowed = ALPHA_1 * ((there**2).sum(axis=2) + (home**2).sum(axis=2)) + ALPHA_2
        accepted = squared < allowed  # False where the flow is NaN
    return np.where(np.isfinite(squared), -np.sqrt(squared), -np.inf), ~accepted


def _bilinear(field: Values, x: Values, y: Values) -> Values:
    """Interpolate a field (H, W, 2) bilinearly at points inside the field."""
    left, top = x.astype(np.int64), y.astype(np.int64)
    right, below = np.ceil(x).astype(np.int64), np.ceil(y).astype(np.int64)  # NaN beside a point does not affect it
    across, down = (x - left)[:, None], (y - top)[:, None]
    upper = field[top, left] * (1 - across) + field[top, right] * across
    lower = field[below, left] * (1 - across) + field[below, right] * across
    mixed: Values = upper * (1 - down) + lower * down
    return mixed


def _finite_values(error: Any, confidence: Any) -> tuple[Values, Values]:
    errors, sure = (np.asarray(unmasked(values), np.float64) for values in (error, confidence))
    if errors.shape != sure.shape:
        raise DataError("confidence", f"its shape is {sure.shape}, but the errors have shape {errors.shape}")
    keep = ~np.isnan(errors)
    errors, sure = errors[keep], sure[keep]
    if np.isnan(sure).any():
        raise DataError("confidence", f"NaN at {int(np.isnan(sure).sum())} pixels; it must be a number or -inf")
    return errors, sure


def _curve(errors: Values, key: Values) -> Values:
    """Return the mean error of the pixels with the smallest keys, for each number of pixels kept."""
    order = np.argsort(key, kind="stable")
    total = np.concatenate(([0.0], np.cumsum(errors[order])))
    ends = _ends_of_ties(key[order])
    count = errors.size
    counts = -(-count * (STEPS - np.arange(STEPS)) // STEPS)
    curve: Values = np.interp(counts, ends, total[ends]) / counts
    return curve


def _ends_of_ties(ordered: Values) -> npt.NDArray[np.int64]:
    """Return the start indices of runs of equal values, followed by the total number of values."""
    changes = np.flatnonzero(ordered[1:] != ordered[:-1]) + 1
    return np.concatenate(([0], changes, [ordered.size]))


def _ranks(values: Values) -> npt.NDArray[np.int64]:
    """Return twice the distance between each value's mean rank and the median rank, as integers."""
    order = np.argsort(values, kind="stable")
    ends = _ends_of_ties(values[order])
    ranks = np.empty(values.size, np.int64)
    ranks[order] = np.repeat(ends[:-1] + ends[1:] - values.size, np.diff(ends))
    return ranks


def _product(first: npt.NDArray[np.int64], second: npt.NDArray[np.int64]) -> int:
    """Return the exact dot product of `_ranks`, each below the number of values: chunks whose products cannot overflow
    are summed in int64, and their sums as Python integers."""
    chunk = max(1, 2**62 // first.size**2)
    parts = (slice(start, start + chunk) for start in range(0, first.size, chunk))
    return sum(int((first[part] * second[part]).sum()) for part in parts)
