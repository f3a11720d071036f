"""Test RobustSpring's corrupted frames as a benchmark: pairs, files and names."""

import shutil
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest

from robustflow.core.errors import DataError, UsageError
from robustflow.corruptions import CORRUPTIONS, load_corruption
from robustflow.corruptions.registry import MEMBERS, ON_DISK, ON_DISK_PREFIX, ORDER
from robustflow.corruptions.user_corruptions import register_custom
from robustflow.data.benchmarks import benchmark_facts, load_benchmark
from robustflow.data.benchmarks.setting import setting_of
from robustflow.data.datasets import load_dataset
from robustflow.data.datasets.dataset import CorruptedClips
from robustflow.data.datasets.robustspring import RobustSpring
from robustflow.media.images import read_image
from robustflow.models.provenance import UNDECLARED, Training
from robustflow.testing import check_dataset
from tests.refusals import refusal

from .layouts import robustspring

FOG, RAIN = "robustspring_fog", "robustspring_rain"


@pytest.fixture
def root(tmp_path) -> Path:
    return robustspring(tmp_path / "RobustSpring")


def test_robustspring_has_both_cameras_and_directions_of_all_sequences(root):
    pairs = RobustSpring(root)
    assert check_dataset(pairs) == "robustspring"
    assert isinstance(pairs, CorruptedClips)
    steps = {"0003": 2, "0028": 1}
    assert pairs.keys() == sorted(
        f"{sequence}/flow_{direction}_{side}/flow_{direction}_{side}_{first + (direction == 'BW'):04d}"
        for sequence, count in steps.items()
        for side in ("left", "right")
        for direction in ("FW", "BW")
        for first in range(1, count + 1)
    )
    assert {sample.group for sample in pairs} == {"0003", "0028"}


@pytest.mark.parametrize(("direction", "first", "second"), [("FW", 1, 2), ("BW", 3, 2)])
def test_frames_are_those_of_the_files(root, direction, first, second):
    pairs = RobustSpring(root)
    key = f"0003/flow_{direction}_right/flow_{direction}_right_{first:04d}"
    folders = {"spring": pairs.load(key).frames, "rain": pairs.corrupted(key, RAIN, 1)}
    for folder, frames in folders.items():
        for frame, number in zip(frames, (first, second), strict=True):
            path = root / folder / "test/0003/frame_right" / f"frame_right_{number:04d}.png"
            assert np.array_equal(frame, read_image(path))
    third = 6 - first - second
    assert list(pairs.around(key, 4)) == [0, 1, 2]
    path = root / "rain/test/0003/frame_right" / f"frame_right_{third:04d}.png"
    assert np.array_equal(pairs.corrupted_frame(key, 2, RAIN, 1), read_image(path))


def test_benchmark_has_only_the_unpacked_corruptions(root):
    benchmark = load_benchmark("robustspring", root)
    assert benchmark.closed
    assert (benchmark.corruptions, benchmark.severities) == ((FOG, RAIN), (1,))
    assert set(benchmark.narrowed(limit=3).keys) < set(RobustSpring(root).keys())
    for wrong in ({"corruptions": ["robustspring_snow"]}, {"severities": [2]}):
        refusal(lambda wrong=wrong: benchmark.narrowed(**wrong), UsageError, "robustspring")
    for other in (benchmark, load_benchmark("demo")):
        refusal(partial(other.narrowed, [f"fog+{FOG}"]), UsageError, FOG)


def test_facts_of_robustspring_state_its_corruptions_and_its_domain():
    facts = benchmark_facts("robustspring")
    assert (facts.title, facts.has_flow, facts.published) == ("RobustSpring", False, False)
    assert (len(facts.paper_corruptions), facts.severities) == (20, (1,))
    settings = {"spring": "ID", "flyingchairs": "OOD"}
    for trained, setting in settings.items():
        assert setting_of(Training(sets=(trained,), basis="declared"), "robustspring") == setting
    assert setting_of(UNDECLARED, "robustspring") == "UNKNOWN"


def test_names_of_robustspring_differ_from_those_of_this_project():
    ours = set(CORRUPTIONS.names())
    assert not ours & set(ON_DISK)
    missing_here = {"brightness", "motion_blur", "rain", "speckle_noise", "zoom_blur"}
    assert {name.removeprefix(ON_DISK_PREFIX) for name in ON_DISK} - ours == missing_here
    members = [name for names in MEMBERS.values() for name in names if name in ON_DISK]
    assert members == list(ON_DISK)
    assert len(set(ORDER)) == len(ORDER) == 24 + 20
    refusal(lambda: load_corruption(FOG), UsageError, FOG)

    class Mine:
        name = FOG

        def draw(self, rng, severity, shape):
            return None

        def apply(self, frame, state, index):
            return frame

    refusal(lambda: register_custom(Mine), UsageError, FOG)


def _apart(root: Path, where: str) -> dict[str, str]:
    """Move Spring's own frames to a different folder; return the data options that are then required."""
    target = root.parent / where
    target.parent.mkdir(parents=True, exist_ok=True)
    shutil.move(root / "spring", target)
    return {"spring": str(target)} if where.startswith("far") else {}


@pytest.mark.parametrize("where", ["RobustSpring/clean", "spring", "far/away"])
def test_clean_frames_of_spring_may_be_in_another_folder(root, where):
    before = load_benchmark("robustspring", root)
    frame = before.dataset.load(before.keys[0]).frames[0]
    options = _apart(root, where)
    after = load_benchmark("robustspring", root, options=options)
    assert after.keys == before.keys
    assert after.protocol == before.protocol == {"frames": "released"}
    assert np.array_equal(after.dataset.load(after.keys[0]).frames[0], frame)
    files = after.dataset.files(after.keys[0])
    assert files
    assert all((root.parent / where) in path.parents for path in files)


LOST = {
    "spring": ".",
    "rain/test/0028/frame_left/frame_left_0002.png": "rain/test/0028/frame_left/frame_left_0002.png",
    "fog/test/0003/frame_right": "fog/test/0003/frame_right/frame_right_0001.png",
    "fog/test": ".",
    "spring/test/0003/frame_left/frame_left_0002.png": "spring/test/0003/frame_left",
    "spring/test/0003/frame_left": "spring/test/0003/frame_left",
}


@pytest.mark.parametrize(("lost", "culprit"), LOST.items())
def test_what_is_missing_is_named_before_a_run_starts(root, lost, culprit):
    if (root / lost).is_dir():
        shutil.rmtree(root / lost)
    else:
        (root / lost).unlink()
    refusal(lambda: load_benchmark("robustspring", root), DataError, root / culprit)


def test_a_folder_without_corruptions_and_invalid_options_are_refused(root):
    with pytest.raises(UsageError):
        load_dataset("robustspring", root, sprung="x")
    refusal(lambda: load_benchmark("robustspring", root, options={"spring": "nowhere"}), DataError, "nowhere")
    for name in ("fog", "rain"):
        shutil.rmtree(root / name)
    refusal(lambda: load_benchmark("robustspring", root), DataError, root)


def test_unreadable_or_differing_frames_are_refused_by_their_path(root):
    small = root / "fog/test/0028/frame_left/frame_left_0001.png"
    cv2.imwrite(str(small), np.zeros((24, 32, 3), np.uint8))
    damaged = root / "rain/test/0028/frame_left/frame_left_0001.png"
    damaged.write_bytes(b"no picture")
    pairs = RobustSpring(root)
    key = "0028/flow_FW_left/flow_FW_left_0001"
    for corruption, path in ((FOG, small), (RAIN, damaged)):
        refusal(lambda corruption=corruption: pairs.corrupted(key, corruption, 1), DataError, path)
    refusal(lambda: pairs.load("no"), UsageError, "no")
    for corruption, severity in (("fog", 1), (FOG, 2), ("robustspring_snow", 1)):
        refusal(lambda c=corruption, s=severity: pairs.corrupted(key, c, s), UsageError, corruption)
