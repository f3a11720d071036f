"""The strip has one column per corruption, and its errors equal the errors measured in a run."""

import io
from dataclasses import replace

import numpy as np
from PIL import Image

from robustflow import corrupt, load_dataset
from robustflow.core.types import Sample
from robustflow.corruptions import load_corruption
from robustflow.data.datasets.still import still_scene
from robustflow.media.colours import flow_colours, flow_radius
from robustflow.report.gallery import strip
from robustflow.report.gallery.strip import draw_strip, strip_columns
from robustflow.testing import BrightnessFlow


def test_strip_of_a_still_scene_has_the_scale_of_its_phantom_motion(monkeypatch):
    frame = load_dataset("motorcycle").load("motorcycle").frames[0][:60, :80].copy()
    scene = still_scene(Sample("motorcycle", (frame, frame)), 0)
    corruptions = [load_corruption("impulse_noise")]
    columns = strip_columns(scene, BrightnessFlow().predict, corruptions, 3)
    columns[0] = replace(columns[0], flow=np.zeros_like(columns[0].flow))
    radii, titles = [], []
    monkeypatch.setattr(strip, "flow_colours", lambda flow, radius: radii.append(radius) or flow_colours(flow, radius))
    monkeypatch.setattr(strip, "add_picture", lambda *arguments: titles.append(arguments[6]))
    draw_strip(scene, columns, "mine")
    assert radii == [flow_radius(columns[1].flow)] * 2
    mean = np.linalg.norm(columns[1].flow, axis=2).mean()
    assert {"mine, phantom motion 0.000 px", f"{mean:.3f} px"} < set(titles)


def test_columns_are_the_frames_that_a_run_corrupts():
    sample = load_dataset("motorcycle").load("motorcycle")
    pair = tuple(np.ascontiguousarray(frame[:90, :120]) for frame in sample.frames)
    names = ["over_exposure", "gaussian_noise"]
    predict = BrightnessFlow().predict  # a flow that identifies the frames passed to the model
    clean = Sample("motorcycle", pair)
    columns = strip_columns(clean, predict, [load_corruption(name) for name in names], 4, seed=2)
    assert [column.title for column in columns] == ["clean", *names]
    for column in columns[1:]:
        frames = corrupt(*pair, column.title, 4, seed=2, key="motorcycle")
        assert np.array_equal(column.flow, predict(*frames))
        assert not any(np.array_equal(column.frame, frame) for frame in pair)
    with_truth = Sample("motorcycle", pair, sample.flow[:90, :120], sample.valid[:90, :120])
    for shown in (with_truth, clean):
        drawn = draw_strip(shown, columns, "mine")
        assert drawn == draw_strip(shown, columns, "mine")
        assert Image.open(io.BytesIO(drawn)).size[0] > 3 * 200
