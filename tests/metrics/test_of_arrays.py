"""Metrics computed from arrays match plain Python loops for every array library, dtype and mask."""

import math

import numpy as np
import pytest
from hypothesis import given

import robustflow as rf

from . import naive
from .strategies import cases


@given(cases(finite=False))
def test_epe_and_fl_all_of_any_arrays_equal_plain_loops(case):
    flow, _, sample = case
    pixels = [p for p in naive.pixels(flow) if sample.valid[p]]
    errors = {p: naive.distance(flow[p], sample.flow[p]) for p in pixels}
    known = {p: error for p, error in errors.items() if error is not None}
    if not known:
        assert rf.metrics.epe(flow, sample.flow, sample.valid) is None
        assert rf.metrics.fl_all(flow, sample.flow, sample.valid) is None
        return
    mean = math.fsum(known.values()) / len(known)
    assert rf.metrics.epe(flow, sample.flow, sample.valid) == pytest.approx(mean, rel=1e-12)
    outliers = sum(naive.is_fl(error, sample.flow[p]) for p, error in known.items())
    assert rf.metrics.fl_all(flow, sample.flow, sample.valid) == pytest.approx(100 * outliers / len(known))


def test_doubles_strides_and_numeric_masks_give_the_same_numbers():
    rng = np.random.default_rng(0)
    flow, truth = (rng.normal(0, 20, (7, 9, 2)).astype(np.float32) for _ in range(2))
    valid = rng.random((7, 9)) < 0.6
    wanted = rf.metrics.epe(flow, truth, valid), rf.metrics.fl_all(flow, truth, valid)
    for convert in (np.float64, np.asfortranarray, lambda array: np.repeat(array, 2, axis=1)[:, ::2]):
        for mask in (valid.astype(np.uint8) * 255, valid.astype(float)):
            got = rf.metrics.epe(convert(flow), convert(truth), mask), rf.metrics.fl_all(convert(flow), truth, mask)
            assert got == wanted


def test_masked_pixels_are_left_out():
    truth = np.full((2, 3, 2), 4.0)
    truth[0, 0] = 1e6
    masked = np.ma.masked_greater(truth, 1e3)
    flow = np.full((2, 3, 2), [1.0, 0.0])
    assert rf.metrics.epe(flow, masked) == rf.metrics.rcre(masked, flow) == 5.0
    assert rf.metrics.fl_all(flow, masked) == 100.0


@pytest.mark.torch
def test_tensors_with_gradients_give_the_same_numbers():
    torch = pytest.importorskip("torch", reason="needs the torch extra")
    rng = np.random.default_rng(1)
    flow, truth = (rng.normal(0, 20, (7, 9, 2)).astype(np.float32) for _ in range(2))
    tensors = torch.tensor(flow, requires_grad=True), torch.tensor(truth)
    valid = torch.tensor(rng.random((7, 9)) < 0.6)
    assert rf.metrics.epe(*tensors, valid) == rf.metrics.epe(flow, truth, valid.numpy())
    assert rf.metrics.rcre(*tensors) == rf.metrics.rcre(flow, truth)
    rounded = tensors[0].bfloat16()
    assert rf.metrics.epe(rounded, tensors[1]) == rf.metrics.epe(rounded.detach().float().numpy(), truth)


def test_metrics_of_a_lucas_kanade_estimate_of_kitti_2012_have_known_values(shared):
    """The published EPE and Fl of this estimate on its noc map are 10.6271 px and 78.560 %."""
    folder = shared("data/kitti2012_colour_noc_only")
    (estimate,) = (folder / "LKflow").glob("*.png")
    flow, _ = rf.read_flow(estimate)
    truth, valid = rf.read_flow(folder / "training" / "flow_noc" / estimate.name.removeprefix("LKflow_"))
    assert rf.metrics.epe(flow, truth, valid) == pytest.approx(10.6271, abs=5e-5)
    assert rf.metrics.fl_all(flow, truth, valid) == pytest.approx(78.560, abs=5e-4)
