"""The strip: a column a corruption, whose errors are those that a run measures."""

import io

import numpy as np
from PIL import Image

from robustflow import corrupt, load_dataset
from robustflow.corruptions import load_corruption
from robustflow.report.gallery.strip import draw_strip, strip_columns
from robustflow.sample import Sample
from robustflow.testing import BrightnessFlow


def test_columns_are_the_frames_that_a_run_corrupts():
    sample = load_dataset("motorcycle").load("motorcycle")
    pair = tuple(np.ascontiguousarray(frame[:90, :120]) for frame in sample.frames)
    names = ["over_exposure", "gaussian_noise"]
    predict = BrightnessFlow().predict  # a flow that tells which frames the model was given
    columns = strip_columns(pair, predict, [load_corruption(name) for name in names], 4, 2, "motorcycle")
    assert [column.title for column in columns] == ["clean", *names]
    for column in columns[1:]:
        frames = corrupt(*pair, column.title, 4, seed=2, key="motorcycle")
        assert np.array_equal(column.flow, predict(*frames))
        assert not any(np.array_equal(column.frame, frame) for frame in pair)
    with_truth = Sample("motorcycle", pair, sample.flow[:90, :120], sample.valid[:90, :120])
    for shown in (with_truth, Sample("motorcycle", pair)):
        drawn = draw_strip(shown, columns, "mine")
        assert drawn == draw_strip(shown, columns, "mine")
        assert Image.open(io.BytesIO(drawn)).size[0] > 3 * 200
