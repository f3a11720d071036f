"""The digest of a row names bytes and sizes, whatever the version of the rows that asks for it."""

from __future__ import annotations

import hashlib

import numpy as np
import pytest
from blake3 import blake3

from robustflow.metrics.rows import READABLE_MEANINGS
from robustflow.runner.frames_digest import are_frames_of, frames_digest

RNG = np.random.default_rng(0)
PAIR = tuple(RNG.integers(0, 256, (2, 5, 7, 3), np.uint8))


def test_what_is_hashed():
    content = b"".join(str(frame.shape).encode() + frame.tobytes() for frame in PAIR)
    assert frames_digest(PAIR) == blake3(content).hexdigest(length=16)
    assert frames_digest(PAIR, rows_version=1) == hashlib.blake2b(content, digest_size=16).hexdigest()


@pytest.mark.parametrize("version", READABLE_MEANINGS)
def test_every_difference_is_seen_and_no_layout(version):
    digest = frames_digest(PAIR, version)
    assert frames_digest(tuple(np.asfortranarray(frame) for frame in PAIR), version) == digest
    assert are_frames_of(digest, PAIR)
    changed = PAIR[0].copy()
    changed[4, 6, 2] ^= 1
    turned = tuple(frame.reshape(7, 5, 3) for frame in PAIR)
    for other in ((changed, PAIR[1]), PAIR[::-1], turned, PAIR[:1]):
        assert frames_digest(other, version) != digest
        assert not are_frames_of(digest, other)


def test_frames_without_pixels():
    assert len(frames_digest((np.empty((0, 7, 3), np.uint8),))) == 32
