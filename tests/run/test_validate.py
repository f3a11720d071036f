"""A validation in memory has the rows and the means of a run."""

import numpy as np
import pytest

import robustflow as rf
from robustflow.core.errors import ModelError, UsageError
from robustflow.metrics.rows import CLEAN, ROW_KEY
from robustflow.run.setup import open_benchmark
from robustflow.run.validate import validate
from robustflow.testing import ConstantFlow

from ..refusals import refusal

FRAMES = np.random.default_rng(0).integers(0, 255, (2, 24, 32, 3)).astype(np.uint8)
TRUTH = np.ones((24, 32, 2), np.float32), np.ones((24, 32), bool)


def sample(key, *truth):
    return rf.Sample(key, tuple(FRAMES), *truth)


@pytest.mark.usefixtures("demo_is_small")
def test_rows_and_means_equal_those_of_a_run(tmp_path):
    asked = {"corruptions": ["noise", "contrast"], "severities": [2, 5]}
    model = rf.load_model("dis", preset="ultrafast")
    run = rf.evaluate(model, "demo", output=tmp_path / "run", progress=False, **asked)
    demo = open_benchmark("demo")
    loaded = [demo.dataset.load(key) for key in demo.keys]
    for samples in (demo, loaded):
        validated = validate(model, samples, **asked)
        assert validated.rows.sort(ROW_KEY).equals(run.rows.sort(ROW_KEY))
        assert validated.averages.means == run.means
    assert validate(model, demo.narrowed(**asked)).rows.equals(validate(model, demo, **asked).rows)


def test_without_corruptions_only_clean_frames_are_measured():
    validated = validate(lambda first, second: np.zeros((24, 32, 2), np.float32), [sample(key, *TRUTH) for key in "ab"])
    assert validated.rows["corruption"].to_list() == [CLEAN, CLEAN]
    assert validated.averages.mean("epe", CLEAN) == pytest.approx(2**0.5)


def test_name_of_the_clean_pairs_depends_on_frames_and_truth_only():
    first, again = (validate(ConstantFlow(u, 0), [sample("a", *TRUTH)], ["contrast"], [u]) for u in (1, 2))
    other = validate(ConstantFlow(1, 0), [sample("a", 2 * TRUTH[0], TRUTH[1])])
    assert first.clean_pairs == again.clean_pairs != other.clean_pairs


@pytest.mark.parametrize(
    ("model", "corruptions", "severities", "error", "culprit"),
    [
        (ConstantFlow(1, 0), ["foggy"], [1], UsageError, "foggy"),
        (ConstantFlow(1, 0), ["fog"], [6], UsageError, "6"),
        (ConstantFlow(1, 0), ["h264_crf"], [1], UsageError, "h264_crf"),
        (ConstantFlow(np.nan, 0), None, None, ModelError, "sample 'a', clean"),
    ],
)
def test_unsuitable_corruptions_and_models_are_refused(model, corruptions, severities, error, culprit):
    refusal(lambda: validate(model, [sample("a", *TRUTH)], corruptions, severities), error, culprit)
