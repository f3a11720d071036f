"""Random flows, masks and samples; values exactly on the metrics' thresholds are drawn often."""

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from robustflow.core.types import Sample

_ON_THRESHOLDS = st.sampled_from([0.0, 0.05, 0.15, 0.6, 0.8, 1.0, 3.0, 4.0, 5.0, 6.0, 8.0, 24.0, 32.0, 40.0, -3.0])
_FINITE = _ON_THRESHOLDS | st.floats(-60, 60, width=32) | st.floats(-1e6, 1e6, width=32)
_ANY = _FINITE | st.sampled_from([np.nan, np.inf, -np.inf, 3e38])

shapes = st.tuples(st.integers(1, 8), st.integers(1, 30))


def flows(shape, finite=True):
    return hnp.arrays(np.float32, (*shape, 2), elements=_FINITE if finite else _ANY, fill=_FINITE)


def masks(shape):
    return hnp.arrays(np.bool_, shape)


@st.composite
def cases(draw, finite=True):
    """A prediction, a clean prediction, and a sample with ground truth."""
    shape = draw(shapes)
    frames = np.random.default_rng(draw(st.integers(0, 99))).integers(0, 256, (2, *shape, 3), np.uint8)
    occluded = draw(st.none() | masks(shape))
    sample = Sample("s", tuple(frames), draw(flows(shape)), draw(masks(shape)), occluded)
    pred, clean = draw(flows(shape, finite)), draw(flows(shape, finite))
    if draw(st.booleans()):  # Errors close to the thresholds, for motion of any magnitude.
        with np.errstate(invalid="ignore"):
            pred, clean = sample.flow + pred % 8, sample.flow + clean % 8
    return pred, clean, sample
