"""Every dataset has a name, metadata that fits, and options that are checked."""

from __future__ import annotations

import pickle

import pytest

from robustflow.datasets import DATASETS, Dataset, PreCorrupted, load_dataset
from robustflow.datasets.metadata import METADATA
from robustflow.errors import AssetError, UsageError


def test_metadata_for_every_built_in_dataset() -> None:
    ours = [name for name in DATASETS.names() if DATASETS.get(name).__module__.startswith("robustflow.")]
    assert set(METADATA) == set(ours)
    for entry in METADATA.values():
        assert "://" not in entry.model_dump_json()


def test_ground_truth_as_the_metadata_says() -> None:
    for name, entry in METADATA.items():
        target = DATASETS.get(name)
        assert getattr(target, "has_flow", False) == (entry.ground_truth != "none"), name


def test_motorcycle_is_a_dataset() -> None:
    dataset = load_dataset("motorcycle")
    assert isinstance(dataset, Dataset)
    assert not isinstance(dataset, PreCorrupted)
    assert pickle.loads(pickle.dumps(dataset)).keys() == dataset.keys()
    assert all(path.is_file() for path in dataset.files("motorcycle"))
    with pytest.raises(UsageError, match="only key is 'motorcycle'"):
        dataset.load("bicycle")


def test_motorcycle_without_the_pictures(monkeypatch: pytest.MonkeyPatch, tmp_path) -> None:
    monkeypatch.setattr("skimage.__file__", str(tmp_path / "__init__.py"))
    with pytest.raises(AssetError, match="pip install --force-reinstall"):
        load_dataset("motorcycle")


def test_usage(tmp_path) -> None:
    with pytest.raises(UsageError, match="did you mean 'kitti2015'"):
        load_dataset("kitti_2015", tmp_path)
    with pytest.raises(UsageError, match="needs no folder"):
        load_dataset("motorcycle", tmp_path)
    with pytest.raises(UsageError, match="option of dataset 'gopro' 'stpe': did you mean 'step'"):
        load_dataset("gopro", tmp_path, stpe=2)
    with pytest.raises(UsageError, match="split 'eval' does not exist: choose from val, training"):
        load_dataset("kitti_fc", tmp_path, split="eval")
    with pytest.raises(UsageError, match="render_pass 'albedo' does not exist"):
        load_dataset("flyingthings3d", tmp_path, render_pass="albedo")
