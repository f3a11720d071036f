"""The reference folder with frames, corrupted images and statistics."""

import json
from functools import cache

import cv2
import numpy as np
import pytest

from robustflow.core.errors import AssetError
from robustflow.corruptions import load_corruption

from ...shared_data import shared_root
from .stats import flows

FOLDER = shared_root() / "corruption-reference"
OUR_NAMES = {"brightness": "high_light"}


@cache
def table():
    """Return the contents of reference.json, or None if the shared data is missing."""
    path = FOLDER / "reference.json"
    return json.loads(path.read_text()) if path.exists() else None


def cases(group, every=1):
    """Return test parameters (name, key) for every n-th entry of each corruption in a group, or a single skipped test
    if there is no table.
    """
    if table() is None:
        reason = f"no reference in {FOLDER}; set ROBUSTFLOW_SHARED to the folder that contains it"
        return [pytest.param("none", "s0", marks=pytest.mark.skip(reason=reason))]
    return [(name, key) for name, entries in table()[group].items() for key in list(entries)[::every]]


def read_image(name):
    """Return an image from the folder as RGB uint8, or None if it is missing."""
    image = cv2.imread(str(FOLDER / name), cv2.IMREAD_COLOR)
    return None if image is None else cv2.cvtColor(image, cv2.COLOR_BGR2RGB)


@cache
def clean():
    """Return the two clean frames."""
    return read_image("clean_1.png"), read_image("clean_2.png")


@cache
def clean_flows():
    return flows(clean())


@cache
def truth():
    """Return the ground truth of the pair as (flow, valid), decoded from KITTI's format."""
    raw = cv2.imread(str(FOLDER / "flow_occ.png"), cv2.IMREAD_UNCHANGED)
    return (raw[..., 2:0:-1].astype(np.float64) - 32768) / 64, raw[..., 0] > 0


def ours(name):
    """Return our corruption with this name, configured like the reference code."""
    return load_corruption(OUR_NAMES.get(name, name), "reference")


def corrupted(corruption, rng, severity, adjust=lambda state: state):
    """Return the corrupted pair; skip the test if an asset is missing and cannot be downloaded."""
    frames = clean()
    try:
        state = adjust(corruption.draw(rng, severity, frames[0].shape[:2]))
        return [corruption.apply(frame, state, index) for index, frame in enumerate(frames)]
    except AssetError as error:
        pytest.skip(str(error))
