"""`robustflow predict` writes the model's prediction."""

import av
import numpy as np
import pytest

import robustflow as rf
from robustflow.media.images import read_image, write_image
from tests.data.video import clips


@pytest.fixture
def pair(tmp_path):
    rng = np.random.default_rng(0)
    texture = rng.integers(0, 256, (80, 120, 3), np.uint8)
    paths = [tmp_path / f"{name}.png" for name in "ab"]
    for shift, path in enumerate(paths):
        write_image(path, np.ascontiguousarray(np.roll(texture, 3 * shift, axis=1)))
    return paths


def test_flow_of_two_frames_is_written(robustflow, pair):
    assert robustflow.prints("predict", *pair, "-o", "flows") == "flows\n"
    flow, valid = rf.read_flow("flows/a.flo")
    expected = rf.load_model("dis").predict(*map(read_image, pair))
    assert valid.all()
    np.testing.assert_array_equal(flow, expected)
    assert np.median(flow[..., 0]) == pytest.approx(3, abs=0.5)
    assert read_image("flows/a.colours.png").shape == (80, 120, 3)


def test_existing_output_is_not_overwritten(robustflow, pair):
    robustflow.prints("predict", *pair, "-o", "flows")
    refused = robustflow.refuses("predict", *pair, "-o", "flows", "-m", "farneback")
    assert refused.startswith("robustflow: flows/a.flo: ")
    np.testing.assert_array_equal(rf.read_flow("flows/a.flo")[0], rf.load_model("dis").predict(*map(read_image, pair)))
    robustflow.prints("predict", *pair, "-o", "flows", "-m", "farneback", "--overwrite")


def test_flow_of_a_clip_is_written_as_a_video(robustflow, tmp_path):
    clip = clips.clip(tmp_path / "clip.mp4", 4).path
    arguments = ("predict", clip, "--video", "flow.mp4", "--no-pictures", "--format", "png", "-o", "flows")
    assert robustflow.prints(*arguments) == "flows\nflow.mp4\n"
    with av.open("flow.mp4") as container:
        frames = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
    with av.open(str(clip)) as container:
        first = next(container.decode(video=0)).to_ndarray(format="rgb24")
    assert len(frames) == 3
    height = first.shape[0]
    assert frames[0].shape[0] == 2 * height
    assert np.abs(frames[0][:height].astype(int) - first).mean() < 8  # the frame, compressed again, is at the top


@pytest.mark.parametrize(
    ("arguments", "code"),
    [("a.png", 2), ("a.png b.png --format gif", 2), ("a.png b.png -D step=2", 2), ("a.png c.png", 1)],
)
def test_frames_that_cannot_be_predicted_are_refused(robustflow, pair, arguments, code):
    robustflow.refuses("predict", *arguments.split(), code=code)
