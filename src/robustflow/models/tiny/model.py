"""The small network as a model of the base installation."""

from __future__ import annotations

from typing import Any

from ...sample import Flow, Frame
from ..pairs import check_pair
from .network import predict
from .shipped import ShippedWeights


class NumpyTiny:
    """The small network in NumPy; satisfies `FlowModel`.

    Args:
        name: of the model.
        weights: shipped ones.

    >>> import numpy as np
    >>> from robustflow.models.tiny.shipped import shipped_weights
    >>> frame = np.random.default_rng(0).integers(0, 255, (40, 70, 3)).astype(np.uint8)
    >>> NumpyTiny("tiny", shipped_weights("tiny")).predict(frame, frame).shape
    (40, 70, 2)
    """

    single_threaded = True

    def __init__(self, name: str, weights: ShippedWeights) -> None:
        self.name = name
        self.trained_on = weights.trained_on
        self._weights = weights

    def identity(self) -> dict[str, Any]:
        """See `FlowModel`: the weights' SHA-256, and that NumPy computes."""
        return {"name": self.name, "checkpoint": self._weights.sha256, "runtime": "numpy"}

    def predict(self, frame1: Frame, frame2: Frame) -> Flow:
        """See `FlowModel.predict`. Frames of any size.

        Raises:
            ModelError: frames that are not RGB uint8 of one size.
        """
        check_pair(self.name, frame1, frame2)
        return predict(self._weights.arrays, frame1, frame2)
