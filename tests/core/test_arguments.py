"""Sizes as HEIGHTxWIDTH, severities, cameras and depth that cannot be used, and processes that cannot be started."""

from __future__ import annotations

import multiprocessing

import numpy as np
import pytest

from robustflow.core.arguments import check_count, check_severity, choice, parse_size
from robustflow.core.errors import DataError, UsageError
from robustflow.core.processes import Child
from robustflow.core.types import Camera, SceneDepth

from ..refusals import refusal

TEXTS = ("", "256", "256x", "x832", "256x832x3", "-256x832", "256 x832", "2e2x832", "64x100000", "²x64")


@pytest.mark.parametrize("text", [*TEXTS, "9" * 5000 + "x64", "0x0", "0x64", "100x832", "256x830"])
def test_text_that_is_not_a_size_or_no_multiple_is_refused(text):
    assert len(str(refusal(lambda: parse_size(text, 64), UsageError, text[:40]))) < 120


@pytest.mark.parametrize("text", ["15x64", "64x15", "4097x64", "64x4097"])
def test_sizes_out_of_range_are_refused(text):
    refusal(lambda: parse_size(text, smallest=16, largest=4096), UsageError, text)
    assert parse_size(text) == tuple(int(side) for side in text.split("x"))
    assert parse_size("16x4096", smallest=16, largest=4096) == (16, 4096)


@pytest.mark.parametrize(
    ("call", "culprit"),
    [
        (lambda: check_severity(0), "0"),
        (lambda: check_severity(True), "True"),
        (lambda: choice("split", "eval", ["val"]), "split"),
        (lambda: check_count("--count", True), "--count"),
        (lambda: check_count("--count", 0), "--count"),
    ],
)
def test_argument_that_is_not_allowed_is_refused(call, culprit):
    refusal(call, UsageError, culprit)


MAP, MASK = np.ones((4, 6), np.float32), np.ones((4, 6), bool)


@pytest.mark.parametrize(
    ("maps", "mask", "culprit"),
    [
        ((np.ones((4, 6)), MAP), MASK, "depth map 1"),
        ((MAP, np.ones((4, 5), np.float32)), MASK, "depth map 2"),
        ((MAP, MAP), np.ones((4, 6)), "mask of depth map 1"),
        ((MAP, 0 * MAP), MASK, "depth map 2"),
        ((np.nan * MAP, MAP), MASK, "depth map 1"),
        ((), MASK, "depth"),
        ((MAP,), MASK, "depth"),
        ((MAP,) * 3, MASK, "depth"),
        (([[1.0]],) * 2, MASK, "depth"),
    ],
)
def test_impossible_depth_is_refused(maps, mask, culprit):
    refusal(lambda: SceneDepth(maps, (mask,) * len(maps), Camera((5.0, 5.0), (2.0, 0.0))), DataError, culprit)


STILL, TURN = np.zeros(3), np.eye(3)


@pytest.mark.parametrize(
    "camera",
    [
        ((0, 0), (4, 4)),
        ((-5.0, 9.0), (4, 4)),
        ((np.nan, 9.0), (4, 4)),
        ((1e-300, 9.0), (4, 4)),
        ((9.0,), (4, 4)),
        ((9.0, 9.0), (4, np.inf)),
        ((9.0, 9.0), (4, 4), None, None, (9.0, 0.0, 4.0, 4.0)),
        ((9.0, 9.0), (4, 4), None, STILL),
        *(((9.0, 9.0), (4, 4), turn, STILL) for turn in (np.eye(4), 2 * TURN, -TURN, np.nan * TURN)),
        *(((9.0, 9.0), (4, 4), TURN, np.array(moved)) for moved in ([0, 0], [0, np.nan, 0], [0, 0, 1e300])),
    ],
)
def test_impossible_camera_is_refused(camera):
    refusal(lambda: Camera(*camera), DataError, "camera")


def test_child_of_a_worker_of_a_pool_is_refused():
    with multiprocessing.get_context("fork").Pool(1) as pool, pytest.raises(UsageError):
        pool.apply(Child, (print,))
