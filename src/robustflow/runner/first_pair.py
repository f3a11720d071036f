"""Warn if the flow of a run's first pair is not (u right, v down) in pixels from frame 1 to frame 2."""

from __future__ import annotations

import warnings

from ..metrics.flow_reading import misread
from ..threads import one_opencv_thread
from .engines.base import Job


def check_first_pair(job: Job, key: str) -> None:
    """Compare the clean flow of a pair, which an engine has stored or else is predicted here, with its frames."""
    with one_opencv_thread():
        worker = job.worker()
        sample, flow = worker.sample(key), worker.clean_flow(key)
    wrong = misread([(sample.frames[0], sample.frames[1], flow)])
    if wrong is not None:
        warnings.warn(
            f"the model's flow looks {wrong.reading.describe()}: on sample '{key}', frame 2 warped by the flow differs "
            f"from frame 1 by {wrong.given:.1f} grey levels, and by {wrong.error:.1f} if the flow is corrected for "
            "this; a model must return (u right, v down) in pixels from frame 1 to frame 2, so correct the model, and "
            "use robustflow check",
            stacklevel=3,
        )
