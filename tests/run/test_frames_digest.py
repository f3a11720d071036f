"""The digest of a row covers both the bytes and the sizes of the frames."""

import numpy as np
import pytest
from blake3 import blake3

from robustflow.run.stages import frames_digest

PAIR = tuple(np.random.default_rng(0).integers(0, 256, (2, 5, 7, 3), np.uint8))
EMPTY = (np.empty((0, 7, 3), np.uint8),)
FORTRAN = tuple(map(np.asfortranarray, PAIR))
TURNED = tuple(frame.reshape(7, 5, 3) for frame in PAIR)


@pytest.mark.parametrize("frames", [PAIR, PAIR[::-1], PAIR[:1], FORTRAN, TURNED, EMPTY])
def test_digest_depends_on_shapes_bytes_and_order_only(frames):
    content = b"".join(str(frame.shape).encode() + frame.tobytes() for frame in frames)
    assert frames_digest(frames) == blake3(content).hexdigest(length=16)
