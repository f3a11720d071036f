"""The counter-based random generator: values and statistics.

Statistics are computed on fixed streams, so every test is deterministic; the limits are about five standard errors.
"""

from __future__ import annotations

import os

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import ndtri

from robustflow.core.errors import UsageError
from robustflow.core.rng import Rng, hash64, key_of, normals_from_bits

from ..refusals import refusal

WORD = st.integers(0, 2**64 - 1)
N = 1 << 17


def hash_by_definition(key, counter):
    """The generator implemented with arbitrary-precision integers."""
    mask = 2**64 - 1

    def mix(z):
        z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9 & mask
        z = (z ^ (z >> 27)) * 0x94D049BB133111EB & mask
        return z ^ (z >> 31)

    return mix((mix(((counter + 1) * 0x9E3779B97F4A7C15 + key) & mask) + key) & mask)


def hash_of(key, counter):
    return int(hash64(np.uint64(key), np.uint64(counter)))


@given(WORD, WORD)
def test_hash_equals_its_stated_algorithm(key, counter):
    assert hash_of(key, counter) == hash_by_definition(key, counter)


def test_generator_gives_the_known_answers():
    """Golden values: if any of them changes, all corrupted frames change, and a new STREAM_VERSION is required."""
    known = {
        (0x0, 0): 0x48218226FF3CD4BF,
        (0x0, 1): 0xCD73FE3DE975AC26,
        (0x1, 0): 0xDEC1469C8D51E97B,
        (0xFFFFFFFFFFFFFFFF, 18446744073709551615): 0x9D94E4DFFE69BA13,
        (0x123456789ABCDEF, 12345678901): 0x3DB819CF69C0BBD2,
    }
    assert {place: hash_of(*place) for place in known} == known
    stream = Rng.of(0, "fog", 3, "000010")
    assert stream.key == 0x948EC0C23AB51787
    assert stream.spawn("frame", 1).key == 0x93FB76922E3F115E
    assert [int(word) for word in stream.bits(2)] == [0x327974D09CD08548, 0x2E038A576E49164F]
    assert stream.uniform().hex() == "0x1.dbaf639f922dep-2"
    assert stream.integer(0, 1000) == 59
    assert [float(z).hex() for z in stream.normals(12)] == [
        "0x1.20e5459b1e647p+0",
        "-0x1.f22746fa05b9fp-2",
        "-0x1.f56e4f87b1eafp-1",
        "0x1.82ac86576c3f1p-1",
        "-0x1.1fe2d626f1d5ep+0",
        "0x1.0518edb4c63e8p-1",
        "0x1.7c8de05960c1ep-1",
        "-0x1.6713d63cd39d2p-2",
        "-0x1.e5bd93f451957p+1",
        "-0x1.7da3ee6d7065fp-3",
        "0x1.8fbab4963eefep-2",
        "0x1.9952a8119afbfp+0",
    ]


@given(st.integers(0, 2**40), st.integers(1, 50))
def test_generator_can_be_read_from_any_position(start, count):
    """Sequential reads match random-access reads, and a spawned stream does not depend on earlier reads."""
    stream = Rng.of("seek", start)
    before = stream.spawn("child").bits(4)
    first, second = stream.bits(count), stream.bits(count)
    expected = [hash_of(stream.key, position) for position in range(2 * count)]
    assert [*map(int, first), *map(int, second)] == expected
    assert (stream.spawn("child").bits(4) == before).all()


def test_names_that_join_to_the_same_text_give_different_streams():
    names = [("a", "b"), ("ab",), ("a", "b", ""), (1, 2), (12,), ("1", 2), ("a\x1fb",), ("a\x1fstr:1:b",)]
    assert len({key_of(*name) for name in names}) == len(names)


def test_a_file_name_that_is_not_utf8_names_a_stream():
    name = os.fsdecode(b"frame_\xff.png")
    assert key_of(name) != key_of("frame_.png")


@pytest.mark.parametrize("part", [None, 0.5, True])
def test_stream_name_of_a_wrong_type_is_refused(part):
    refusal(lambda: Rng.of(0, part), UsageError, part)


@pytest.mark.parametrize("keys", ["neighbours", "single bits", "frames", "golden ratio"])
def test_streams_of_different_names_are_uncorrelated(keys):
    """Streams with similar keys are uncorrelated, both at the same positions and with an offset."""
    base = key_of("base")
    family = {
        "neighbours": [base + i for i in range(8)],
        "single bits": [1 << i for i in range(0, 64, 8)],
        "frames": [Rng(base).spawn("frame", i).key for i in range(8)],
        "golden ratio": [base + i * 0x9E3779B97F4A7C15 for i in range(8)],
    }[keys]
    streams = [Rng(key).uniforms(N // 8) for key in family]
    limit = 5 / np.sqrt(N // 8)
    for i, one in enumerate(streams):
        for other in streams[:i]:
            for lag in (0, 1, 2, 3):
                assert abs(np.corrcoef(one[lag:], other[: other.size - lag])[0, 1]) < limit
                assert abs(np.corrcoef(one[: one.size - lag], other[lag:])[0, 1]) < limit


@given(st.integers(-1000, 1000), st.integers(1, 2000))
def test_integers_stay_in_range(low, count):
    assert low <= Rng.of("range", low, count).integer(low, low + count) < low + count


def test_normal_quantile_equals_scipy_from_the_centre_to_the_last_bit_of_the_tail():
    tail = (2.0 ** np.linspace(11, 63, 5001)).astype(np.uint64)
    centre = np.linspace(0, 2**64 - 2**12, 20001).astype(np.uint64)
    words = np.concatenate([tail, centre])
    p = ((words >> np.uint64(12)).astype(np.float64) + 0.5) * 2.0**-52
    upper = ((~words >> np.uint64(12)).astype(np.float64) + 0.5) * 2.0**-52
    expected = np.where(p < 0.5, ndtri(p), -ndtri(upper))
    np.testing.assert_allclose(normals_from_bits(words), expected, rtol=3e-15)


def test_normal_quantile_is_antisymmetric_in_its_bits():
    words = np.random.default_rng(0).integers(0, 2**64, 1000, dtype=np.uint64)
    assert (normals_from_bits(words) == -normals_from_bits(~words)).all()
