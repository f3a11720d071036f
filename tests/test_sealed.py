"""A flipped bit in sealed content is detected."""

from __future__ import annotations

import json

import numpy as np
import pytest

from robustflow.core.errors import DataError
from robustflow.core.files import json_bytes, sealed, sealed_bytes, unsealed, unsealed_bytes
from robustflow.corruptions.scale import read_table, shipped


def flips(data: bytes, count: int = 200):
    rng = np.random.default_rng(0)
    for place, bit in zip(rng.integers(0, len(data), count), rng.integers(0, 8, count), strict=True):
        flipped = bytearray(data)
        flipped[place] ^= 1 << bit
        yield bytes(flipped)


def test_sealed_json_with_a_flipped_bit_is_rejected_or_equal():
    content = {"a": [1, 2.5, "text"], "b": {"c": None}, "small": 1e-9}
    for flipped in flips(json_bytes(sealed(content)), 1000):
        rest = unsealed(flipped)
        assert rest is None or json.loads(rest) == content


def test_sealed_bytes_with_a_flipped_bit_are_rejected():
    for flipped in flips(sealed_bytes(b"some bytes", "x"), 200):
        assert unsealed_bytes(flipped, "x") is None


def test_a_calibration_with_a_flipped_bit_is_refused(tmp_path):
    path = tmp_path / "table.json"
    whole = json_bytes(sealed(shipped().model_dump(mode="json")))
    path.write_bytes(whole)
    assert read_table(path) == shipped()
    for flipped in flips(whole):
        path.write_bytes(flipped)
        with pytest.raises(DataError, match=r"table\.json is not a calibration table.*robustflow optics calibrate$"):
            read_table(path)
