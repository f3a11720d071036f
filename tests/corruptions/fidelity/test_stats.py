"""Our statistics match those of the reference on identical images."""

import pytest

from robustflow.core.rng import Rng

from . import reference
from .stats import epe, flow_stats, image_stats

pytestmark = pytest.mark.fidelity


def test_clean_pair_has_the_statistics_and_errors_of_the_reference(shared):
    shared("corruption-reference", "reference.json")
    facts = reference.table()["input"]
    frames = reference.clean()
    assert list(frames[0].shape) == facts["shape"]
    assert image_stats(frames, frames) == pytest.approx(facts["clean"], abs=1e-4)
    truth, valid = reference.truth()
    found = {name: epe(flow, truth, valid) for name, flow in reference.clean_flows().items()}
    assert found == pytest.approx(facts["clean_epe"], abs=0.002)


@pytest.mark.parametrize("name", ["jpeg_compression", "pixelate"])
def test_exact_corruptions_have_the_statistics_of_the_reference(shared, name):
    shared("corruption-reference", "reference.json")
    pair = reference.corrupted(reference.ours(name), Rng.of(0), 3)
    found = image_stats(reference.clean(), pair) | flow_stats(pair, reference.clean_flows(), *reference.truth())
    expected = reference.table()["deterministic"][name]["s3"]
    for statistic, value in found.items():
        assert value == pytest.approx(expected[statistic], abs=0.005 if "cre" in statistic else 1e-4), statistic
