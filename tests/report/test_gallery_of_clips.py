"""The gallery of a clip: its frames equal those of `corrupt_clip` and of the codec, and its page works from disk."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from skimage import data

import robustflow as rf
from robustflow.core.errors import UsageError
from robustflow.corruptions import CLIP, corrupt_clip
from robustflow.data.video.clip import write_clip
from robustflow.data.video.codec import crf, rgb_to_i420
from robustflow.media.images import write_image
from robustflow.report.gallery import cells as gallery_cells
from robustflow.report.gallery.cells import LONGEST_PART, ClipPart, chosen_corruptions, clip_cells
from tests.refusals import refusal

from .elements import Elements

HEIGHT, WIDTH, COUNT = 96, 128, 21


def _frame(index: int) -> np.ndarray:
    """An image that moves by two pixels per frame."""
    return data.astronaut()[60 : 60 + HEIGHT, 100 + 2 * index : 100 + 2 * index + WIDTH].copy()


def _ssim(cell) -> float:
    return float(cell.caption.split()[1].rstrip(","))


@pytest.fixture(scope="module")
def video(tmp_path_factory) -> Path:
    """A real H.264 file of 21 frames at 25 frames per second."""
    path = tmp_path_factory.mktemp("clip") / "walk.mp4"
    pictures = (rgb_to_i420(_frame(index)) for index in range(COUNT))
    return write_clip(path, pictures, (HEIGHT, WIDTH), Fraction(25), crf(10)).path


def test_the_frames_shown_are_the_middle_of_the_part(video):
    part = ClipPart(video, shown=4)
    assert (part.count, list(part.shown), part.first_number, part.rate) == (COUNT, [8, 9, 10, 11], 8, Fraction(25))
    for shown, index in zip(part.frames(part.shown), part.shown, strict=True):
        # Encoding is lossy, but each decoded frame is closer to the frame that was written than to its neighbours.
        away = [np.abs(shown.astype(int) - _frame(other)).mean() for other in (index - 1, index, index + 1)]
        assert away[1] == min(away)
    begun = ClipPart(video, start="0.4s", shown=5)
    assert (list(begun.shown), begun.first_number) == ([0, 1, 2, 3, 4], 10)
    later = ClipPart(video, start="10", stop="14", shown=10)
    assert (later.count, list(later.shown), later.first_number) == (4, [0, 1, 2, 3], 10)


def test_a_long_folder_of_frames_is_read_in_natural_order_and_in_part(tmp_path):
    for index in range(LONGEST_PART + 20):
        write_image(tmp_path / f"f{index}.png", np.full((16, 16, 3), index, np.uint8))
    part = ClipPart(tmp_path, shown=2)
    assert part.count == LONGEST_PART
    assert [int(frame[0, 0, 0]) for frame in part.frames(part.shown)] == [LONGEST_PART // 2 - 1, LONGEST_PART // 2]
    assert int(list(part.frames())[-1][0, 0, 0]) == LONGEST_PART - 1


def test_clip_shows_constant_parameters_constant_and_others_changing(video, tmp_path):
    part = ClipPart(video, shown=3)
    shown = list(part.frames(part.shown))
    for cell in clip_cells(part, shown, [3], ["snow", "spatter", "gaussian_noise"], tmp_path, seed=5, key="walk"):
        made = list(corrupt_clip(shown, cell.name, 3, 5, "walk"))
        np.testing.assert_array_equal(cell.frames, made)
        pair = rf.corrupt(shown[0], shown[1], cell.name, 3, 5, "walk")
        np.testing.assert_array_equal(cell.frames[:2], pair)


def test_a_still_picture_shows_an_exposed_frame(video, tmp_path):
    """Exposure changes every second frame, and the seed decides whether the first of them changes."""
    part = ClipPart(video, shown=2)
    shown = list(part.frames(part.shown))
    stills = set()
    for seed in range(6):
        (cell,) = clip_cells(part, shown, [5], ["over_exposure"], tmp_path, seed=seed, key="walk")
        assert cell.frames[cell.still].mean() > shown[cell.still].mean() + 20
        assert _ssim(cell) < 0.95
        assert ("frame 2" in cell.caption) == (cell.still == 1)
        stills.add(cell.still)
    assert stills == {0, 1}


def test_compressed_clips_come_from_the_codec(video, tmp_path):
    """Higher severities look coarser, frames are in order, and a stream too short for bit errors remains undamaged."""
    part = ClipPart(video, shown=3)
    shown = list(part.frames(part.shown))
    cells = {(cell.name, cell.severity): cell for cell in clip_cells(part, shown, [1, 5], list(CLIP[-3:]), tmp_path)}
    for name in ("h264_crf", "h264_abr"):
        assert name in CLIP
        mild, severe = cells[name, 1], cells[name, 5]
        assert len(mild.frames) == len(severe.frames) == 3
        assert _ssim(severe) < _ssim(mild) or name == "h264_abr"  # a small clip may not need the full bit rate
        for frame, clean in zip(mild.frames, shown, strict=True):
            assert np.abs(frame.astype(int) - clean).mean() < 12
    assert _ssim(cells["h264_crf", 5]) < 0.8
    assert cells["bit_error", 1].caption.endswith("no bit errors")
    assert _ssim(cells["bit_error", 1]) > 0.9


def test_bit_errors_hit_a_stream_that_is_long_enough(tmp_path):
    """Noise cannot be compressed: 24 frames of it exceed a million bytes."""
    rng = np.random.default_rng(0)
    for index in range(24):
        write_image(tmp_path / f"{index}.png", rng.integers(0, 256, (192, 256, 3)).astype(np.uint8))
    part = ClipPart(tmp_path, shown=2)
    shown = list(part.frames(part.shown))
    folder = tmp_path / "encoded"
    folder.mkdir()
    (mild, severe) = clip_cells(part, shown, [1, 5], ["bit_error"], folder)
    assert mild.caption.endswith("no bit errors")
    assert not severe.caption.endswith("no bit errors")


CANNOT = [
    ("object_motion_blur", "paper"),
    ("fog+object_motion_blur:2", "paper"),
    ("rolling_shutter", "paper"),
    ("fog+h264_crf", "paper"),
    ("h264_crf", "calibrated"),
]


@pytest.mark.parametrize(("name", "scale"), CANNOT)
def test_corruption_that_a_clip_cannot_show_is_refused(name, scale):
    refusal(lambda: chosen_corruptions([name], scale), UsageError, name)


def test_corruptions_left_out_of_a_clip_are_named_on_the_page_and_in_the_terminal(robustflow, video, monkeypatch):
    chosen, (remark,) = chosen_corruptions(None, "paper")
    assert set(CLIP) - set(chosen) == {"object_motion_blur", "rolling_shutter"}
    assert "rolling_shutter" in remark
    calibrated, (remark,) = chosen_corruptions(None, "calibrated")
    assert not set(CLIP) & set(calibrated)
    assert all(name in remark for name in CLIP)
    monkeypatch.setattr(gallery_cells, "IMAGE_PAIR", ("contrast",))
    monkeypatch.setattr(gallery_cells, "MADE_FROM_CLIP", ("h264_crf",))
    code, _, error = robustflow("gallery", "--clip", video, "--length", 2)
    assert code == 0
    assert "rolling_shutter" in error
    assert "rolling_shutter" in Path("gallery/gallery.html").read_text()


def test_the_command_plays_a_video(robustflow, video):
    code, out, error = robustflow(
        "gallery", "--clip", video, "-c", "snow,h264_crf", "--length", 4, "-s", 4, "-o", "out"
    )
    assert (code, error) == (0, "walk.mp4: corrupting 10/10 (100 %), 0 s left\n")
    assert out.split() == ["out/gallery.png", "out/gallery.pdf", "out/gallery.html"]
    text = Path("out/gallery.html").read_text()
    page = Elements(text)
    assert "frames 8 to 11" in text
    (block,) = page.data()
    assert [name for name, _ in block["corruptions"]] == ["Snow", "H.264 CRF"]
    assert len(block["clean"]) == 4
    for _, shots in block["corruptions"]:
        assert [len(shot["pictures"]) for shot in shots] == [4] * 5
        assert len({shot["pictures"][1] for shot in shots}) == 5
    ids = {attrs["id"]: attrs for attrs in page.all("input")}
    assert (ids["slider-frame"]["type"], ids["slider-frame"]["max"]) == ("range", "3")
    assert [attrs["id"] for attrs in page.all("button")] == ["slider-play"]
    assert "http" not in text.replace("http-equiv", "")


@pytest.mark.parametrize(
    ("arguments", "code"),
    [("--length 1", 2), ("--length 100", 2), ("-c object_motion_blur", 2), ("--start 20", 1)],
)
def test_a_part_that_cannot_be_shown_is_refused_in_one_line(robustflow, video, arguments, code):
    got, _, error = robustflow("gallery", "--clip", video, *arguments.split())
    assert (got, error.count("\n")) == (code, 1), error
    assert not Path("gallery").exists()
