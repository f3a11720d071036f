"""The gallery of a pair or a clip: its cells equal the output of `corrupt` and of the codec, its files are complete,
and its page has no URLs. The strip has one column per corruption, with the errors of a run.
"""

from __future__ import annotations

import base64
import io
import re
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from skimage import data

import robustflow as rf
from robustflow.core.errors import UsageError
from robustflow.core.types import Sample
from robustflow.corruptions import CLIP, IMAGE_PAIR, SEVERITIES, corrupt_clip, load_corruption
from robustflow.corruptions.scale import calibrated_levels
from robustflow.data.datasets.still import still_scene
from robustflow.data.video.clip import write_clip
from robustflow.data.video.codec import crf, rgb_to_i420
from robustflow.media.colours import flow_colours, flow_radius
from robustflow.media.images import write_image
from robustflow.report.gallery import cells as gallery_cells
from robustflow.report.gallery import draw
from robustflow.report.gallery.cells import (
    LONGEST_PART,
    ClipPart,
    GalleryCell,
    chosen_corruptions,
    clip_cells,
    pair_cells,
)
from robustflow.report.gallery.draw import draw_attacks, draw_gallery, draw_strip
from robustflow.report.gallery.slider import WIDEST, gallery_files
from robustflow.testing import BrightnessFlow, TexturePairs
from tests.refusals import refusal

from .elements import Elements

SOME = ["contrast", "impulse_noise", "over_exposure"]


@pytest.fixture(scope="module")
def pair():
    rng = np.random.default_rng(0)
    rough = [Image.fromarray(rng.integers(0, 256, (6, 9, 3)).astype(np.uint8)) for _ in range(2)]
    return tuple(np.array(image.resize((90, 60), Image.Resampling.BICUBIC)) for image in rough)


@pytest.fixture
def drawn(monkeypatch):
    """The (title, picture) of all pictures drawn in a grid."""
    pictures = []
    monkeypatch.setattr(draw, "add_picture", lambda *given: pictures.append((given[6], given[5])))
    return pictures


def test_cells_are_the_frames_that_corrupt_makes(pair):
    for seed in (0, 1, 2):
        for cell in pair_cells(Sample("key", pair), [2, 5], SOME, seed):
            made = rf.corrupt(*pair, cell.name, cell.severity, seed, "key")
            second = "frame 2" in cell.caption
            np.testing.assert_array_equal(cell.frames, made[second][None])
            assert np.array_equal(made[0], pair[0]) == second
            assert float(re.match(r"SSIM (\d\.\d\d)", cell.caption)[1]) < 1
    grey = np.full((32, 48, 3), 128, np.uint8)
    (unchanged,) = pair_cells(Sample("grey", (grey, grey)), [5], ["contrast"])
    assert unchanged.caption == "SSIM 1.00"
    np.testing.assert_array_equal(unchanged.frames, [grey])
    refusal(lambda: list(pair_cells(Sample("", pair), [3], ["h264_crf"])), UsageError, "h264_crf")


def _page(title, clean, cells, severity) -> str:
    return gallery_files(title, clean, cells, severity)["gallery.html"].decode()


def test_a_severity_that_does_not_exist_is_an_empty_place(pair, drawn):
    name = next(name for name in IMAGE_PAIR if 0 < len(calibrated_levels(name)) < 5)
    cells = list(pair_cells(Sample("pair", pair), SEVERITIES, [name], scale="calibrated"))
    assert {cell.severity for cell in cells if cell.frames} == set(calibrated_levels(name))
    lacking = next(cell.severity for cell in cells if not cell.frames)
    (data,) = Elements(_page("t", pair[:1], cells, lacking)).data()
    ((_, shots),) = data["corruptions"]
    assert [shot["severity"] for shot in shots] == list(calibrated_levels(name))
    assert (drawn[1][1] == 236).all()


def test_the_figure_holds_every_picture_in_its_place(pair):
    colours = ((250, 0, 0), (0, 250, 0), (0, 0, 250))
    red, green, blue = (np.full((60, 90, 3), colour, np.uint8) for colour in colours)
    cells = [GalleryCell("a", 1, [green]), GalleryCell("$x_$^{", 1, [blue])]  # an invalid formula
    image = np.array(Image.open(io.BytesIO(draw_gallery(red, cells, "$x_$^{", "png"))).convert("RGB")).astype(int)
    centres = [np.argwhere(np.abs(image - np.array(colour)).max(axis=2) < 5) for colour in colours]
    assert all(len(found) > 0.2 * image.shape[0] * image.shape[1] / 3 for found in centres)
    columns = [found[:, 1].mean() for found in centres]
    assert columns == sorted(columns)
    one, again = (draw_gallery(red, cells[:1], "t", "pdf") for _ in range(2))
    assert one.startswith(b"%PDF")
    assert one == again


@pytest.mark.parametrize(("width", "height", "count"), [(1242, 100, 1), (64, 200, 20), (300, 300, 2)])
def test_gallery_figure_fits_any_number_and_shape_of_images(width, height, count):
    frame = np.zeros((height, width, 3), np.uint8)
    cells = [GalleryCell(f"c{index}", 1, [frame]) for index in range(count)]
    size = Image.open(io.BytesIO(draw_gallery(frame, cells, "t", "png"))).size
    assert size[0] == 1920
    assert size[1] > 100


def test_gallery_page_loads_nothing_shows_names_as_text_and_bounds_its_pictures():
    frame = np.random.default_rng(0).integers(0, 256, (375, 1242, 3)).astype(np.uint8)
    text = _page("<script>alert(1)</script>", [frame], [GalleryCell("<b>x</b>", 3, [frame])], 3)
    page = Elements(text)
    assert not re.search(r"(https?:|//[a-z]|@import|url\()", re.sub(r"base64,[A-Za-z0-9+/=]+", "", text))
    assert "default-src 'none'" in next(a["content"] for a in page.all("meta") if "http-equiv" in a)
    assert not page.all("link")
    assert page.all("script")
    assert all("src" not in attrs for attrs in page.all("script"))
    (slider,) = page.all("input")  # no frame control for a pair
    assert (slider["type"], slider["min"], slider["max"], slider["value"]) == ("range", "1", "5", "3")
    assert any(attrs.get("for") == slider["id"] for attrs in page.all("label"))
    assert "<b>x</b>" not in text
    assert "alert(1)</script>" not in text
    assert {(attrs["width"], attrs["height"]) for attrs in page.all("img")} == {("480", "145")}
    (data,) = page.data()
    for address in (data["clean"][0], data["corruptions"][0][1][0]["pictures"][0]):
        head, _, picture = address.partition(",")
        assert head == "data:image/jpeg;base64"
        assert Image.open(io.BytesIO(base64.b64decode(picture))).size == (WIDEST, 145)
        assert len(picture) < 200_000


def test_the_command_writes_three_files(robustflow, tmp_path, pair):
    for name, frame in zip(("a.png", "b.png"), pair, strict=True):
        write_image(tmp_path / name, frame)
    chosen = ("-s", 4, "-c", "contrast,fog+jpeg_compression", "-o", "out")
    code, out, _ = robustflow("gallery", "--frames", "a.png", "b.png", *chosen)
    assert (code, out.split()) == (0, ["out/gallery.png", "out/gallery.pdf", "out/gallery.html"])
    assert Image.open("out/gallery.png").size[0] == 1920
    assert len(Elements((tmp_path / "out/gallery.html").read_text()).all("img")) == 3


def test_the_gallery_of_attacks_has_a_row_for_each_and_for_the_noise(robustflow, tmp_path, monkeypatch):
    rows = []

    def recorded(clean, attacked, model):
        rows.extend((one.attack, one.linf, one.clean_flow.shape) for one in attacked)
        return draw_attacks(clean, attacked, model)

    monkeypatch.setattr(draw, "draw_attacks", recorded)
    for path, frame in zip(("a.png", "b.png"), TexturePairs(1, (40, 48)).load("0").frames, strict=True):
        write_image(tmp_path / path, frame)
    asked = ("--frames", "a.png", "b.png", "--attacks", "square:queries=5", "-o", "out")
    code, out, _ = robustflow("gallery", *asked, "--model", "dis", "-s", 3)
    assert (code, out) == (0, "out/attacks.webp\n")
    assert [(name, linf) for name, linf, _ in rows if name != "random_gauss"] == [("random_sign", 4), ("square", 4)]
    assert len(rows) == 3
    width, height = Image.open(tmp_path / "out" / "attacks.webp").size
    assert width > height / 3 * 4


def test_strip_of_a_still_scene_has_the_scale_of_its_phantom_motion(monkeypatch, drawn):
    frame = rf.load_dataset("motorcycle").load("motorcycle").frames[0][:60, :80].copy()
    scene, flows, radii = still_scene(Sample("motorcycle", (frame, frame)), 0), [], []

    def predict(first, second):
        flows.append(BrightnessFlow().predict(first, second) * bool(flows))
        return flows[-1]

    monkeypatch.setattr(draw, "flow_colours", lambda flow, radius: radii.append(radius) or flow_colours(flow, radius))
    draw_strip(scene, predict, [load_corruption("impulse_noise")], 3, "mine")
    assert radii == [flow_radius(flows[1])] * 2
    assert f"{np.linalg.norm(flows[1], axis=2).mean():.3f} px" in [title for title, _ in drawn]


def test_columns_of_a_strip_are_the_frames_that_a_run_corrupts(drawn):
    sample = rf.load_dataset("motorcycle").load("motorcycle")
    pair = tuple(np.ascontiguousarray(frame[:90, :120]) for frame in sample.frames)
    names, seen = ["over_exposure", "elastic_transform"], []

    def predict(*frames):
        seen.append(frames)
        return BrightnessFlow().predict(*frames)

    with_truth = Sample("motorcycle", pair, sample.flow[:90, :120], sample.valid[:90, :120])
    draw_strip(with_truth, predict, [load_corruption(name) for name in names], 4, "mine", seed=2)
    for frames, name in zip(seen[1:], names, strict=True):
        np.testing.assert_array_equal(frames, rf.corrupt(*pair, name, 4, seed=2, key="motorcycle"))
    titles = [title for title, _ in drawn]
    assert titles[:6] == ["clean", *names, "flow", "", ""]
    assert titles[8] == "no ground truth"
    for (_, picture), frames in zip(drawn, seen, strict=False):
        assert any(np.array_equal(picture, frame) for frame in frames)
    assert draw_strip(Sample("motorcycle", pair), predict, [], 4, "mine")[8:12] == b"WEBP"


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
        write_image(tmp_path / f"{index + 7}.png", np.full((16, 16, 3), index, np.uint8))
    part = ClipPart(tmp_path, shown=2)
    assert (part.count, part.first_number) == (LONGEST_PART, part.shown[0]), "only a video's frames have numbers"
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
