"""Rows of simulated runs with known true means, for measuring how often intervals and tests are correct."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import polars as pl

from robustflow.data.datasets.kitti import drive_groups
from robustflow.data.datasets.split import kitti_split
from robustflow.metrics.cube import AVERAGE
from robustflow.metrics.measures import MEASURES
from robustflow.metrics.rows import CLEAN
from robustflow.run.comparable import common_rows
from robustflow.stats.estimate import HEADLINE, OVERALL_SCOPES, contrast, cubes_of, estimate, scopes_of
from tests.made_rows import rows_frame
from tests.run.mean_rows import row

_KEYS = kitti_split([f"{number:06d}" for number in range(200)]).evaluation
KITTI_DRIVES = np.unique([drive_groups("kitti2015")[key] for key in _KEYS], return_counts=True)[1]
"""Numbers of evaluated pairs of KITTI-FC in each of the 30 groups."""
PIXELS = 1000
SETTINGS = (("fog", 1), ("fog", 3), ("snow", 2))


def rows_of(
    clean: np.ndarray, corrupted: np.ndarray, rcre: np.ndarray, groups: list[str] | None = None, digest: str = "d"
) -> pl.DataFrame:
    """Build rows from per-image errors: clean (n,), corrupted and rcre (n, 3), in pixels."""
    cells, rows = ((CLEAN, 0), *SETTINGS), []
    for index, (first, after, moved) in enumerate(zip(clean, corrupted, rcre, strict=True)):
        name = f"{index:05d}"
        lengths = {"magnitude_sum": 50.0 * PIXELS, "pred_magnitude_sum": 50.0 * PIXELS}
        same = {"group": groups[index] if groups else name, "height": 1, "n_all": PIXELS, **lengths}
        for cell, epe, change in zip(cells, (first, *after), (0.0, *moved), strict=True):
            own = {"frames_digest": f"{digest}{index}{cell[0]}{cell[1]}", "rcre_all_sum": PIXELS * float(change)}
            rows.append(row(name, *cell, PIXELS, float(epe), float(change), **same, **own))
    return rows_frame(rows)


@dataclass(frozen=True)
class Truth:
    """A population of images with flow-like errors: positive, skewed, and with some images that are hard in every
    condition.

    `spread` is the sigma of the logarithm of an image's difficulty; with `clusters`, a share `within` of its variance
    is due to the image and the rest to the sequence.
    """

    spread: float = 0.5
    within: float = 1.0

    def difficulty(self, rng: np.random.Generator, sizes: np.ndarray) -> np.ndarray:
        """Log-normal factors with mean 1, one per image, ordered by cluster."""
        shared = np.repeat(rng.normal(0, self.spread * math.sqrt(1 - self.within), len(sizes)), sizes)
        own = rng.normal(0, self.spread * math.sqrt(self.within), int(sizes.sum()))
        return np.exp(shared + own - self.spread**2 / 2)

    def draw(self, rng: np.random.Generator, sizes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Errors on the clean frames (n,), with mean 2, and under three conditions (n, 3), with means 3, 5 and 10."""
        hard = self.difficulty(rng, sizes)
        clean = 2 * hard * rng.gamma(8, 1 / 8, len(hard))
        corrupted = np.array([3, 5, 10]) * hard[:, None] * rng.gamma(8, 1 / 8, (len(hard), 3))
        return clean, corrupted

    @property
    def means(self) -> dict[tuple[str, str], float]:
        """The true means: (3 + 5) / 2 = 4 for fog, 10 for snow, and 7 on average."""
        return {
            ("epe", "clean"): 2.0,
            ("epe", "average"): 7.0,
            ("epe", "fog"): 4.0,
            ("cre", "average"): 5.0,
            ("cre", "snow"): 8.0,
            ("crer", "average"): 2.5,
            ("rcre", "average"): 7.0,
        }


def intervals(rows: pl.DataFrame, metrics: Collection[str] = HEADLINE, **options: Any) -> pl.DataFrame:
    """The estimates of the rows of one model; `families`, `severities` and `corruptions` choose the scopes."""
    (cube,) = cubes_of({"": rows}).values()
    more = {name: options.pop(name) for name in ("families", "severities") if name in options}
    scopes = scopes_of(cube, **more) if options.pop("corruptions", True) else OVERALL_SCOPES
    return estimate(cube, {name: MEASURES[name] for name in metrics}, scopes, **options)


def compare_all(runs: Mapping[str, pl.DataFrame], metric: str = "cre", **options: Any) -> pl.DataFrame:
    """The tests of every two models in the average of one measure."""
    rows, _ = common_rows(list(runs.values()), list(runs))
    cubes = cubes_of(dict(zip(runs, rows, strict=True)))
    return contrast(cubes, {metric: MEASURES[metric]}, [(AVERAGE, None)], **options)


def compare_rows(
    first: pl.DataFrame, second: pl.DataFrame, names: Sequence[str] = ("first", "second"), **options: Any
) -> pl.DataFrame:
    """The tests of two models in the headline measures, on average and under each corruption."""
    return contrast(cubes_of(dict(zip(names, common_rows((first, second), names)[0], strict=True))), **options)
