"""The reference folder with frames, corrupted images and statistics.

The statistics are defined in its README: PSNR and SSIM relative to the clean frame, per-channel mean and standard
deviation, mean gradient, fraction of black and white samples, correlation between the residuals of the two frames, and
the flow of two classical methods on the pair.
"""

import json
from functools import cache

import cv2
import numpy as np
import pytest

from robustflow.core.errors import AssetError
from robustflow.corruptions import load_corruption
from robustflow.report.gallery.ssim import Ssim

from ...shared_data import shared_root

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


def grey(frame):
    return cv2.cvtColor(frame, cv2.COLOR_RGB2GRAY)


def psnr(clean, other):
    error = np.square(np.subtract(clean, other, dtype=np.int32)).sum(dtype=np.int64) / clean.size
    return 99.0 if error == 0 else 10.0 * np.log10(255.0**2 / error)


def mean_gradient(frame):
    image = grey(frame).astype(np.float64)
    return float(np.hypot(np.diff(image, axis=1)[:-1], np.diff(image, axis=0)[:, :-1]).mean())


def image_stats(clean, corrupted):
    """Return the statistics of a pair, without the flow statistics, named as in the reference table; None if
    undefined."""
    out, residuals = {}, []
    for number, (before, after) in enumerate(zip(clean, corrupted, strict=True), start=1):
        residual = after.astype(np.float64) - before
        residuals.append(residual)
        out[f"psnr_{number}"] = psnr(before, after)
        out[f"ssim_{number}"] = Ssim(before)(after)
        for channel, letter in enumerate("rgb"):
            out[f"mean_{letter}_{number}"] = float(after[..., channel].mean())
            out[f"std_{letter}_{number}"] = float(after[..., channel].std())
        out[f"grad_{number}"] = mean_gradient(after)
        out[f"frac0_{number}"] = np.count_nonzero(after == 0) / after.size
        out[f"frac255_{number}"] = np.count_nonzero(after == 255) / after.size
        out[f"resid_std_{number}"] = float(residual.std())
    constant = any(residual.std() == 0 for residual in residuals)
    correlation = None if constant else np.corrcoef(residuals[0].ravel(), residuals[1].ravel())[0, 1]
    return out | {"resid_corr": correlation}


FLOWS = {
    "farneback": lambda a, b: cv2.calcOpticalFlowFarneback(a, b, None, 0.5, 3, 15, 3, 5, 1.2, 0),
    "dis": lambda a, b: cv2.DISOpticalFlow_create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM).calc(a, b, None),
}


def flows(frames):
    return {name: estimate(grey(frames[0]), grey(frames[1])) for name, estimate in FLOWS.items()}


def epe(flow, truth, where):
    """Return the mean end-point error over the pixels in the mask `where`."""
    difference = (flow.astype(np.float64) - truth)[where]
    return float(np.hypot(difference[:, 0], difference[:, 1]).mean())


def flow_stats(corrupted, clean_flows, truth, valid):
    """Return, for every method, CRE (increase in error) and RCRE (change of the flow, on valid and on all pixels)."""
    everywhere = np.ones(valid.shape, bool)
    out = {}
    for name, flow in flows(corrupted).items():
        before = clean_flows[name]
        out[f"cre_{name}"] = epe(flow, truth, valid) - epe(before, truth, valid)
        out[f"rcre_{name}"] = epe(flow, before, valid)
        out[f"rcre_all_{name}"] = epe(flow, before, everywhere)
    return out
