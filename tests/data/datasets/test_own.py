"""A user's own dataset and benchmark are checked before anything runs, and identified by their source."""

import sys

import numpy as np
import pytest

import robustflow as rf
from robustflow.core.errors import DataError, RunError, UsageError
from robustflow.data.benchmarks import load_benchmark
from robustflow.testing import ZeroFlow, check_dataset
from tests.data.video.videos import write_video
from tests.refusals import refused

MODULE = """
from pathlib import Path
import numpy as np
from robustflow import Sample
from robustflow.data.benchmarks import Benchmark

class Noise:
    name = "noise"
    has_flow = False
    SHIFT = 1

    def __init__(self, count=2):
        self.count = int(count)

    def keys(self):
        return [f"{index}" for index in range(self.count)]

    def load(self, key):
        if key not in self.keys():
            raise KeyError(key)
        image = np.random.default_rng(int(key)).integers(0, 256, (48, 65, 3), np.uint8)
        return Sample(key, (image[:, self.SHIFT:][:, :64], image[:, :64]))

    def files(self, key):
        return [Path(__file__)]

class NoKeys(Noise):
    def keys(self):
        return []

class Twice(Noise):
    def keys(self):
        return ["0", "0"]

class Lies(Noise):
    has_flow = True

class Other(Noise):
    def load(self, key):
        return "a sample"

class InOneArray(Noise):
    FRAMES = np.empty((2, 48, 64, 3), np.uint8)

    def load(self, key):
        self.FRAMES[:] = super().load(key).frames
        return Sample(key, tuple(self.FRAMES))

class Broken(Noise):
    def load(self, key):
        raise RuntimeError("no disk")

class BreaksLater(Noise):
    def load(self, key):
        return super().load(key) if key == "0" else {}["no disk"]

class SwapsLater(Noise):
    def load(self, key):
        return Sample("0", super().load(key).frames)

class FlowLater(Noise):
    def load(self, key):
        sample = super().load(key)
        truth = np.zeros((*sample.shape, 2), np.float32), np.ones(sample.shape, bool)
        return sample if key == "0" else Sample(key, sample.frames, *truth)

class Taken(Noise):
    name = "sintel"

class Path_(Noise):
    name = "../../etc"

class Random(Noise):
    def load(self, key):
        if key not in self.keys():
            raise KeyError(key)
        image = np.random.default_rng().integers(0, 256, (48, 64, 3), np.uint8)
        return Sample(key, (image, image))

class Endless(Noise):
    def load(self, key):
        return super().load(key) if key in self.keys() else Sample(key, (np.zeros((9, 9, 3), np.uint8),) * 2)

class NoFiles(Noise):
    def files(self, key):
        return [Path("/nowhere/at/all")]

class Bench:
    @staticmethod
    def open(data, split):
        return Benchmark("mine", Noise(), ("1",), ("fog",), (2,))

class Strange:
    @staticmethod
    def open(data, split):
        return Benchmark("mine", Noise(), ("7",), ("fog",), (2,))

class Impostor:
    @staticmethod
    def open(data, split):
        return Benchmark("kitti-fc", Noise(), ("0",), ("fog",), (2,))

def nothing(data, split):
    return None
"""


@pytest.fixture
def module(tmp_path, monkeypatch):
    (tmp_path / "own_noise.py").write_text(MODULE)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    yield tmp_path / "own_noise.py"
    sys.modules.pop("own_noise", None)


def test_own_data_set_is_a_benchmark(module):
    benchmark = load_benchmark("demo", "own_noise:Noise", options={"count": 3})
    assert (benchmark.name, benchmark.keys, len(benchmark.corruptions)) == ("noise", ("0", "1", "2"), 20)
    assert not benchmark.facts.has_flow
    assert benchmark.protocol["options"] == {"count": "3"}


@pytest.mark.parametrize(
    ("name", "match"),
    [
        ("NoKeys", "non-empty list of strings"),
        ("Twice", "'0' twice"),
        ("Lies", "has_flow is True, but sample '0' has no ground truth"),
        ("Other", "must return a Sample"),
        ("Broken", r"failed in load\('0'\): RuntimeError: no disk"),
        ("Taken", "the name of the dataset 'sintel'"),
        ("Path_", "is invalid"),
        ("NoFiles", "existing files"),
        ("Nois", "did you mean 'Noise'"),
    ],
)
def test_object_that_is_not_a_data_set_is_refused(module, name, match):
    with refused(UsageError, match):
        load_benchmark("demo", f"own_noise:{name}")


@pytest.mark.parametrize(
    ("name", "match"),
    [
        ("Random", "differs when read a second time"),
        ("Endless", "a KeyError"),
        ("InOneArray", r"load\('1'\) overwrites the sample loaded before"),
    ],
)
def test_check_dataset_names_faults_that_loading_does_not_find(module, name, match):
    import own_noise

    assert check_dataset(own_noise.Noise()) == "noise"
    with pytest.raises(UsageError, match=match):
        check_dataset(getattr(own_noise, name)())


@pytest.mark.parametrize(
    ("part", "array", "says"),
    [
        ("flow", np.zeros((6, 8, 2)), r"the flow is float64 \(6, 8, 2\); expected float32 \(6, 8, 2\)"),
        ("flow", np.zeros((6, 8, 3), np.float32), r"the flow is float32 \(6, 8, 3\); expected"),
        ("valid", np.full((6, 8), 255, np.uint8), r"the valid mask is uint8 \(6, 8\); expected bool \(6, 8\)"),
        ("valid", np.ones((6, 8, 1), bool), r"the valid mask is bool \(6, 8, 1\); expected bool \(6, 8\)"),
        ("valid", [[True] * 8] * 6, "the valid mask is list; expected bool"),
        ("occluded", np.zeros((8, 6), bool), r"the occlusion map is bool \(8, 6\); expected bool \(6, 8\)"),
    ],
)
def test_ground_truth_of_a_wrong_type_or_shape_is_refused_by_the_sample(part, array, says):
    """The inverse of an integer mask is not a mask, so the pictures of a report would be wrong."""
    truth = {"flow": np.zeros((6, 8, 2), np.float32), "valid": np.ones((6, 8), bool), "occluded": None}
    with pytest.raises(DataError, match=f"^sample 'a': {says}"):
        rf.Sample("a", (np.zeros((6, 8, 3), np.uint8),) * 2, **{**truth, part: array})


def test_own_benchmark_is_opened_and_an_invalid_one_refused(module):
    benchmark = load_benchmark("own_noise:Bench")
    assert (benchmark.name, benchmark.keys) == ("mine", ("1",))
    assert (benchmark.corruptions, benchmark.severities) == (("fog",), (2,))
    for name, match in (
        ("Strange", "does not contain"),
        ("Impostor", "name of the benchmark 'kitti-fc'"),
        ("nothing", "must return a Benchmark"),
        ("Noise", "no function open"),
    ):
        with pytest.raises(UsageError, match=match):
            load_benchmark(f"own_noise:{name}")


def test_an_edited_source_never_continues_a_run(module):
    chosen = {"corruptions": ["contrast"], "severities": [1], "output": "run"}
    first = rf.evaluate(ZeroFlow(), data="own_noise:Noise", **chosen)
    assert rf.evaluate(ZeroFlow(), data="own_noise:Noise", **chosen).rows.equals(first.rows)
    sys.modules.pop("own_noise")
    module.write_text(MODULE.replace("SHIFT = 1", "SHIFT = 0 # other frames"))
    with pytest.raises(RunError, match=r"differs in: protocol|contains a different run"):
        rf.evaluate(ZeroFlow(), data="own_noise:Noise", **chosen)


@pytest.mark.parametrize(
    ("name", "match"),
    [
        ("BreaksLater", r"the dataset 'noise' failed in load\('1'\): KeyError: 'no disk'"),
        ("SwapsLater", r"load\('1'\) returned the sample '0'"),
        ("FlowLater", "has_flow is False, but sample '1' has ground truth"),
    ],
)
def test_a_dataset_that_fails_at_a_later_sample_is_named_and_the_rows_before_are_kept(module, name, match):
    with pytest.raises(UsageError, match=match):
        rf.evaluate(ZeroFlow(), data=f"own_noise:{name}", corruptions="contrast", severities=1, output="run")
    assert set(rf.load_run("run").rows["sample"]) == {"0"}


@pytest.mark.parametrize(
    ("keys", "match"),
    [((), "the benchmark 'mine' lists no samples"), (("0", "7"), "'mine' lists the sample '7', which its dataset")],
)
def test_a_benchmark_object_without_samples_or_with_an_unknown_one_is_refused(module, keys, match):
    import own_noise

    with pytest.raises(UsageError, match=match):
        rf.evaluate(ZeroFlow(), rf.Benchmark("mine", own_noise.Noise(), keys, ("fog",)), output="run")


def test_options_for_opening_a_benchmark_are_refused_with_an_open_one(module):
    import own_noise

    opened = rf.Benchmark("mine", own_noise.Noise(), ("0",), ("fog",))
    with pytest.raises(UsageError, match="the benchmark 'mine' is already open: omit split, data_options"):
        rf.evaluate(ZeroFlow(), opened, split="keys.txt", data_options={"count": 3}, output="run")


def test_video_without_a_benchmark_name_is_read_as_a_folder(tmp_path):
    write_video(tmp_path / "clip.mp4", 6, 3)
    assert load_benchmark("demo", tmp_path / "clip.mp4").dataset.name == "folder"
    with pytest.raises(DataError, match="contains videos, not frames; give one file"):
        load_benchmark("demo", tmp_path)
