"""Split the variance of a score into components for images, the corruptions' seed, and severity.

Let y_ijk be the score of image i with seed j at severity k, averaged over corruptions. The mean squares of the crossed
analysis of variance (one value per cell) give the components by the method of moments, with negative ones set to 0
(Searle, Casella and McCulloch 1992, ch. 4). Severities are chosen by the protocol, not sampled, so their component is
reported but not included in the error of the mean, which depends on images and seeds only:

    var(mean) = image / n + seed / s + r / (n s)

where r is the interaction of image and seed, averaged over severities. The rest of one score y_ijk is r and the
variation within an image and seed: all interactions with the severity and the noise.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import polars as pl

from ..core.errors import RunError, unknown_name
from ..metrics.cube import Cube, averaged_rows
from ..metrics.measures import EVERY, Average, Increase, Ratio
from ..metrics.rows import CLEAN
from .estimate import Joint

VARIANCE_SCHEMA: dict[str, Any] = {
    "source": pl.String,
    "levels": pl.Int64,
    "deviation": pl.Float64,
    "share": pl.Float64,
    "error_of_mean": pl.Float64,
}
"""`deviation` is the standard deviation in pixels that a source causes in the score of one image, `share` its
percentage of the total variance, and `error_of_mean` its contribution to the standard error of the mean in pixels (null
for severity)."""


def variance_split(runs: Mapping[int, pl.DataFrame], metric: str = "cre") -> pl.DataFrame:
    """Split the variance of one model's score into parts for image, seed, severity and the rest."""
    measure = EVERY.get(metric)
    if measure is None or isinstance(measure, Ratio):
        raise unknown_name("metric", metric, [name for name, one in EVERY.items() if not isinstance(one, Ratio)])
    if len(runs) < 2:
        raise RunError(
            "--seeds", "the variance between seeds needs at least two; run the same model with --seeds 2 or more"
        )
    y = _cells(runs, measure)
    images, seeds, levels = y.shape
    if images < 2:
        raise RunError(
            "fewer than two images were measured with every seed; the variance between images needs at least two"
        )
    both = _mean_square(y, 0, 1)
    per_image = max(0.0, (_mean_square(y, 0) - both) / (seeds * levels))
    per_seed = max(0.0, (_mean_square(y, 1) - both) / (images * levels))
    per_level = _mean_square(y, 2) / (images * seeds)
    # Severities are fixed, so within an image and seed the variance is (levels - 1) / levels of the mean squares.
    within = _mean_square(y, 0, 2) / seeds + _mean_square(y, 1, 2) / images
    within += _mean_square(y, 0, 1, 2) * (1 - 1 / images - 1 / seeds)
    rest = (both + within * (levels - 1)) / levels
    parts = [
        ("image", images, per_image, per_image / images),
        ("seed", seeds, per_seed, per_seed / seeds),
        ("severity", levels, per_level, None),
        ("rest", y.size, rest, both / (images * seeds * levels)),
    ]
    whole = sum(variance for _, _, variance, _ in parts) or 1.0
    records = [
        (name, count, float(variance**0.5), 100 * variance / whole, None if of_mean is None else float(of_mean**0.5))
        for name, count, variance, of_mean in parts
    ]
    return pl.DataFrame(records, schema=VARIANCE_SCHEMA, orient="row")


def _mean_square(y: np.ndarray, *axes: int) -> float:
    """Compute the mean square of the main effect of an axis or of the interaction of several; 0 for a single level."""
    effect = y
    for axis in range(y.ndim):
        mean = effect.mean(axis=axis, keepdims=True)
        effect = effect - mean if axis in axes else mean
    freedom = math.prod(y.shape[axis] - 1 for axis in axes)
    return y.size / effect.size * float(np.square(effect).sum()) / freedom if freedom else 0.0


def _cells(runs: Mapping[int, pl.DataFrame], measure: Average | Increase) -> np.ndarray:
    """Average over the corruptions that all runs have at all severities, as float64 (images, seeds, severities)."""
    joint = Joint([Cube.of(averaged_rows(rows)) for rows in runs.values()])
    y = np.array([sums.images for sums in joint.of(measure)[0]])
    seen = ~np.isnan(y[0])
    columns = {at: k for k, at in enumerate(joint.cubes[0].conditions) if at[0] != CLEAN}
    most = max((seen[:, k].sum() for k in columns.values()), default=0)
    full = {at for at, k in columns.items() if seen[:, k].sum() == most > 0}
    levels = sorted({level for _, level in full})
    whole = [name for name in joint.cubes[0].corruptions if all((name, level) in full for level in levels)]
    chosen = [columns[name, level] for name in whole for level in levels]
    complete = seen[:, chosen].all(axis=1)
    if not chosen or not complete.any():
        raise RunError(
            "no image was measured with every seed under the same corruptions and severities; "
            "run all seeds on the same pairs"
        )
    scores = y[:, complete][:, :, chosen].reshape(len(y), -1, len(whole), len(levels))
    return np.asarray(scores.mean(axis=2).transpose(1, 0, 2))
