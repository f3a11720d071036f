"""The statistics used to compare a corrupted pair with the reference.

They are defined in the README of the reference folder: PSNR and SSIM relative to the clean frame, per-channel mean and
standard deviation, mean gradient, fraction of black and white samples, correlation between the residuals of the two
frames, and the flow of two classical methods on the pair.
"""

import cv2
import numpy as np

from robustflow.corruptions.calibration import Ssim


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
    """Return the flow of a pair computed by every method, {name: (H, W, 2)}."""
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
