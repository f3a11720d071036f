"""What is not a flow, a mask, a confidence or a region is refused, and the error names it."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from robustflow.core.errors import DataError
from robustflow.core.types import Sample
from robustflow.metrics import ause, epe, error_at, forward_backward, measure
from robustflow.metrics.error_maps import epe_map
from robustflow.metrics.photometric import photometric
from robustflow.metrics.regions import Regions, motion_edges
from tests.refusals import refusal

FRAME = np.zeros((4, 5, 3), np.uint8)
FLOW = np.zeros((4, 5, 2), np.float32)
SAMPLE = Sample("a", (FRAME, FRAME), FLOW, np.ones((4, 5), np.bool_))
REGIONS = Regions.of(SAMPLE)
INFINITE = np.full_like(FLOW, np.inf)
TURNED = np.zeros((5, 4, 2), np.float32)
NOT_FLOAT32 = (FLOW.astype(np.float64), FLOW[..., :1], FRAME.astype(np.float32), FLOW[..., 0], [[[0.0, 0.0]]])
NOT_A_FLOW = (FLOW.transpose(2, 0, 1), FLOW.astype(int), FLOW[None], [1.0])

CASES = [
    *((lambda flow=flow: epe_map(flow, FLOW), "flow") for flow in (*NOT_FLOAT32, TURNED)),
    *((lambda flow=flow: epe(flow, FLOW), "flow") for flow in NOT_A_FLOW),
    (lambda: epe(FLOW, FLOW, np.ones((5, 4), bool)), "valid"),
    *((lambda flow=flow: photometric(FRAME, FRAME, flow), "maps") for flow in (TURNED,)),
    (lambda: photometric(FRAME, FRAME, FRAME.astype(np.float32)), "flow"),
    (lambda: motion_edges(FLOW, np.ones((9, 9), np.bool_)), "maps"),
    (lambda: measure(TURNED, TURNED, SAMPLE, REGIONS), "a"),
    (lambda: measure(FLOW, TURNED, SAMPLE, REGIONS), "flow"),
    (lambda: measure(FLOW, FLOW, SAMPLE, None), "a"),
    (lambda: measure(FLOW, FLOW, dataclasses.replace(SAMPLE, flow=None, valid=None), REGIONS), "a"),
    (lambda: measure(FLOW.astype(np.float64), FLOW, SAMPLE, REGIONS), "flow"),
    (lambda: Regions.of(dataclasses.replace(SAMPLE, flow=INFINITE)), "a"),
    (lambda: ause([1.0, 2.0], [1, 2, 3]), "confidence"),
    (lambda: ause([1.0, 2.0], [1, np.nan]), "confidence"),
    *((lambda part=part: error_at([1.0], [1.0], part), "coverage") for part in (0.0, 0.005, 1.004, math.nan)),
    *((lambda one=one: forward_backward(one, FLOW), "back") for one in (TURNED, FRAME, FLOW[None])),
]


@pytest.mark.parametrize(("call", "culprit"), CASES)
def test_wrong_array_is_refused(call, culprit):
    refusal(call, DataError, culprit)


def test_ground_truth_that_is_not_finite_is_allowed_where_it_is_invalid():
    regions = Regions.of(dataclasses.replace(SAMPLE, flow=INFINITE, valid=np.zeros((4, 5), np.bool_)))
    assert not regions.valid.any()
