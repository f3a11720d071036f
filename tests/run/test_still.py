"""Still scenes: every frame paired with itself, so that any flow is phantom motion."""

from contextlib import nullcontext
from functools import partial

import numpy as np
import polars as pl
import pytest

import robustflow as rf
from robustflow.core.errors import ModelError, RunError, UsageError
from robustflow.data.datasets.still import Still
from robustflow.media.images import read_image
from robustflow.models import ModelRef
from robustflow.pictures.panel import draw_panel
from robustflow.report.site import render_site, run_content
from robustflow.run.comparable import sample_set
from robustflow.run.repeat import recheck
from robustflow.run.worker import View
from robustflow.stats.exclusion import exclusion_reasons
from robustflow.testing import BrightnessFlow, TexturePairs

from ..refusals import refusal
from .conftest import FRAMES


class Unchanged:
    """A corruption that leaves the frames unchanged."""

    severities = (1, 2, 3, 4, 5)

    def draw(self, rng, severity, shape):
        return None

    def apply(self, frame, state, index):
        return frame


def still_run(model, folder, output, **options):
    given = {"corruptions": ["impulse_noise"], "severities": [2], "still": True, **options}
    return rf.evaluate(model, "folder", folder, output, **given)


def zero(frame1, frame2):
    return np.zeros((*frame1.shape[:2], 2), np.float32)


def test_every_frame_of_a_sequence_is_paired_with_itself_once(clip_folder):
    still = Still(rf.load_dataset("folder", clip_folder), ["0", "1", "2", "3", "4"])
    assert still.keys() == ["0", "1", "2", "3", "4", "4:2"]
    for number, sample in enumerate(still):
        frame = read_image(clip_folder / f"{number}.png")
        assert all(np.array_equal(each, frame) for each in sample.frames)
        assert not sample.flow.any()
        assert sample.valid.all()
        assert sample.group == "frames"


def test_pairs_that_know_no_common_frames_give_both_of_theirs():
    still = Still(TexturePairs(2), ["0", "1"])
    assert still.keys() == ["0", "0:2", "1", "1:2"]
    for key, frame in zip(("1", "1:2"), TexturePairs(2).load("1").frames, strict=True):
        assert np.array_equal(still.load(key).frames[0], frame)


def test_zero_flow_has_no_phantom_motion_and_is_not_excluded(clip_folder, tmp_path):
    run = still_run(zero, clip_folder, tmp_path / "run")
    assert run.rows.height == 2 * FRAMES
    assert run.rows["epe_sum"].to_list() == [0.0] * run.rows.height
    assert run.rows["n_valid"].to_list() == [48 * 64] * run.rows.height
    assert exclusion_reasons(run) == []
    assert (run.epe_clean, run.epe) == (0.0, 0.0)


@pytest.mark.parametrize("model", ["dis", "farneback", "tiny"])
def test_frames_that_stay_equal_give_each_model_its_clean_value(model, clip_folder, tmp_path):
    run = still_run(model, clip_folder, tmp_path / "run", corruptions=[Unchanged, "impulse_noise"], limit=1, workers=1)
    clean, same, noisy = (
        run.rows.filter(corruption=name)["epe_sum"][0] for name in ("clean", "unchanged", "impulse_noise")
    )
    assert same == clean
    assert noisy > clean, "noise that differs between the frames causes flow"


def test_a_still_run_is_rechecked_and_compared_with_no_run_of_moving_frames(clip_folder, tmp_path):
    still = still_run("dis", clip_folder, tmp_path / "still", limit=1, workers=1)
    moving = still_run("dis", clip_folder, tmp_path / "moving", limit=1, workers=1, still=False)
    assert still.benchmark == "folder-still"
    assert sample_set(still) != sample_set(moving)
    with pytest.raises(RunError):
        still.compare(moving)
    error = refusal(
        lambda: still_run("dis", clip_folder, tmp_path / "moving", limit=1, workers=1), RunError, tmp_path / "moving"
    )
    assert "benchmark" in str(error)
    result = recheck(still.manifest.identity, still.rows, clip_folder, model=ModelRef.parse("dis"), count=2)
    assert "2 of 2 rows" in result


def test_a_multi_frame_model_gets_the_same_frame_throughout(clip_folder, tmp_path):
    class Window:
        window = (2, 1)

        def predict_clip(self, frames, index):
            moved = max(float(np.abs(frame.astype(int) - frames[0]).max()) for frame in frames)
            return np.full((*frames[0].shape[:2], 2), moved, np.float32)

    run = still_run(Window(), clip_folder, tmp_path / "run", limit=1)
    assert run.epe_clean == 0.0
    assert run.epe > 0


class Corrupted(TexturePairs):
    """A dataset with precomputed corrupted frames."""

    def has_corrupted(self, corruption):
        return True

    def corrupted(self, key, corruption, severity):
        return self.load(key).frames

    def corrupted_files(self, key, corruption, severity):
        return []


def test_frames_that_exist_only_for_moving_pairs_are_refused():
    refusal(lambda: Still(Corrupted(1), ["0"]), UsageError, "--still")


def test_still_run_on_training_frames_is_labelled_leaked():
    training = rf.models.provenance.Training(sets=("kitti2015",), basis="declared")
    assert rf.data.benchmarks.setting.setting_of(training, "kitti2015-still", ["000000:2"]) == "LEAKED"


def stored(flows, flow):
    """Store a copy of a flow, unless it is that of the second prediction of the first clean frames."""
    flow = flow.astype(np.float32)
    if not (flows and np.array_equal(flows[0], flow)):
        flows.append(flow.copy())
    return flow


class Pairs(BrightnessFlow):
    """A model that stores every flow that it predicts."""

    def __init__(self):
        self.flows = []

    def predict(self, frame1, frame2):
        return stored(self.flows, np.stack([frame1[..., 0], frame2[..., 1]], axis=2))


class Clips:
    """A multi-frame model that stores every flow that it predicts; its flow depends on all its frames."""

    window = (1, 1)

    def __init__(self):
        self.flows = []

    def predict_clip(self, frames, index):
        rest = np.mean([frame[..., 0] for frame in frames], axis=0)
        return stored(self.flows, np.stack([frames[index][..., 0], rest], axis=2))


@pytest.mark.parametrize("kind", [Pairs, Clips])
def test_spread_over_draws_is_that_of_the_flows_of_each_seed(kind, clip_folder, tmp_path):
    drawn = still_run(kind(), clip_folder, tmp_path / "drawn", draws=3, limit=2, seed=5)
    models, runs = [kind(), kind(), kind()], []
    for seed, model in enumerate(models, 5):
        runs.append(still_run(model, clip_folder, tmp_path / f"{seed}", limit=2, seed=seed))
    # errors are measured on the first draw
    assert drawn.rows.drop("spread_sum").equals(runs[0].rows.drop("spread_sum"))
    noisy = drawn.rows.filter(corruption="impulse_noise")
    for number, spread_sum in enumerate(noisy["spread_sum"]):
        each = np.array([model.flows[2 * number + 1] for model in models], np.float64)
        assert spread_sum == pytest.approx(np.sqrt(each.var(axis=0, ddof=1).sum(axis=-1)).sum(), rel=1e-6)
    assert drawn.rows.filter(corruption="clean")["spread_sum"].to_list() == [0.0, 0.0]
    assert drawn.mean("spread") == pytest.approx((noisy["spread_sum"] / noisy["n_all"]).mean(), rel=1e-12)
    assert drawn.mean("spread") > 0
    assert runs[0].mean("spread") is None
    title = "Standard deviation over draws (px) by severity"
    assert [title in render_site(run_content(run)) for run in (drawn, runs[0])] == [True, False]
    if kind is Pairs:
        forged = drawn.rows.with_columns(spread_sum=pl.col("spread_sum") * 1.1)
        for rows, expected in ((drawn.rows, nullcontext()), (forged, pytest.raises(RunError))):
            with expected:
                recheck(drawn.manifest.identity, rows, clip_folder, model=Pairs(), count=4)


def test_equal_draws_are_predicted_once_and_have_no_spread(clip_folder, tmp_path):
    class Counting(BrightnessFlow):
        asked = 0

        def predict(self, frame1, frame2):
            Counting.asked += 1
            return super().predict(frame1, frame2)

    run = still_run(Counting(), clip_folder, tmp_path / "run", draws=4, corruptions=["contrast"], limit=1)
    assert Counting.asked == 3, "clean, twice, and contrast, which is not random"
    assert run.rows["spread_sum"].to_list() == [0.0, 0.0]
    again = partial(still_run, Counting(), clip_folder, tmp_path / "run", corruptions=["contrast"], limit=1)
    assert "draws" in str(refusal(lambda: again(draws=1), RunError, tmp_path / "run"))


def test_nan_of_an_additional_draw_is_refused(clip_folder, tmp_path):
    class Lost(BrightnessFlow):
        asked = 0

        def predict(self, frame1, frame2):
            Lost.asked += 1
            flow = super().predict(frame1, frame2)
            flow[0, 0] = np.nan if Lost.asked == 3 else 0
            return flow

    run = partial(still_run, Lost(), clip_folder, tmp_path / "run", limit=1, workers=1, draws=2)
    refusal(run, ModelError, "sample '3', impulse_noise severity 2")


def test_the_panel_of_a_still_scene_can_be_drawn_without_any_motion(real_pictures):
    with real_pictures():
        sample = Still(TexturePairs(1), ["0"]).load("0")
        flow = zero(*sample.frames)
        assert draw_panel(View(sample, sample.frames, flow, flow, {}), "title", "EPE 0.00 px")[:4] == b"\x89PNG"
