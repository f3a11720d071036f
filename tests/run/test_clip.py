"""Runs of multi-frame models: the clips that they receive, the frames of the pair, and identical rows from every
engine.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

import robustflow as rf
from robustflow.core.errors import DataError, ModelError, RunError, UsageError
from robustflow.corruptions import IMAGE_PAIR, corrupt, corrupt_clip
from robustflow.media.images import read_image, write_image
from robustflow.models import ModelRef, Window
from robustflow.run.engines.ray import files_of
from robustflow.run.plan import Job, Unit
from robustflow.run.repeat import restore_plan
from robustflow.run.source import RunSource
from robustflow.testing import TexturePairs, ZeroClipFlow, ZeroFlow
from tests.corruptions.pictures import picture
from tests.refusals import refusal

from .conftest import FAST, FRAMES, SMALLEST
from .models_for_tests import FiveFrames

pytestmark = pytest.mark.usefixtures("demo_is_small")

MODEL = "tests.run.models_for_tests:FiveFrames"


class Recorder(ZeroClipFlow):
    """Records its input, without that of the second prediction of the first clip."""

    def __init__(self, window=(2, 1)) -> None:
        super().__init__(window)
        self.calls: list[tuple[tuple[np.ndarray, ...], int]] = []

    def predict_clip(self, frames, index):
        again = self.calls and self.calls[0][1] == index and np.array_equal(self.calls[0][0], frames)
        if not again:
            self.calls.append((frames, index))
        return super().predict_clip(frames, index)


class WithPairs(Recorder):
    """Records its input, and also predicts pairs of frames."""

    def __init__(self) -> None:
        super().__init__()
        self.pairs = 0

    def predict(self, frame1, frame2):
        self.pairs += 1
        return ZeroFlow().predict(frame1, frame2)


class Blackens(Recorder):
    """Overwrites its input after recording it."""

    def predict_clip(self, frames, index):
        flow = super().predict_clip(tuple(frame.copy() for frame in frames), index)
        for frame in frames:
            frame[:] = 0
        return flow


def run(model, clip_folder, output, **options):
    chosen = {"corruptions": FAST, "severities": [2, 5], **options}
    return rf.evaluate(model, "folder", clip_folder, output, **chosen)


def test_the_model_gets_the_corrupted_clip(clip_folder, tmp_path):
    model = Recorder()
    run(model, clip_folder, tmp_path / "run", corruptions=["impulse_noise"], severities=[3], seed=5)
    frames = [read_image(clip_folder / f"{number}.png") for number in range(FRAMES)]
    calls = iter(model.calls)
    for pair in range(FRAMES - 1):
        places = [min(max(place, 0), FRAMES - 1) for place in range(pair - 2, pair + 3)]
        first, last = min(places), max(places)
        noisy = list(
            corrupt_clip(frames[first : last + 1], "impulse_noise", 3, seed=5, key=str(pair), first=first - pair)
        )
        for expected in (frames, [None] * first + noisy):
            given, index = next(calls)
            assert index == 2
            assert len(given) == 5
            assert all((a == expected[place]).all() for a, place in zip(given, places, strict=True))
        a, b = corrupt(frames[pair], frames[pair + 1], "impulse_noise", 3, seed=5, key=str(pair))
        assert (given[2] == a).all()
        assert (given[3] == b).all()
    assert next(calls, None) is None


@pytest.mark.parametrize(
    ("window", "lengths", "places"),
    [
        (Window(2, 1, "short"), [3, 4, 5, 5, 4], [0, 1, 2, 2, 2]),
        (Window(2, 1, "inside"), [5, 5, 5, 5, 5], [0, 1, 2, 2, 3]),
        (Window(9, 0, "inside"), [6] * 5, [0, 1, 2, 3, 4]),
    ],
)
def test_window_at_the_ends_of_a_clip_follows_the_model(clip_folder, tmp_path, window, lengths, places):
    model = Recorder(window)
    run(model, clip_folder, tmp_path / "run", **SMALLEST)
    assert [len(frames) for frames, _ in model.calls[::2]] == lengths
    assert [index for _, index in model.calls[::2]] == places
    identity = rf.Result(tmp_path / "run").manifest.identity
    assert identity.model.window == {"before": window.before, "after": window.after, "ends": window.ends}
    other = partial(run, Recorder((1, 1)), clip_folder, tmp_path / "run", **SMALLEST)
    assert "window" in str(refusal(other, RunError, tmp_path / "run"))


def test_two_frame_models_get_the_same_frames_and_identity_on_a_clip(clip_folder, tmp_path):
    chosen = {"corruptions": [name for name in IMAGE_PAIR if name != "frost"], "severities": [4], "limit": 1}
    pairs = run("farneback", clip_folder, tmp_path / "pairs", **chosen)
    clip = run(Recorder(), clip_folder, tmp_path / "clips", **chosen)
    columns = ["sample", "corruption", "severity", "frames_digest"]
    assert pairs.rows.select(columns).equals(clip.rows.select(columns))
    assert pairs.manifest.identity.model.window is None


def test_example_pictures_are_drawn_from_the_clip(clip_folder, tmp_path):
    drawn = run(MODEL, clip_folder, tmp_path / "drawn", examples=True)
    assert list((drawn.path / "examples").iterdir())
    plan = restore_plan(drawn, replace(RunSource.read(drawn.path), model=ModelRef.parse(MODEL)))
    assert plan.window == plan.job().window == Window(2, 1)
    assert isinstance(plan.model.model, FiveFrames)


def test_changed_and_damaged_frames_around_a_pair_are_detected(tmp_path):
    frames = tmp_path / "frames"
    frames.mkdir()
    for number in range(3):
        write_image(frames / f"{number}.png", picture(48, 64, seed=number))
    chosen = SMALLEST | {"limit": 1}
    run(Recorder((0, 1)), frames, tmp_path / "run", **chosen)
    write_image(frames / "2.png", np.zeros((48, 64, 3), np.uint8))
    again = partial(run, Recorder((0, 1)), frames, tmp_path / "run", **chosen)
    assert "'1'" in str(refusal(again, RunError, tmp_path / "run"))
    whole = (frames / "2.png").read_bytes()
    (frames / "2.png").write_bytes(whole[: len(whole) // 2])
    refusal(lambda: run(Recorder((0, 1)), frames, tmp_path / "other", **chosen), DataError, frames / "2.png")


def test_clip_model_refuses_data_of_single_pairs_unless_it_accepts_pairs(clip_folder, tmp_path):
    start = partial(rf.evaluate, Recorder(), "demo", output=tmp_path / "run", **SMALLEST)
    assert "sintel" in str(refusal(start, UsageError, "motorcycle"))
    assert not (tmp_path / "run").exists()
    model = WithPairs()
    result = rf.evaluate(model, "demo", output=tmp_path / "run", **SMALLEST)
    assert (model.pairs, model.calls) == (3, [])  # the clean pair twice
    assert result.manifest.identity.model.window is None
    run(model, clip_folder, tmp_path / "clips", **SMALLEST)
    assert (model.pairs, len(model.calls)) == (3, 2 * (FRAMES - 1))


def test_wrong_flow_of_a_clip_model_names_the_sample(clip_folder, tmp_path):
    class Wrong(Recorder):
        def predict_clip(self, frames, index):
            before = len(self.calls)
            flow = super().predict_clip(frames, index)
            return flow[:5] if (before, len(self.calls)) == (3, 4) else flow

    refusal(
        lambda: run(Wrong(), clip_folder, tmp_path / "run", **SMALLEST), ModelError, "sample '1', contrast severity 1"
    )

    class Raises(Recorder):
        def predict_clip(self, frames, index):
            return frames[7]

    error = refusal(lambda: run(Raises(), clip_folder, tmp_path / "run2", **SMALLEST), ModelError, "sample '0', clean")
    assert "IndexError" in str(error)


class OwnClips(TexturePairs):
    """A user's dataset with clips, one of whose methods fails."""

    def __init__(self, fault) -> None:
        super().__init__(2, (24, 32))
        self._fault = fault

    def _answer(self, method, value):
        if method == self._fault:
            raise KeyError("no disk")
        return None if f"{method} without an answer" == self._fault else value

    def files(self, key):
        return self._answer("files", [])

    def around(self, key, reach):
        return self._answer("around", range(-1, 2))

    def frame(self, key, offset):
        return self._answer("frame", np.zeros((24, 32, 3), np.uint8))

    def frame_files(self, key, offsets):
        return self._answer("frame_files", [])


@pytest.mark.parametrize(
    ("fault", "error", "culprit", "fact"),
    [
        ("files", UsageError, "the dataset 'texture_pairs'", "files('0')"),
        ("around", UsageError, "the dataset 'texture_pairs'", "around('0')"),
        ("around without an answer", UsageError, "the dataset 'texture_pairs'", "around('0')"),
        ("frame", UsageError, "the dataset 'texture_pairs'", "frame('0', -1)"),
        ("frame without an answer", DataError, "sample '0', frame -1", ""),
        ("frame_files", UsageError, "the dataset 'texture_pairs'", "frame_files('0')"),
    ],
)
def test_a_users_dataset_that_fails_is_named(tmp_path, fault, error, culprit, fact):
    own = rf.Benchmark("mine", OwnClips(fault), ("0", "1"), ("contrast",))
    assert fact in str(refusal(lambda: rf.evaluate(Recorder(), own, output=tmp_path / "run"), error, culprit))


def test_a_model_that_writes_into_its_clip_changes_no_frame(clip_folder, tmp_path):
    models = [Recorder(), Blackens()]
    for number, model in enumerate(models):
        run(model, clip_folder, tmp_path / f"run{number}", limit=2)
    plain, writing = ([frame for frames, _ in model.calls for frame in frames] for model in models)
    assert len(plain) == len(writing) > 0
    assert all(np.array_equal(a, b) for a, b in zip(plain, writing, strict=True))


def test_cluster_nodes_must_have_the_frames_around_a_pair(clip_folder, tmp_path):
    job = Job(rf.load_dataset("folder", clip_folder), window=Window(2, 1))
    names = [Path(path).name for path, _ in files_of(job, Unit("2", "fog", (1,)))]
    assert names == ["2.png", "3.png", "0.png", "1.png", "4.png"]
