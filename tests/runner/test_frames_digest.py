"""The digest of a row covers both the bytes and the sizes of the frames."""

import numpy as np
from blake3 import blake3

from robustflow.runner.frames_digest import frames_digest

RNG = np.random.default_rng(0)
PAIR = tuple(RNG.integers(0, 256, (2, 5, 7, 3), np.uint8))


def test_what_is_hashed():
    content = b"".join(str(frame.shape).encode() + frame.tobytes() for frame in PAIR)
    assert frames_digest(PAIR) == blake3(content).hexdigest(length=16)


def test_every_difference_is_seen_and_no_layout():
    digest = frames_digest(PAIR)
    assert frames_digest(tuple(np.asfortranarray(frame) for frame in PAIR)) == digest
    changed = PAIR[0].copy()
    changed[4, 6, 2] ^= 1
    turned = tuple(frame.reshape(7, 5, 3) for frame in PAIR)
    for other in ((changed, PAIR[1]), PAIR[::-1], turned, PAIR[:1]):
        assert frames_digest(other) != digest


def test_frames_without_pixels():
    assert len(frames_digest((np.empty((0, 7, 3), np.uint8),))) == 32
