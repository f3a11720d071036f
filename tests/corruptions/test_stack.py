"""Test stacks of corruptions."""

import numpy as np
import pytest
from skimage import data

from robustflow.core.errors import UsageError
from robustflow.corruptions import corrupt, load_corruption
from robustflow.corruptions.api import stream_for
from robustflow.corruptions.stack import levels_of, parse_stack

FRAME = np.ascontiguousarray(data.astronaut()[:96, :128])


def test_parts_are_applied_in_order():
    stack = load_corruption("contrast:5+impulse_noise:1")
    first, _ = corrupt(FRAME, FRAME, stack, 3)
    contrast = load_corruption("contrast")
    low = contrast.apply(FRAME, contrast.draw(stream_for(contrast, 5, 0, ""), 5, FRAME.shape[:2]), 0)
    untouched = (first == low).mean()
    assert 0.95 < untouched < 0.98, "impulses of severity 1 (3 % of the samples) are on top of the low-contrast image"
    other, _ = corrupt(FRAME, FRAME, "impulse_noise:1+contrast:5", 3)
    assert other.std() < first.std() / 2, "if contrast is applied last, it also affects the impulses"


def test_same_corruption_twice_draws_twice():
    stack = load_corruption("gaussian_noise+gaussian_noise")
    states = stack.draw(stream_for(stack, 2, 0, "key"), 2, FRAME.shape[:2])
    noise = load_corruption("gaussian_noise")
    grey = np.full((64, 64, 3), 128, np.uint8)
    once, again = (noise.apply(grey, state, 0).astype(float) for state in states)
    assert abs(np.corrcoef(once.ravel(), again.ravel())[0, 1]) < 0.05


def test_severity_of_the_stack_reaches_parts_without_their_own():
    mild, _ = corrupt(FRAME, FRAME, "contrast+jpeg_compression", 1)
    severe, _ = corrupt(FRAME, FRAME, "contrast+jpeg_compression", 5)
    assert severe.std() < mild.std()
    assert levels_of("contrast+jpeg_compression", (1, 5)) == (1, 5)
    assert levels_of("contrast:2+jpeg_compression:3", (1, 5)) == (3,)


@pytest.mark.parametrize(
    "name",
    ["fog+", "+fog", "fog:", "fog:x+snow", "fog:0+snow", "fog:6", "foggy+snow", "fog:\u0663", "fog:" + 5000 * "1"],
)
def test_malformed_stack_names_are_refused(name):
    with pytest.raises(UsageError):
        parse_stack(name)
