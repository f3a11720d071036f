"""No frame size crashes the process or raises a foreign error in a model that runs native code."""

import cv2
import numpy as np
import pytest

from robustflow import load_model

from ..forked import outcomes

MODELS = [
    *[("dis", {"preset": preset}) for preset in ("ultrafast", "fast", "medium")],
    *[("farneback", options) for options in ({}, {"levels": 0, "poly_n": 1}, {"pyr_scale": 0.05, "winsize": 64})],
    *[("dis_rgb", {"operating_point": point}) for point in (1, 2, 3, 4)],
]
EDGES = [1, 7, 8, 9, 11, 12, 15, 16, 17, 31, 32, 33, 39, 40, 63, 64, 79, 80, 128]
SIDES = range(1, 161)
RATIOS = [size for side in range(1, 34) for long in (500, 3000) for size in ((side, long), (long, side))]


def moved(size):
    frame = np.random.default_rng(size).integers(0, 256, (*size, 3), dtype=np.uint8)
    return frame, np.roll(frame, 2, axis=1)


def scan(call, sizes):
    return dict(outcomes(call, sizes, together=100))


@pytest.mark.parametrize(("name", "options"), MODELS)
@pytest.mark.parametrize("sides", [EDGES[:12], pytest.param(SIDES, marks=pytest.mark.slow)], ids=["few", "all"])
def test_every_frame_size_gives_a_flow_or_a_refusal(name, options, sides):
    model = load_model(name, **options)
    if name == "dis_rgb" and len(sides) > 100:
        sides = [*range(1, 41), *EDGES[13:]]
    sizes = [(height, width) for height in sides for width in sides] + RATIOS[:: 1 if len(sides) > 12 else 9]

    def predict(size):
        flow = model.predict(*moved(size))
        assert flow.shape == (*size, 2)
        assert name != "dis_rgb" or np.isfinite(flow).all()

    ends = scan(predict, sizes)
    assert len(ends) == len(set(sizes))
    assert set(ends.values()) <= {"returned", "refused"}
    assert name == "dis" or "refused" not in ends.values()


@pytest.mark.parametrize("preset", range(3))
def test_dis_refuses_exactly_the_sizes_that_opencv_cannot_process(preset):
    model = load_model("dis", preset=("ultrafast", "fast", "medium")[preset])

    def by_opencv(size):
        grey = [cv2.cvtColor(frame, cv2.COLOR_RGB2GRAY) for frame in moved(size)]
        cv2.DISOpticalFlow.create(preset).calc(*grey, None)

    sizes = [(height, width) for height in EDGES for width in EDGES]
    refused = {size for size, end in scan(lambda size: model.predict(*moved(size)), sizes).items() if end == "refused"}
    assert refused == {size for size, end in scan(by_opencv, sizes).items() if end != "returned"}
    assert 0 < len(refused) < len(sizes)
