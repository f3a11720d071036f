"""`estimate` and `contrast`: means of any measure with intervals, and paired differences of models with their tests.

Both are rows of one frame. A mean enters as one pair of numbers for each cluster and condition, a sum over images and
their number (`Mean`): an `Average` is one of these, an `Increase` the difference of two over the same images, and a
`Ratio` two. Resampling weighs clusters, so the same weights serve all measures and models.

An image that is hard for one model is usually hard for the other, so differences are computed per image before
averaging, over what all compared models measured.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
import polars as pl

from ..core.errors import RunError
from ..corruptions.registry import MEMBERS, ordered
from ..metrics.cube import AVERAGE, Cube, Images, Scope
from ..metrics.measures import MEASURES, PERCENT, Average, Increase, Measure, Ratio, exact_mean
from ..metrics.rows import CLEAN
from ..run.comparable import common_cells
from .bootstrap import LEVEL, RESAMPLES, Interval, bootstrap, error_intervals, log_deviation
from .inference import mean_interval
from .ranking import holm
from .statistic import Array, ErrorMean, Mean, difference, of_data

HEADLINE = {name: MEASURES[name] for name in ("epe", "cre", "crer", "rcre")}
"""The paper's measures, which tables show unless others are asked for."""
OVERALL_SCOPES: tuple[Scope, ...] = ((CLEAN, None), (AVERAGE, None))
BLOW_UP = 10.0

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
    "level": pl.Float64,
}
"""`low` and `high` are the ends of the interval, null if there are too few clusters or the interval has no finite ends.
`log_deviation` is the standard deviation of the logarithms of the clusters' errors."""

CONTRASTS: dict[str, Any] = {
    "model": pl.String,
    "against": pl.String,
    **{name: ESTIMATES[name] for name in ("measure", "condition", "severity", "value", "low", "high")},
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
    "level": pl.Float64,
}
"""`value` is that of the model minus that of the one that it is compared `against`, over the images of both.
`p_adjusted` is p corrected for all `comparisons` of the measure. `wins` and `losses` count the images on which the
model is better or worse (for a ratio, by what is divided). `left_out` counts rows that only some of the compared models
have. `blow_ups_model` counts the images on which the model's error (EPE, or RCRE without ground truth) is more than
`BLOW_UP` times that of the other model, and `blow_ups_against` the reverse."""


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
    before: Array | None


class Joint:
    """The images that all of several models measured, in clusters that are common to all of them."""

    def __init__(self, cubes: Sequence[Cube]) -> None:
        self.cubes = _aligned(cubes)
        self.left_out = sum(cube.cell.size for cube in cubes) - sum(cube.cell.size for cube in self.cubes)
        self.clusters, self.cluster = joint_clusters(self.cubes)
        self._of: tuple[Measure, list[_Sums], set[int]] | None = None
        self._clean: dict[Measure, list[ErrorMean] | None] = {}

    def of(self, measure: Average | Increase) -> tuple[list[_Sums], set[int]]:
        """Return a measure of each model, and the columns in which all know it; one measure is in memory at a time."""
        if self._of is None or self._of[0] is not measure:
            self._of = None
            parts = [[cube.images(part) for part in measure.parts] for cube in self.cubes]
            missing = np.logical_or.reduce([np.isnan(images) for of_model in parts for images in of_model])
            number = self._add(~missing)
            known, sums = number.any(axis=0), []
            for of_model in parts:
                before = self._add(np.where(missing, 0.0, of_model[1])) if len(of_model) > 1 else None
                with np.errstate(invalid="ignore"):
                    values = np.subtract(*of_model) if len(of_model) > 1 else of_model[0]
                    of_model.clear()
                    values[missing] = np.nan
                    total = self._add(np.where(missing, 0.0, values))
                    known &= np.isfinite(total).all(axis=0)
                sums.append(_Sums(values, total, number, before))
            self._of = measure, sums, set(np.flatnonzero(known).tolist())
        return self._of[1:]

    def _add(self, images: Array) -> Array:
        if self.clusters == len(images):
            return np.asarray(images, np.float64)  # each image is a cluster
        added = np.zeros((self.clusters, images.shape[1]))
        np.add.at(added, self.cluster, images)
        return added

    def scope(self, measure: Measure, condition: str, severity: int | None) -> list[list[int]]:
        """Return the columns that a mean averages: those in which all models know the measure."""
        part = measure.above if isinstance(measure, Ratio) else measure
        if condition == CLEAN and not measure.on_clean:
            return []
        return self.cubes[0].scope(condition, severity, self.of(part)[1])

    def forms(self, measure: Measure, condition: str, severity: int | None = None) -> list[ErrorMean] | None:
        """Return the mean of each model as a function of the weights of the clusters; None where it is not known, or
        not a mean."""
        if isinstance(measure, Ratio):
            if measure.below not in self._clean:
                self._clean[measure.below] = self.forms(measure.below, CLEAN)
            above, below = self.forms(measure.above, condition, severity), self._clean[measure.below]
            if above is None or below is None:
                return None
            return [ErrorMean(one.mean, other.mean, relative=True) for one, other in zip(above, below, strict=True)]
        scope = self.scope(measure, condition, severity)
        if not scope or any(part.over is not exact_mean for part in measure.parts):
            return None
        columns, share = weights(scope)
        out = []
        for sums in self.of(measure)[0]:
            number = sums.number[:, columns]
            before = None if sums.before is None else Mean(sums.before[:, columns], number, share)
            mean = Mean(sums.total[:, columns], number, share)
            out.append(ErrorMean(mean, before if before is not None and before.total.any() else None))
        return out

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
    cluster of any model are in one cluster."""
    label = cubes[0].cluster.astype(np.int64)
    while True:
        before = label
        for cube in cubes:
            least = np.full(len(cube.groups), len(label))
            np.minimum.at(least, cube.cluster, label)
            label = least[cube.cluster]
        if np.array_equal(label, before):
            known, cluster = np.unique(label, return_inverse=True)
            return len(known), cluster


def estimate(
    cube: Cube,
    measures: Mapping[str, Measure] = HEADLINE,
    scopes: Iterable[Scope] | None = None,
    *,
    level: float = LEVEL,
    resamples: int = RESAMPLES,
    seed: int = 0,
) -> pl.DataFrame:
    """Return the known means of measures over scopes, with their intervals (`ESTIMATES`)."""
    joint, scopes = Joint([cube]), scopes_of(cube) if scopes is None else list(scopes)
    rows = []
    for name, measure in measures.items():  # one by one, to limit the memory of a million rows
        wanted = [at for at in scopes if measure.on_clean or at[0] != CLEAN]
        means = cube.means({name: measure}, wanted)
        known = {key: forms[0] for key in means if (forms := joint.forms(measure, *key[1:])) is not None}
        intervals = error_intervals(known, joint.clusters, level=level, resamples=resamples, seed=seed)
        for key, value in means.items():
            row: dict[str, Any] = dict(zip(ESTIMATES, key, strict=False)) | {"value": value, "level": level}
            row["pairs"] = int(np.isfinite(joint.of_images(measure, *key[1:])[0]).sum())
            if key in intervals:
                found = intervals[key]
                row |= {"standard_error": found.standard_error, "log_deviation": log_deviation(known[key])}
                row["clusters"] = int(np.count_nonzero(known[key].mean.count))
                row |= dict(zip(("low", "high"), _ends(measure, known[key].mean, found), strict=True))
            rows.append(row)
    return pl.DataFrame(rows, schema=ESTIMATES)


def _ends(measure: Measure, mean: Mean, found: Interval) -> tuple[float | None, float | None]:
    """Return the ends of an interval within the bounds of the measure; percentages have one on the logistic scale."""
    if measure.bounds != PERCENT:
        low, high = measure.bounds
        return (None, None) if found.low is None or found.high is None else (max(low, found.low), min(high, found.high))
    scores = mean.scores
    low, high = map(float, mean_interval(scores, bounded=True)) if scores.enough else (np.nan, np.nan)
    return (low, high) if low < high else (None, None)


def contrast(
    cubes: Mapping[str, Cube],
    measures: Mapping[str, Measure] = HEADLINE,
    scopes: Iterable[Scope] | None = None,
    *,
    level: float = LEVEL,
    resamples: int = RESAMPLES,
    seed: int = 0,
) -> pl.DataFrame:
    """Test each pair of models in each measure and scope that all of them know (`CONTRASTS`).

    Raises:
        RunError: the models have no image and condition in common.
    """
    names, joint = list(cubes), Joint(list(cubes.values()))
    scopes = scopes_of(joint.cubes[0]) if scopes is None else list(scopes)
    errors = {at: _errors(joint, at) for at in scopes}
    rows: dict[tuple[Any, ...], dict[str, Any]] = {}
    differences = {}
    for name, measure in measures.items():
        for at in scopes:
            forms = joint.forms(measure, *at)
            values = _values(joint, forms, measure, at)
            if values is None:
                continue
            of_images = joint.of_images(measure, *at)
            for one, other in combinations(range(len(names)), 2):
                key = (names[one], names[other], name, *at)
                row: dict[str, Any] = dict(zip(list(CONTRASTS)[:5], key, strict=True))
                row |= {"value_model": values[one], "value_against": values[other], "level": level}
                row |= {"value": values[one] - values[other], "left_out": joint.left_out}
                row |= _counts(measure, of_images[one], of_images[other], errors[at][one], errors[at][other])
                rows[key] = row
                if forms is not None:
                    differences[key] = difference(forms[one], forms[other])
                    row["clusters"] = int(np.count_nonzero(forms[one].mean.count))
    for key, found in bootstrap(differences, joint.clusters, level=level, resamples=resamples, seed=seed).items():
        rows[key] |= {"value": found.estimate, "low": found.low, "high": found.high, "p": found.p}
    if not rows:
        raise RunError(" and ".join(names), "no measured mean in common; robustflow report lists those of each")
    return _adjusted(pl.DataFrame(list(rows.values()), schema=CONTRASTS))


def _values(joint: Joint, forms: list[ErrorMean] | None, measure: Measure, at: Scope) -> list[float] | None:
    """Return the value of each model, over the images of all; None unless all have one."""
    if forms is not None:
        values = [of_data(form, joint.clusters).value for form in forms]
    elif joint.scope(measure, *at):
        found = [cube.mean(measure, *at) for cube in joint.cubes]
        values = [value for value in found if value is not None]
    else:
        return None
    return values if len(values) == len(joint.cubes) and np.isfinite(values).all() else None


def _errors(joint: Joint, at: Scope) -> list[Array]:
    """Return the error of each image, the EPE or the RCRE without ground truth, of each model."""
    epe, rcre = MEASURES["epe"], MEASURES["rcre"]
    return joint.of_images(epe if joint.scope(epe, *at) else rcre, *at)


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


def _adjusted(contrasts: pl.DataFrame) -> pl.DataFrame:
    """Add the p-values corrected for all tests of the same measure."""
    rows = contrasts.to_dicts()
    for measure in dict.fromkeys(contrasts["measure"]):
        tested = [row for row in rows if row["measure"] == measure and row["p"] is not None]
        for row, adjusted in zip(tested, holm([row["p"] for row in tested]), strict=True):
            row["p_adjusted"] = adjusted
        for row in rows:
            row["comparisons"] = len(tested) if row["measure"] == measure else row["comparisons"]
    return pl.DataFrame(rows, schema=CONTRASTS)
