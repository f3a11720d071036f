"""Random corruptions: the mean of every statistic over our seeds is compared with its mean over the reference's 16
seeds.

The test follows the README of the reference folder: means may differ by four standard errors plus a floor. The
exceptions are also explained there: for glass blur, the fraction of white samples (the reference truncates 254.999..)
and half a grey level in the standard deviations.
"""

import numpy as np
import pytest

from robustflow.core.rng import Rng

from . import reference
from .stats import flow_stats, image_stats

pytestmark = pytest.mark.fidelity

FLOORS = {"mean": 0.5, "psnr": 0.02, "ssim": 0.002, "frac0": 0.003, "frac255": 0.003}
QUICK_SEEDS, SEEDS = 5, 16


def tolerance_floor(name, statistic):
    """Return the floor of a statistic's tolerance, or None if the statistic is not compared."""
    kind = statistic.split("_")[0]
    if name == "glass_blur" and kind == "frac255":
        return None
    if name == "glass_blur" and kind == "std":
        return 0.5
    return FLOORS.get(kind, 0.0)


def compare(name, key, seeds, measure):
    expected = reference.table()["random"][name][key]
    corruption, severity = reference.ours(name), int(key[1:])
    found = [measure(reference.corrupted(corruption, Rng.of("fidelity", seed), severity)) for seed in range(seeds)]
    failures = []
    for statistic in found[0]:
        floor = tolerance_floor(name, statistic)
        if floor is None or expected["mean"].get(statistic) is None:
            continue
        values = np.array([row[statistic] for row in found], np.float64)
        spread = max(expected["std"][statistic], values.std(ddof=1))
        allowed = 4.0 * spread * np.sqrt(1.0 / seeds + 1.0 / expected["n_seeds"]) + floor
        off = abs(values.mean() - expected["mean"][statistic])
        if off > allowed:
            failures.append((statistic, values.mean(), expected["mean"][statistic], allowed))
    assert not failures


@pytest.mark.parametrize(("name", "key"), reference.cases("random", every=4))
def test_image_statistics_of_random_corruptions_equal_the_reference(name, key):
    """Quick version with a third of the seeds, without flow, and only at the lowest and highest severities."""
    compare(name, key, QUICK_SEEDS, lambda pair: image_stats(reference.clean(), pair))


@pytest.mark.slow
@pytest.mark.parametrize(("name", "key"), reference.cases("random"))
def test_all_statistics_of_random_corruptions_equal_the_reference(name, key):
    def measure(pair):
        flow = flow_stats(pair, reference.clean_flows(), *reference.truth())
        return image_stats(reference.clean(), pair) | flow

    compare(name, key, SEEDS, measure)
