"""A user's own dataset and benchmark are checked before anything runs, and identified by their source."""

import sys
from functools import partial

import numpy as np
import pytest

import robustflow as rf
from robustflow.core.errors import DataError, RunError, UsageError
from robustflow.data.benchmarks import load_benchmark
from robustflow.testing import ZeroFlow, check_dataset
from tests.data.video.videos import write_video
from tests.refusals import refusal

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

def sample(key, flow=None):
    frames = Noise().load(key).frames
    return Sample(key, frames, flow, None if flow is None else np.ones((48, 64), bool))

def random(key):
    return Sample(key, (np.random.default_rng().integers(0, 256, (48, 64, 3), np.uint8),) * 2)

FLOW = np.zeros((48, 64, 2), np.float32)

class NoKeys(Noise): keys = lambda self: []
class Twice(Noise): keys = lambda self: ["0", "0"]
class Lies(Noise): has_flow = True
class Other(Noise): load = lambda self, key: "a sample"
class Broken(Noise): load = lambda self, key: 1 / 0
class Path_(Noise): name = "../../etc"
class NoFiles(Noise): files = lambda self, key: [Path("/nowhere/at/all")]
class Taken(Noise): name = "sintel"
class BreaksLater(Noise): load = lambda self, key: sample(key) if key == "0" else {}["no disk"]
class SwapsLater(Noise): load = lambda self, key: Sample("0", sample(key).frames)
class FlowLater(Noise): load = lambda self, key: sample(key, None if key == "0" else FLOW)
class Random(Noise): load = lambda self, key: random(self.keys()[int(key)])
class Endless(Noise): load = lambda self, key: sample(key) if key in self.keys() else Sample(key, sample("0").frames)

class InOneArray(Noise):
    FRAMES = np.empty((2, 48, 64, 3), np.uint8)

    def load(self, key):
        self.FRAMES[:] = super().load(key).frames
        return Sample(key, tuple(self.FRAMES))

class Opened:
    @classmethod
    def open(cls, data, split):
        return Benchmark(cls.name, Noise(), (cls.key,), ("fog",), (2,))

class Bench(Opened): name, key = "mine", "1"
class Strange(Opened): name, key = "mine", "7"
class Impostor(Opened): name, key = "kitti-fc", "0"

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


@pytest.mark.parametrize("name", ["NoKeys", "Twice", "Lies", "Other", "Broken", "Path_", "NoFiles", "Taken", "Nois"])
def test_object_that_is_not_a_data_set_is_refused(module, name):
    with pytest.raises(UsageError) as caught:
        load_benchmark("demo", f"own_noise:{name}")
    assert name in str(caught.value)


@pytest.mark.parametrize("name", ["Random", "Endless", "InOneArray"])
def test_check_dataset_finds_faults_that_loading_does_not(module, name):
    import own_noise

    assert check_dataset(own_noise.Noise()) == "noise"
    with pytest.raises(UsageError):
        check_dataset(getattr(own_noise, name)())


@pytest.mark.parametrize(
    ("part", "array"),
    [
        ("flow", np.zeros((6, 8, 2))),
        ("flow", np.zeros((6, 8, 3), np.float32)),
        ("valid", np.full((6, 8), 255, np.uint8)),
        ("valid", np.ones((6, 8, 1), bool)),
        ("valid", [[True] * 8] * 6),
        ("occluded", np.zeros((8, 6), bool)),
    ],
)
def test_ground_truth_of_a_wrong_type_or_shape_is_refused_by_the_sample(part, array):
    """The inverse of an integer mask is not a mask, so the pictures of a report would be wrong."""
    truth = {"flow": np.zeros((6, 8, 2), np.float32), "valid": np.ones((6, 8), bool), "occluded": None}
    frames = (np.zeros((6, 8, 3), np.uint8),) * 2
    refusal(lambda: rf.Sample("a", frames, **{**truth, part: array}), DataError, "sample 'a'")


def test_own_benchmark_is_opened_and_an_invalid_one_refused(module):
    benchmark = load_benchmark("own_noise:Bench")
    assert (benchmark.name, benchmark.keys) == ("mine", ("1",))
    assert (benchmark.corruptions, benchmark.severities) == (("fog",), (2,))
    for name in ("Strange", "Impostor", "nothing", "Noise"):
        refusal(lambda name=name: load_benchmark(f"own_noise:{name}"), UsageError, f"own_noise:{name}")


def test_an_edited_source_never_continues_a_run(module):
    chosen = {"corruptions": ["contrast"], "severities": [1], "output": "run"}
    first = rf.evaluate(ZeroFlow(), data="own_noise:Noise", **chosen)
    assert rf.evaluate(ZeroFlow(), data="own_noise:Noise", **chosen).rows.equals(first.rows)
    sys.modules.pop("own_noise")
    module.write_text(MODULE.replace("SHIFT = 1", "SHIFT = 0 # other frames"))
    with pytest.raises(RunError):
        rf.evaluate(ZeroFlow(), data="own_noise:Noise", **chosen)


@pytest.mark.parametrize("name", ["BreaksLater", "SwapsLater", "FlowLater"])
def test_a_dataset_that_fails_at_a_later_sample_is_named_and_the_rows_before_are_kept(module, name):
    run = partial(rf.evaluate, ZeroFlow(), data=f"own_noise:{name}", corruptions="contrast", severities=1, output="run")
    refusal(run, UsageError, "the dataset 'noise'")
    assert set(rf.load_run("run").rows["sample"]) == {"0"}


@pytest.mark.parametrize("keys", [(), ("0", "7")])
def test_a_benchmark_object_without_samples_or_with_an_unknown_one_is_refused(module, keys):
    import own_noise

    benchmark = rf.Benchmark("mine", own_noise.Noise(), keys, ("fog",))
    refusal(lambda: rf.evaluate(ZeroFlow(), benchmark, output="run"), UsageError, "the benchmark 'mine'")


def test_options_for_opening_a_benchmark_are_refused_with_an_open_one(module):
    import own_noise

    opened = rf.Benchmark("mine", own_noise.Noise(), ("0",), ("fog",))
    options = {"split": "keys.txt", "data_options": {"count": 3}}
    refusal(lambda: rf.evaluate(ZeroFlow(), opened, **options, output="run"), UsageError, "split")


def test_video_without_a_benchmark_name_is_read_as_a_folder(tmp_path):
    write_video(tmp_path / "clip.mp4", 6, 3)
    assert load_benchmark("demo", tmp_path / "clip.mp4").dataset.name == "folder"
    refusal(lambda: load_benchmark("demo", tmp_path), DataError, tmp_path)
