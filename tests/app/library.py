"""The numbers that the app shows, computed by the library, and the bytes of a frame to upload."""

import io

import numpy as np
from PIL import Image

import robustflow as rf
from robustflow.metrics import epe, rcre
from robustflow.metrics.error_maps import epe_map, magnitude_map


def direct_numbers(frames, truth, corruption, severity, seed, key, model="dis", depth=None):
    """Compute the numbers without the app."""
    flow_of = rf.load_model(model).predict
    clean = flow_of(*frames)
    flow = flow_of(*rf.corrupt(*frames, corruption, severity, seed=seed, key=key, depth=depth))
    if truth is None:
        return {"epe": None, "epe_clean": None, "cre": None, "crer": None, "rcre": rcre(flow, clean), "fl": None}
    before, after = epe(clean, *truth), epe(flow, *truth)
    errors, lengths = epe_map(flow, truth[0])[truth[1]], magnitude_map(truth[0])[truth[1]]
    return {
        "epe": after,
        "epe_clean": before,
        "cre": after - before,
        "crer": (after - before) / before if before >= 1 / 64 else None,
        "rcre": rcre(flow, clean, truth[1]),
        "fl": 100 * np.mean((errors > 3) & (errors > 0.05 * lengths)),
    }


def png(frame):
    out = io.BytesIO()
    Image.fromarray(frame).save(out, "PNG")
    return out.getvalue()
