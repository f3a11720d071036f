"""Figures contain the expected elements and are written to the requested files."""

import numpy as np
import pytest

from robustflow.corruptions.optics.design import shipped_lens
from robustflow.corruptions.optics.draw import contact_sheet, lens_figure, save_figure
from robustflow.corruptions.optics.psf_field import shipped_field


@pytest.fixture(scope="module")
def figure():
    return lens_figure(shipped_lens(1), shipped_field(1))


@pytest.fixture(scope="module")
def sheet():
    return contact_sheet([(f"severity {k}", shipped_field(k)) for k in (1, 5)])


def test_figures_are_written_in_three_formats(tmp_path, figure, sheet):
    for each, suffix, start in ((figure, ".png", b"\x89PNG"), (sheet, ".pdf", b"%PDF"), (sheet, ".svg", b"<?xml")):
        path = tmp_path / f"lens{suffix}"
        save_figure(each, path)
        assert path.read_bytes().startswith(start)
        assert path.stat().st_size > 20_000


def test_the_same_figure_is_the_same_bytes(tmp_path):
    for name in ("a.png", "b.png"):
        save_figure(contact_sheet([("one", shipped_field(1))]), tmp_path / name)
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


def test_the_title_says_what_the_lens_is(figure):
    assert "6 elements" in figure.get_suptitle()
    assert "f/2.6" in figure.get_suptitle()


def test_rays_in_the_section_run_from_the_object_to_the_sensor(figure):
    lens, section = shipped_lens(1), figure.subfigs[0].axes[0]
    total = sum(surface.thickness for surface in lens.surfaces)
    rays = [line for line in section.lines if len(line.get_xdata()) == len(lens.surfaces) + 2]
    assert len(rays) == 21
    for ray in rays:
        z = np.asarray(ray.get_xdata())
        assert z[0] < 0.0
        assert z[-1] == pytest.approx(total)
        assert (np.diff(z) > -1e-9).all()


def test_the_sheet_has_a_row_of_eight_psfs_per_lens(sheet):
    assert len(sheet.axes) == 16
    centre = np.asarray(sheet.axes[8].images[0].get_array())
    assert centre.shape == (61, 61, 3)
    assert centre.max() == pytest.approx(1.0)
    assert sheet.axes[8].get_ylabel() == "severity 5"
