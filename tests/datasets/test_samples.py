"""Data sets iterate and index."""

import pytest

from robustflow.datasets import load_dataset
from robustflow.errors import UsageError

from .layouts import picture


def test_a_data_set_is_a_sequence(tmp_path):
    for number in range(4):
        picture(tmp_path / f"{number}.png")
    pairs = load_dataset("folder", tmp_path)
    assert len(pairs) == 3
    assert repr(pairs) == "<FrameFolder: 3 pairs, no ground truth>"
    assert [sample.key for sample in pairs] == pairs.keys() == ["0", "1", "2"]
    assert (pairs[0].key, pairs[-1].key, pairs["1"].key) == ("0", "2", "1")
    with pytest.raises(IndexError):
        pairs[3]
    with pytest.raises(UsageError, match="no sample '9'"):
        pairs["9"]
