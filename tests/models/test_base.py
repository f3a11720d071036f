"""What a model raises reaches a person with the place where it happened."""

from __future__ import annotations

import numpy as np
import pytest

from robustflow.errors import ModelError
from robustflow.models.base import predict_checked
from robustflow.models.loading import FunctionModel

FRAMES = (np.zeros((4, 5, 3), np.uint8),) * 2


@pytest.mark.parametrize(
    ("error", "says"),
    [
        (ModelError("a frame is 4x5"), r"^a frame is 4x5 \(on sample 'a', fog severity 3\)$"),
        (IndexError("no row"), r"^the model raised IndexError on sample 'a', fog severity 3: no row;"),
    ],
)
def test_the_sample_is_named(error, says):
    def fails(frame1, frame2):
        raise error

    with pytest.raises(ModelError, match=says):
        predict_checked(FunctionModel(fails, {}), FRAMES, "a", "fog", 3)
