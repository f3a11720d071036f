"""The gallery of a pair: its cells equal the output of `corrupt`, its files are complete, and its page has no URLs. The
strip has one column per corruption, with the errors of a run."""

import base64
import io
import re
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

import robustflow as rf
from robustflow.core.errors import UsageError
from robustflow.core.types import Sample
from robustflow.corruptions import IMAGE_PAIR, SEVERITIES, load_corruption
from robustflow.corruptions.scale import calibrated_levels
from robustflow.data.datasets.still import still_scene
from robustflow.media.colours import flow_colours, flow_radius
from robustflow.media.images import write_image
from robustflow.report.gallery import strip
from robustflow.report.gallery.page import WIDEST, draw_figure, gallery_slider, page_of
from robustflow.report.gallery.pictures import GalleryCell, gallery
from robustflow.report.gallery.strip import StripColumn, draw_attacks, draw_strip, strip_columns
from robustflow.testing import BrightnessFlow, TexturePairs

from .elements import Elements

SOME = ["contrast", "impulse_noise", "over_exposure"]


@pytest.fixture(scope="module")
def pair():
    rng = np.random.default_rng(0)
    rough = [Image.fromarray(rng.integers(0, 256, (6, 9, 3)).astype(np.uint8)) for _ in range(2)]
    return tuple(np.array(image.resize((90, 60), Image.Resampling.BICUBIC)) for image in rough)


def _shots(page):
    return [one["shots"] for one in page.data()[0]["corruptions"]]


def test_cells_are_the_frames_that_corrupt_makes(pair):
    for seed in (0, 1, 2):
        for cell in gallery(Sample("key", pair), [2, 5], SOME, seed):
            made = rf.corrupt(*pair, cell.name, cell.severity, seed, "key")
            second = cell.remark == "frame 2"
            np.testing.assert_array_equal(cell.frames, made[second][None])
            assert np.array_equal(made[0], pair[0]) == second
            assert cell.ssim < 1
    one = Sample("", pair)
    assert {c.remark for seed in range(8) for c in gallery(one, [3], ["over_exposure"], seed)} == {"", "frame 2"}
    grey = np.full((32, 48, 3), 128, np.uint8)
    (unchanged,) = gallery(Sample("grey", (grey, grey)), [5], ["contrast"])
    assert (unchanged.remark, unchanged.ssim) == ("", 1)
    np.testing.assert_array_equal(unchanged.frames, [grey])
    with pytest.raises(UsageError, match="h264_crf"):
        list(gallery(one, [3], ["h264_crf"]))


def test_a_severity_that_does_not_exist_is_an_empty_place(pair):
    name = next(name for name in IMAGE_PAIR if 0 < len(calibrated_levels(name)) < 5)
    cells = list(gallery(Sample("pair", pair), SEVERITIES, [name], scale="calibrated"))
    assert [cell.severity for cell in cells] == list(SEVERITIES)
    assert {cell.severity for cell in cells if cell.frames} == set(calibrated_levels(name))
    lacking = next(cell.severity for cell in cells if not cell.frames)
    page = Elements(page_of(gallery_slider("t", pair[:1], cells, SEVERITIES, lacking)))
    assert [attrs.get("alt") for attrs in page.all("img")] == ["The clean frame", ""]
    assert len(_shots(page)[0]) == len(calibrated_levels(name))
    assert draw_figure(pair[0], [GalleryCell(name, lacking)], "t", "png")[:4] == b"\x89PNG"


def test_the_figure_holds_every_picture_in_its_place(pair):
    colours = ((250, 0, 0), (0, 250, 0), (0, 0, 250))
    red, green, blue = (np.full((60, 90, 3), colour, np.uint8) for colour in colours)
    cells = [GalleryCell("a", 1, [green]), GalleryCell("b", 1, [blue])]
    image = np.array(Image.open(io.BytesIO(draw_figure(red, cells, "title", "png"))).convert("RGB")).astype(int)
    centres = [np.argwhere(np.abs(image - np.array(colour)).max(axis=2) < 5) for colour in colours]
    assert all(len(found) > 0.2 * image.shape[0] * image.shape[1] / 3 for found in centres)
    columns = [found[:, 1].mean() for found in centres]
    assert columns == sorted(columns)
    one, again = (draw_figure(red, cells[:1], "t", "pdf") for _ in range(2))
    assert one.startswith(b"%PDF")
    assert one == again
    name = "$x_$^{"  # matplotlib reads a pair of dollar signs as a formula, which is invalid
    assert draw_figure(pair[0], [GalleryCell(name, 1, [pair[0]])], name, "png")[:4] == b"\x89PNG"
    column = StripColumn(name, pair[0], np.zeros((*pair[0].shape[:2], 2), np.float32))
    assert draw_strip(Sample("pair", pair), [column], name)[8:12] == b"WEBP"


@pytest.mark.parametrize(
    ("width", "height", "count"),
    [(1242, 100, 1), (1242, 100, 20), (64, 200, 1), (64, 200, 20), (300, 300, 2)],
)
def test_gallery_figure_fits_any_number_and_shape_of_images(width, height, count):
    frame = np.zeros((height, width, 3), np.uint8)
    cells = [GalleryCell(f"c{index}", 1, [frame]) for index in range(count)]
    size = Image.open(io.BytesIO(draw_figure(frame, cells, "t", "png"))).size
    assert size[0] == 1920
    assert size[1] > 100


def test_gallery_page_loads_nothing_shows_names_as_text_and_bounds_its_pictures(pair):
    cells = gallery(Sample("pair", pair), SEVERITIES, SOME)
    text = page_of(gallery_slider("two frames", pair[:1], cells, SEVERITIES, 3))
    page = Elements(text)
    assert not re.search(r"(https?:|//[a-z]|@import|url\()", re.sub(r"base64,[A-Za-z0-9+/=]+", "", text))
    assert "default-src 'none'" in next(a["content"] for a in page.all("meta") if "http-equiv" in a)
    assert not page.all("link")
    assert all("src" not in attrs for attrs in page.all("script"))
    (slider,) = page.all("input")  # no frame control for a pair
    assert (slider["type"], slider["min"], slider["max"], slider["value"]) == ("range", "1", "5", "3")
    assert any(attrs.get("for") == slider["id"] for attrs in page.all("label"))
    assert [str(attrs["alt"])[-12:] for attrs in page.all("img")[1:]] == ["t severity 3"] * len(SOME)
    assert [sorted(shots) for shots in _shots(page)] == [list("12345")] * len(SOME)
    frame = np.random.default_rng(0).integers(0, 256, (375, 1242, 3)).astype(np.uint8)
    hostile = "<script>alert(1)</script>"
    text = page_of(gallery_slider(hostile, [frame], [GalleryCell("<b>x</b>", 3, [frame])], [3], 3))
    assert "<b>x</b>" not in text
    assert "alert(1)</script>" not in text
    for attrs in Elements(text).all("img"):
        head, _, data = attrs["src"].partition(",")
        assert head == "data:image/jpeg;base64"
        assert Image.open(io.BytesIO(base64.b64decode(data))).size == (WIDEST, 145)
        assert (attrs["width"], attrs["height"]) == ("480", "145")
        assert len(data) < 200_000


def test_the_command_writes_three_files(gallery_command, tmp_path, pair):
    for name, frame in zip(("a.png", "b.png"), pair, strict=True):
        write_image(tmp_path / name, frame)
    chosen = ("-s", 4, "-c", "contrast,fog+jpeg_compression", "-o", "out")
    code, out, _ = gallery_command("--frames", "a.png", "b.png", *chosen)
    assert (code, out.split()) == (0, ["out/gallery.png", "out/gallery.pdf", "out/gallery.html"])
    assert Image.open("out/gallery.png").size[0] == 1920
    assert len(Elements((tmp_path / "out/gallery.html").read_text()).all("img")) == 3


def test_the_gallery_of_attacks_has_a_row_for_each_and_for_the_noise(gallery_command, tmp_path, monkeypatch):
    rows = []

    def drawn(clean, attacked, model):
        rows.extend((one.attack, one.linf, one.clean_flow.shape) for one in attacked)
        return draw_attacks(clean, attacked, model)

    monkeypatch.setattr("robustflow.report.gallery.strip.draw_attacks", drawn)
    for path, frame in zip(("a.png", "b.png"), TexturePairs(1, (40, 48)).load("0").frames, strict=True):
        write_image(tmp_path / path, frame)
    asked = ("--frames", "a.png", "b.png", "--attacks", "square:queries=5", "-o", "out")
    code, out, _ = gallery_command(*asked, "--model", "dis", "-s", 3)
    assert (code, out) == (0, "out/attacks.webp\n")
    assert [(name, linf) for name, linf, _ in rows if name != "random_gauss"] == [("random_sign", 4), ("square", 4)]
    assert len(rows) == 3
    width, height = Image.open(tmp_path / "out" / "attacks.webp").size
    assert width > height / 3 * 4
    assert "--model" in gallery_command(*asked)[2]


def test_strip_of_a_still_scene_has_the_scale_of_its_phantom_motion(monkeypatch):
    frame = rf.load_dataset("motorcycle").load("motorcycle").frames[0][:60, :80].copy()
    scene = still_scene(Sample("motorcycle", (frame, frame)), 0)
    columns = strip_columns(scene, BrightnessFlow().predict, [load_corruption("impulse_noise")], 3)
    columns[0] = replace(columns[0], flow=np.zeros_like(columns[0].flow))
    radii, titles = [], []
    monkeypatch.setattr(strip, "flow_colours", lambda flow, radius: radii.append(radius) or flow_colours(flow, radius))
    monkeypatch.setattr(strip, "add_picture", lambda *arguments: titles.append(arguments[6]))
    draw_strip(scene, columns, "mine")
    assert radii == [flow_radius(columns[1].flow)] * 2
    mean = np.linalg.norm(columns[1].flow, axis=2).mean()
    assert f"{mean:.3f} px" in titles


def test_columns_of_a_strip_are_the_frames_that_a_run_corrupts():
    sample = rf.load_dataset("motorcycle").load("motorcycle")
    pair = tuple(np.ascontiguousarray(frame[:90, :120]) for frame in sample.frames)
    names = ["over_exposure", "gaussian_noise"]
    predict = BrightnessFlow().predict  # a flow that identifies the frames passed to the model
    clean = Sample("motorcycle", pair)
    columns = strip_columns(clean, predict, [load_corruption(name) for name in names], 4, seed=2)
    assert [column.title for column in columns] == ["clean", *names]
    for column in columns[1:]:
        frames = rf.corrupt(*pair, column.title, 4, seed=2, key="motorcycle")
        assert np.array_equal(column.flow, predict(*frames))
        assert not any(np.array_equal(column.frame, frame) for frame in pair)
    with_truth = Sample("motorcycle", pair, sample.flow[:90, :120], sample.valid[:90, :120])
    for shown in (with_truth, clean):
        drawn = draw_strip(shown, columns, "mine")
        assert drawn == draw_strip(shown, columns, "mine")
        assert Image.open(io.BytesIO(drawn)).size[0] > 3 * 200
