"""The gallery of a pair: its cells equal the output of `corrupt`, its files are complete, and its page has no URLs. The
strip has one column per corruption, with the errors of a run."""

import base64
import io
import re

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
from robustflow.report.gallery import draw
from robustflow.report.gallery.cells import GalleryCell, pair_cells
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
    assert [np.ptp(picture) for _, picture in drawn[:2]] == [np.ptp(pair[0]), 0]


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
