"""Intervals and tests on the very structure of the 80 evaluated pairs: which share a drive, and which do not say.

`docs/design/uncertainty.md` has the figures; this prints them:

    python -m tests.analysis.test_kitti_structure
"""

from __future__ import annotations

import numpy as np
import pytest

from robustflow.analysis.uncertainty import compare, intervals
from robustflow.datasets.kitti_drives import drive_groups, drives
from robustflow.datasets.split import kitti_split

from .simulated import SETTINGS, Truth, coverage, rows_of

KEYS = kitti_split([f"{number:06d}" for number in range(200)]).evaluation
SPREAD = 0.5


def _true_drives(unmapped: str) -> list[str]:
    """A drive for each pair; those the table does not know are each a drive, fives of neighbours, or whole runs."""
    known, groups = drives("kitti2015"), drive_groups("kitti2015")
    of_unmapped = {
        "singles": lambda key: key,
        "fives": lambda key: f"{groups[key]} {int(key) // 5}",
        "runs": lambda key: groups[key],
    }[unmapped]
    return [known[key] if key in known else of_unmapped(key) for key in KEYS]


def _model(rng: np.random.Generator, names: list[str], within: float) -> tuple[np.ndarray, np.ndarray]:
    """Errors of a model, clean (n,) and at the settings (n, 3), of which a share `within` of the variance of the
    logarithm is the pair's own and the rest its drive's; means 2, 3, 5 and 10."""
    order = {name: index for index, name in enumerate(dict.fromkeys(names))}
    shared = rng.normal(0, SPREAD * np.sqrt(1 - within), len(order))[[order[name] for name in names]]
    hard = np.exp(shared + rng.normal(0, SPREAD * np.sqrt(within), len(names)) - SPREAD**2 / 2)
    noise = rng.gamma(8, 1 / 8, (len(names), 1 + len(SETTINGS)))
    errors = np.array([2, 3, 5, 10]) * hard[:, None] * noise
    return errors[:, 0], errors[:, 1:]


def simulate(unmapped: str, within: float, repeats: int, seed: int, resamples: int = 499) -> dict[object, float]:
    """Percent of intervals that contain the truth, and of tests that call two equally good models different, with the
    table's groups and with none."""
    names, groups = _true_drives(unmapped), [drive_groups("kitti2015")[key] for key in KEYS]
    truth = {key: mean for key, mean in Truth().means.items() if key[1] in ("clean", "average")}

    def once(rng: np.random.Generator) -> dict[object, bool]:
        hits: dict[object, bool] = {}
        # Two models that are hard put by other drives, equally good on average over drives.
        (clean, corrupted), (clean2, corrupted2) = (_model(rng, names, within) for _ in range(2))
        for name, given in (("drives", groups), ("pairs", None)):
            first = rows_of(clean, corrupted, corrupted, given)
            second = rows_of(clean2, corrupted2, corrupted2, given)
            draw = int(rng.integers(2**31))
            for row in intervals(first, resamples=resamples, seed=draw).iter_rows(named=True):
                if (key := (row["metric"], row["corruption"])) in truth:
                    hits[name, "interval", *key] = row["low"] <= truth[key] <= row["high"]
            for row in compare(first, second, resamples=resamples, seed=draw).iter_rows(named=True):
                if row["corruption"] == "average":
                    hits[name, "test", row["metric"], "average"] = row["p"] < 0.05
        return hits

    return coverage(once, repeats, seed)


def span(found: dict[object, float], name: str, kind: str) -> tuple[float, float]:
    """Least and largest percent over the metrics."""
    values = [value for key, value in found.items() if key[:2] == (name, kind)]  # type: ignore[index]
    return min(values), max(values)


def test_drives_as_groups_cover_more_than_pairs():
    found = simulate("fives", 0.4, repeats=40, seed=1, resamples=199)
    assert span(found, "drives", "interval")[0] >= 80
    assert np.mean(span(found, "drives", "interval")) > np.mean(span(found, "pairs", "interval"))


@pytest.mark.slow
@pytest.mark.parametrize("unmapped", ["singles", "fives", "runs"])
def test_drives_as_groups_hold_the_level(unmapped):
    """Whatever the drives of the pairs that the table does not know."""
    found = simulate(unmapped, 0.4, repeats=600, seed=2)
    assert span(found, "drives", "interval")[0] >= 90, found
    assert span(found, "drives", "test")[1] <= 7.5, found
    assert span(found, "pairs", "interval")[1] <= 92, found
    assert span(found, "pairs", "test")[1] >= 10, found


if __name__ == "__main__":
    for within in (0.7, 0.4):
        for unmapped in ("singles", "fives", "runs"):
            found = simulate(unmapped, within, repeats=1000, seed=3)
            for name in ("pairs", "drives"):
                low, high = span(found, name, "interval")
                least, most = span(found, name, "test")
                print(
                    f"{1 - within:.1f} {unmapped:8} {name:6} {low:.1f} to {high:.1f}   {least:.1f} to {most:.1f}",
                    flush=True,
                )
