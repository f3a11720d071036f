"""Check intervals and tests on data grouped like the 80 evaluated pairs, some of which come from the same drive.

The following command prints the numbers in `docs/design/uncertainty.md`:

    python -m tests.stats.test_kitti_structure
"""

from __future__ import annotations

import numpy as np
import pytest

from robustflow.data.datasets.kitti import drive_groups, drives
from robustflow.data.datasets.split import kitti_split
from robustflow.stats.bootstrap import bootstrap, error_intervals
from robustflow.stats.statistic import ErrorMean

from .simulated import mean_of

KEYS = kitti_split([f"{number:06d}" for number in range(200)]).evaluation
GROUPS = {"pairs": KEYS, "drives": [drive_groups("kitti2015")[key] for key in KEYS]}
SPREAD = 0.5


def _true_drives(unmapped: str) -> list[str]:
    """Drive of each pair. Pairs without a known drive are treated as separate drives, as groups of five
    consecutive numbers, or as groups between known drives, depending on `unmapped`."""
    known, groups = drives("kitti2015"), drive_groups("kitti2015")
    of_unmapped = {
        "singles": lambda key: key,
        "fives": lambda key: f"{groups[key]} {int(key) // 5}",
        "runs": lambda key: groups[key],
    }[unmapped]
    return [known[key] if key in known else of_unmapped(key) for key in KEYS]


def _numbers(names: list[str]) -> np.ndarray:
    order = {name: index for index, name in enumerate(dict.fromkeys(names))}
    return np.array([order[name] for name in names])


def simulate(unmapped: str, shared: float, repeats: int, seed: int = 1) -> dict[str, tuple[float, float]]:
    """For each grouping ("pairs", "drives"), the percentage of 95 % intervals of a mean that contain the true mean, and
    of tests at the 5 % level that call two equally good models different.

    Difficulties are log-normal; a share `shared` of the variance of the logarithm is due to the drive.
    """
    rng, true = np.random.default_rng(seed), _numbers(_true_drives(unmapped))
    given = {name: _numbers(groups) for name, groups in GROUPS.items()}
    hits: dict[str, list[tuple[bool, bool]]] = {name: [] for name in given}

    def difficulty() -> np.ndarray:
        of_drive = rng.normal(0, SPREAD * np.sqrt(shared), true.max() + 1)[true]
        return np.exp(of_drive + rng.normal(0, SPREAD * np.sqrt(1 - shared), len(KEYS)) - SPREAD**2 / 2)

    for repeat in range(repeats):
        errors = difficulty() * rng.gamma(8, 1 / 8, len(KEYS))
        difference = difficulty() - difficulty()
        for name, groups in given.items():
            options = {"clusters": int(groups.max()) + 1, "resamples": 599, "seed": repeat}
            interval = error_intervals({0: ErrorMean(mean_of(errors, groups))}, **options)[0]
            test = bootstrap({0: mean_of(difference, groups)}, **options)[0]
            assert interval.low is not None
            assert interval.high is not None
            assert test.p is not None
            hits[name].append((interval.low <= 1 <= interval.high, test.p < 0.05))
    return {name: tuple(100 * np.mean(each, axis=0)) for name, each in hits.items()}  # type: ignore[misc]


def test_drives_as_groups_cover_more_than_pairs():
    found = simulate("fives", 0.6, repeats=80)
    assert found["drives"][0] >= 84
    assert found["drives"][0] > found["pairs"][0]
    assert found["drives"][1] < found["pairs"][1]


@pytest.mark.slow
@pytest.mark.parametrize("unmapped", ["singles", "fives", "runs"])
def test_drives_as_groups_hold_the_level(unmapped):
    """The statement holds regardless of how the unmapped pairs are assigned to drives."""
    found = simulate(unmapped, 0.6, repeats=600)
    assert found["drives"][0] >= 90, found
    assert found["drives"][1] <= 7.5, found
    assert found["pairs"][0] <= 90, found
    assert found["pairs"][1] >= 10, found


if __name__ == "__main__":
    for shared in (0.3, 0.6, 0.8):
        for unmapped in ("singles", "fives", "runs"):
            for name, (covered, rejected) in simulate(unmapped, shared, repeats=600).items():
                print(f"{shared:.1f} {unmapped:8} {name:6} {covered:5.1f} {rejected:5.1f}", flush=True)
