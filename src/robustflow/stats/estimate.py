"""`estimate` and `contrast`: means of any measure with intervals, and paired differences of models with their tests.

Both are rows of one frame. A mean enters as one pair of numbers for each cluster (`inference.Scores`): an `Average` is
one of these, an `Increase` the difference of two over the same images, and a `Ratio` two.

An image that is hard for one model is usually hard for the other, so differences are computed per image before
averaging, over what all compared models measured. The mean of a measure is tested by itself; tests that are shown
together (all corruptions, all pairs of models) are corrected for each other.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
import polars as pl

from ..core.errors import RunError
from ..corruptions.registry import MEMBERS, ordered
from ..metrics.cube import AVERAGE, PAPER, Cube, Images, Scope, increase
from ..metrics.error_maps import crer
from ..metrics.measures import MEASURES, PERCENT, Average, Increase, Measure, Ratio, exact_mean
from ..metrics.rows import CLEAN
from ..run.comparable import common_cells
from .inference import FEWEST, INCREASE_FLOOR, Array, Scores, mean_interval, min_p, ratio_interval, ratio_of_means

HEADLINE = {name: MEASURES[name] for name in ("epe", "cre", "crer", "rcre")}
"""The paper's measures, which tables show unless others are asked for."""
OVERALL_SCOPES: tuple[Scope, ...] = ((CLEAN, None), (AVERAGE, None))
BLOW_UP = 10.0
_ROUNDING = 1e-12
"""Largest rounding error of a difference, as a share of the errors."""

ESTIMATES: dict[str, Any] = {
    "measure": pl.String,
    "condition": pl.String,
    "severity": pl.Int64,
    "value": pl.Float64,
    "standard_error": pl.Float64,
    "low": pl.Float64,
    "high": pl.Float64,
    "log_deviation": pl.Float64,
    "pairs": pl.Int64,
    "clusters": pl.Int64,
}
"""`low` and `high` are the ends of the 95 % interval, null below six clusters, or if all have the same value.
`log_deviation` is the standard deviation of the logarithms of the clusters' errors."""

CONTRASTS: dict[str, Any] = {
    "model": pl.String,
    "against": pl.String,
    **{name: ESTIMATES[name] for name in ("measure", "condition", "severity", "value", "low", "high")},
    "ratio": pl.Float64,
    "ratio_low": pl.Float64,
    "ratio_high": pl.Float64,
    "p": pl.Float64,
    "p_adjusted": pl.Float64,
    "comparisons": pl.Int64,
    "wins": pl.Int64,
    "losses": pl.Int64,
    "pairs": pl.Int64,
    "clusters": pl.Int64,
    "left_out": pl.Int64,
    "value_model": pl.Float64,
    "value_against": pl.Float64,
    "blow_ups_model": pl.Int64,
    "blow_ups_against": pl.Int64,
    "fewer_pixels": pl.String,
}
"""`value` is that of the model minus that of the one that it is compared `against`, over the images of both, and
`ratio` the one divided by the other, both with 95 % intervals. p is that of the sign-flip test over clusters (null
below six), and `p_adjusted` is corrected for all `comparisons` that are shown together. `wins` and `losses` count the
images on which the model is better or worse (for a ratio, by what is divided). `left_out` counts rows that only some of
the compared models have. `blow_ups_model` counts the images on which the model's error (EPE, or RCRE without ground
truth) is more than `BLOW_UP` times that of the other model, and `blow_ups_against` the reverse. `fewer_pixels` names
the model that predicted fewer pixels, if one did: its errors may be of easy ones."""


def cubes_of(rows: Mapping[str, pl.DataFrame]) -> dict[str, Cube]:
    """Return the cube of each model, with the families of corruptions."""
    return {name: Cube.of(of_model, MEMBERS) for name, of_model in rows.items()}


def scopes_of(cube: Cube, *, families: bool = False, severities: bool = False) -> list[Scope]:
    """List the clean frames, the average and the corruptions, starting with the paper's; then families and single
    severities."""
    names = ordered(cube.corruptions)
    scopes: list[Scope] = [*OVERALL_SCOPES, *((name, None) for name in names)]
    scopes += [(name, None) for name in MEMBERS if families and name not in names]
    return scopes + [(name, level) for name in names for level in cube.corruptions[name] if severities]


class _Sums(NamedTuple):
    """A measure of the images of one model: by image (S, K), and added up per cluster (G, K)."""

    images: Images
    total: Array
    number: Array


class Joint:
    """The images that all of several models measured, in clusters that are common to all of them."""

    def __init__(self, cubes: Sequence[Cube]) -> None:
        self.cubes = _aligned(cubes)
        self.left_out = sum(cube.cell.size for cube in cubes) - sum(cube.cell.size for cube in self.cubes)
        self.clusters, self.cluster = joint_clusters(self.cubes)
        self._of: tuple[Measure, list[_Sums], dict[int, bool]] | None = None
        self._clean: dict[Measure, list[Scores] | None] = {}

    def of(self, measure: Average | Increase) -> tuple[list[_Sums], dict[int, bool]]:
        """Return a measure of each model, and for each column that all measured whether it is defined for all; one
        measure is in memory at a time."""
        if self._of is None or self._of[0] is not measure:
            self._of = None
            parts = [[cube.images(part) for part in measure.parts] for cube in self.cubes]
            missing = np.logical_or.reduce([np.isnan(images) for of_model in parts for images in of_model])
            number = self._add(~missing)
            finite, sums = np.full(number.shape[1], True), []
            for of_model in parts:
                with np.errstate(invalid="ignore"):
                    values = increase(*of_model) if len(of_model) > 1 else of_model[0]
                    of_model.clear()
                    values[missing] = np.nan
                    total = self._add(np.where(missing, 0.0, values))
                    finite &= np.isfinite(total).all(axis=0)
                sums.append(_Sums(values, total, number))
            self._of = measure, sums, {k: bool(finite[k]) for k in np.flatnonzero(number.any(axis=0)).tolist()}
        return self._of[1:]

    def _add(self, images: Array) -> Array:
        if self.clusters == len(images):
            return np.asarray(images, np.float64)  # each image is a cluster
        added = np.zeros((self.clusters, images.shape[1]))
        np.add.at(added, self.cluster, images)
        return added

    def scope(self, measure: Measure, condition: str, severity: int | None) -> list[list[int]]:
        """Return the columns that a mean averages: those that all models measured; none if it is undefined in one."""
        part = measure.above if isinstance(measure, Ratio) else measure
        if condition == CLEAN and not measure.on_clean:
            return []
        defined = self.of(part)[1]
        scope = self.cubes[0].scope(condition, severity, defined)
        return scope if all(defined[k] for columns in scope for k in columns) else []

    def scores(self, measure: Average | Increase, condition: str, severity: int | None = None) -> list[Scores] | None:
        """Return what each cluster adds to the mean of each model; None where it is not known, or not a mean."""
        scope = self.scope(measure, condition, severity)
        if not scope or any(part.over is not exact_mean for part in measure.parts):
            return None
        columns, share = weights(scope)
        out = []
        for sums in self.of(measure)[0]:
            total, number = sums.total[:, columns], sums.number[:, columns]
            images = number.sum(axis=0)
            mean = total.sum(axis=0) / images
            den = number / images @ share
            # a cluster without some of the conditions counts as average there
            out.append(Scores((total - mean * number) / images @ share + mean @ share * den, den))
        return out

    def clean_scores(self, measure: Average) -> list[Scores] | None:
        """Return the `scores` of a measure on the clean frames, by which ratios divide."""
        if measure not in self._clean:
            self._clean[measure] = self.scores(measure, CLEAN)
        return self._clean[measure]

    def of_images(self, measure: Measure, condition: str, severity: int | None = None) -> list[Array]:
        """Return the mean of each image over a scope, of each model, float64 (S,); NaN where nothing was measured. Of a
        ratio, it is that of what is divided."""
        part = measure.above if isinstance(measure, Ratio) else measure
        columns, share = weights(self.scope(part, condition, severity))
        means = []
        for images, *_ in self.of(part)[0]:
            known = ~np.isnan(images[:, columns])
            with np.errstate(invalid="ignore"):
                means.append(np.where(known, images[:, columns], 0.0) @ share / (known @ share))
        return means


def weights(scope: Sequence[Sequence[int]]) -> tuple[list[int], Array]:
    """Return the columns of a scope and the weight of each: the same averaging as that of exact means.

    >>> weights([[4], [1, 2]])
    ([4, 1, 2], array([0.5 , 0.25, 0.25]))
    """
    share = [1.0 / (len(scope) * len(columns)) for columns in scope for _ in columns]
    return [column for columns in scope for column in columns], np.array(share)


def _aligned(cubes: Sequence[Cube]) -> list[Cube]:
    """Return the cubes of the images and conditions that all have."""
    first = cubes[0]
    if all((cube.samples, cube.conditions) == (first.samples, first.conditions) for cube in cubes):
        return list(cubes)
    rows = common_cells([cube.rows.collect() for cube in cubes])
    return [Cube.of(of_cube, MEMBERS) for of_cube in rows]


def joint_clusters(cubes: Sequence[Cube]) -> tuple[int, np.ndarray]:
    """Return the number of clusters of several models together, and the cluster of each image: images that are in one
    cluster of any model, or have equal frames under several names, are in one cluster."""
    label = cubes[0].cluster.astype(np.int64)
    parts = [part for cube in cubes for part in (cube.cluster, cube.alike)]
    while True:
        before = label
        for part in parts:
            least = np.full(len(label), len(label))
            np.minimum.at(least, part, label)
            label = least[part]
        if np.array_equal(label, before):
            known, cluster = np.unique(label, return_inverse=True)
            return len(known), cluster


def estimate(
    cube: Cube, measures: Mapping[str, Measure] = HEADLINE, scopes: Iterable[Scope] | None = None
) -> pl.DataFrame:
    """Return the known means of measures over scopes, with their intervals (`ESTIMATES`)."""
    joint, scopes = Joint([cube]), scopes_of(cube) if scopes is None else list(scopes)
    rows = []
    for name, measure in measures.items():  # one by one, to limit the memory of a million rows
        wanted = [at for at in scopes if measure.on_clean or at[0] != CLEAN]
        for key, value in cube.means({name: measure}, wanted).items():
            row: dict[str, Any] = dict(zip(ESTIMATES, key, strict=False)) | {"value": value}
            row["pairs"] = int(np.isfinite(joint.of_images(measure, *key[1:])[0]).sum())
            rows.append(row | _uncertainty(joint, measure, key[1:]))
    return pl.DataFrame(rows, schema=ESTIMATES)


def _uncertainty(joint: Joint, measure: Measure, at: Scope) -> dict[str, Any]:
    """Return the standard error and the interval of a mean of one model."""
    below = joint.clean_scores(measure.below) if isinstance(measure, Ratio) else None
    top = joint.scores(measure.above if isinstance(measure, Ratio) else measure, *at)
    if top is None or (isinstance(measure, Ratio) and below is None):
        return {}
    (scores,) = top
    linear = scores if below is None else _linearised(scores, below[0], float(scores.mean / below[0].mean))
    out = {"clusters": scores.clusters, "standard_error": float(linear.error) if scores.clusters > 1 else None}
    if isinstance(measure, Average):
        values = scores.num[scores.den > 0] / scores.den[scores.den > 0]
        if len(values) > 1 and values.min() > 0:
            out["log_deviation"] = float(np.log(values).std(ddof=1))
    if not scores.enough:
        return out
    if below is not None:
        ends = ratio_interval(scores, below[0])
    else:
        floor = {"floor": INCREASE_FLOOR} if isinstance(measure, Increase) else {}
        ends = mean_interval(scores, bounded=measure.bounds == PERCENT, **floor)
    low, high = (float(end) for end in ends)
    least, most = measure.bounds
    return out | ({"low": max(low, least), "high": min(high, most)} if np.isfinite([low, high]).all() else {})


def _linearised(above: Scores, below: Scores, ratio: float) -> Scores:
    """Return what each cluster adds to a ratio of means less `ratio`, to first order."""
    return Scores((above.num - ratio * below.num) / below.mean, above.den)


def contrast(
    cubes: Mapping[str, Cube], measures: Mapping[str, Measure] = HEADLINE, scopes: Iterable[Scope] | None = None
) -> pl.DataFrame:
    """Test each pair of models in each measure and scope that all of them know (`CONTRASTS`).

    Raises:
        RunError: the models have no image and condition in common.
    """
    names, joint = list(cubes), Joint(list(cubes.values()))
    scopes = scopes_of(joint.cubes[0]) if scopes is None else list(scopes)
    errors = {at: _errors(joint, at) for at in scopes}
    shares = {at: _values(joint, MEASURES["coverage"], at)[0] for at in scopes}
    rows = []
    for name, measure in measures.items():
        together: dict[str, list[tuple[dict[str, Any], Array]]] = {}
        for at in scopes:
            values, scores = _values(joint, measure, at)
            if values is None:
                continue
            of_images = joint.of_images(measure, *at)
            for one, other in combinations(range(len(names)), 2):
                row: dict[str, Any] = dict(zip(CONTRASTS, (names[one], names[other], name, *at), strict=False))
                row |= {"value_model": values[one], "value_against": values[other], "left_out": joint.left_out}
                row["value"] = values[one] - values[other]
                row["fewer_pixels"] = _fewer(row, shares[at], one, other)
                row |= _counts(measure, of_images[one], of_images[other], errors[at][one], errors[at][other])
                if scores is not None:
                    row |= _interval(measure, scores[one], scores[other])
                    if scores[one].clusters >= FEWEST:
                        together.setdefault(_family(at), []).append((row, _differences(scores[one], scores[other]).num))
                rows.append(row)
        for tests in together.values():
            for (row, _), p, adjusted in zip(tests, *min_p(np.array([num for _, num in tests])), strict=True):
                row |= {"p": float(p), "p_adjusted": float(adjusted), "comparisons": len(tests)}
    if not rows:
        raise RunError(" and ".join(names), "no measured mean in common; robustflow report lists those of each")
    return pl.DataFrame(rows, schema=CONTRASTS)


def _family(at: Scope) -> str:
    """Return which tests of a measure are shown together: means by themselves, families, corruptions, severities."""
    condition, severity = at
    if severity is not None:
        return "severities"
    return condition if condition in (CLEAN, AVERAGE, PAPER) else "families" if condition in MEMBERS else "corruptions"


def _differences(one: Scores, other: Scores) -> Scores:
    """Return the differences of clusters, of which those from rounding are 0."""
    num = one.num - other.num
    return Scores(np.where(np.abs(num) > _ROUNDING * (np.abs(one.num) + np.abs(other.num)), num, 0.0), one.den)


def _interval(measure: Measure, one: Scores, other: Scores) -> dict[str, Any]:
    """Return the interval of a difference, and of the ratio of two positive means."""
    difference = _differences(one, other)
    row: dict[str, Any] = {"clusters": one.clusters}
    if difference.enough:
        low, high = (float(end) for end in mean_interval(difference))
        row |= {"low": low, "high": high} if np.isfinite([low, high]).all() else {}
    if isinstance(measure, Average) and other.mean > 0 and one.mean > 0 and measure.bounds[0] >= 0:
        row["ratio"] = float(one.mean / other.mean)
        if (ends := ratio_of_means(one.num, other.num)) is not None:
            row |= {"ratio_low": ends[0], "ratio_high": ends[1]}
    return row


def _values(joint: Joint, measure: Measure, at: Scope) -> tuple[list[float] | None, list[Scores] | None]:
    """Return the value of each model over the images of all, None unless all have one, and what each cluster adds to
    it; for ratios, what each cluster adds to the difference from the mean ratio of all models, to first order."""
    if isinstance(measure, Ratio):
        below, above = joint.clean_scores(measure.below), joint.scores(measure.above, *at)
        if above is None or below is None:
            return None, None
        ratios = [crer(float(top.mean), float(bottom.mean)) for top, bottom in zip(above, below, strict=True)]
        values = [ratio for ratio in ratios if ratio is not None]
        if len(values) < len(ratios):
            return None, None
        center = exact_mean(values)
        return values, [_linearised(*both, center) for both in zip(above, below, strict=True)]
    scores = joint.scores(measure, *at)
    if scores is not None:
        return [float(of_model.mean) for of_model in scores], scores
    if not joint.scope(measure, *at):
        return None, None
    known = [cube.mean(measure, *at) for cube in joint.cubes]
    return (None if None in known else [value for value in known if value is not None]), None


def _errors(joint: Joint, at: Scope) -> list[Array]:
    """Return the error of each image, the EPE or the RCRE without ground truth, of each model."""
    epe, rcre = MEASURES["epe"], MEASURES["rcre"]
    return joint.of_images(epe if joint.scope(epe, *at) else rcre, *at)


def _fewer(row: Mapping[str, Any], shares: Sequence[float] | None, one: int, other: int) -> str | None:
    """Return the name of the model that predicted fewer pixels."""
    if shares is None or abs(shares[one] - shares[other]) < _ROUNDING:
        return None
    return str(row["model"] if shares[one] < shares[other] else row["against"])


def _counts(measure: Measure, one: Array, other: Array, error: Array, of_other: Array) -> dict[str, int | None]:
    """Count images: all, those on which either model is better, and those on which one fails."""
    lower, higher = int(np.count_nonzero(one < other)), int(np.count_nonzero(one > other))
    wins, losses = (lower, higher) if measure.better < 0 else (higher, lower)
    return {
        "pairs": int(np.isfinite(one).sum()),
        "wins": wins if measure.better else None,
        "losses": losses if measure.better else None,
        "blow_ups_model": int(np.count_nonzero(error > BLOW_UP * of_other)),
        "blow_ups_against": int(np.count_nonzero(of_other > BLOW_UP * error)),
    }
