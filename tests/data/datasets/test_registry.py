"""Every dataset can be opened by its name, checks its options, and behaves like a sequence."""

from __future__ import annotations

import pickle

import pytest

from robustflow.core.errors import AssetError, UsageError
from robustflow.data.datasets import Dataset, PreCorrupted, load_dataset

from .layouts import picture


def test_motorcycle_is_a_dataset() -> None:
    dataset = load_dataset("motorcycle")
    assert isinstance(dataset, Dataset)
    assert not isinstance(dataset, PreCorrupted)
    assert pickle.loads(pickle.dumps(dataset)).keys() == dataset.keys()
    assert all(path.is_file() for path in dataset.files("motorcycle"))
    with pytest.raises(UsageError, match="bicycle: no such sample"):
        dataset.load("bicycle")


def test_motorcycle_without_its_image_files_is_refused(monkeypatch: pytest.MonkeyPatch, tmp_path) -> None:
    monkeypatch.setattr("skimage.__file__", str(tmp_path / "__init__.py"))
    with pytest.raises(AssetError, match="pip install --force-reinstall"):
        load_dataset("motorcycle")


def test_unknown_data_sets_options_and_splits_are_refused(tmp_path) -> None:
    with pytest.raises(UsageError, match="did you mean 'kitti2015'"):
        load_dataset("kitti_2015", tmp_path)
    with pytest.raises(UsageError, match="needs no folder"):
        load_dataset("motorcycle", tmp_path)
    with pytest.raises(UsageError, match="option of dataset 'gopro' 'stpe': did you mean 'step'"):
        load_dataset("gopro", tmp_path, stpe=2)
    with pytest.raises(UsageError, match=r"option of dataset 'motorcycle' 'step'\. Known: none"):
        load_dataset("motorcycle", step=2)
    with pytest.raises(UsageError, match="choose from val, training"):
        load_dataset("kitti_fc_released", tmp_path, split="eval")
    with pytest.raises(UsageError, match="render_pass: 'albedo'"):
        load_dataset("flyingthings3d", tmp_path, render_pass="albedo")


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
