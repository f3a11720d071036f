"""No frame size crashes the process or raises a foreign error in a codec or the damage of a stream."""

from fractions import Fraction

import numpy as np
import pytest

from robustflow.data.video.variants import ShortClip

from ...forked import outcomes

FEW = [(height, width) for height in (1, 2, 3, 8, 17) for width in (1, 2, 5, 16, 33)] + [(2, 400), (400, 3)]
ALL = [(height, width) for height in range(1, 41) for width in (*range(1, 20), 31, 32, 33, 64, 65)]
ALL += [size for side in range(1, 20, 3) for size in ((side, 2000), (2000, side))]
VIDEO = {"h264_crf": (23, 51), "h264_abr": (2000, 200_000), "bit_error": (40, 4000)}


@pytest.mark.parametrize("sizes", [FEW, pytest.param(ALL, marks=pytest.mark.slow)], ids=["few", "all"])
@pytest.mark.parametrize("name", VIDEO)
def test_every_frame_size_can_be_encoded_and_damaged(tmp_path, name, sizes):
    """A damaged stream may lose all its frames, which is an error of this package."""

    def transcoded(size):
        frame = np.random.default_rng(size).integers(0, 256, (*size, 3), dtype=np.uint8)
        clip = ShortClip([np.roll(frame, index, axis=1) for index in range(4)], Fraction(25), tmp_path)
        for parameter in VIDEO[name]:
            for corrupted in clip.corrupted(name, parameter, range(1, 3))[0]:
                assert corrupted.shape == (*size, 3)

    ends = dict(outcomes(transcoded, sizes, together=100))
    assert len(ends) == len(sizes)
    assert set(ends.values()) <= {"returned", "refused"}
