"""Test the shipped lenses: values in the paper, manufacturing limits, and damaged files."""

import json

import numpy as np
import pytest

from robustflow.core.errors import DataError
from robustflow.corruptions.optics import psf_field as shipped
from robustflow.corruptions.optics.design import SPECIFICATIONS, goal_of, ship_lens, shipped_lens
from robustflow.corruptions.optics.lens import AIR, IMAGE_RADIUS, first_order_of
from robustflow.corruptions.optics.merit import FREQUENCIES, Limits
from robustflow.corruptions.optics.psf_field import SIZE
from robustflow.corruptions.optics.render import modulation, moments, nominal_rms

SEVERITIES = (1, 2, 3, 4, 5)
MTF_TOLERANCE = {1: 0.06, 2: 0.06, 3: 0.06, 4: 0.09, 5: 0.06}


@pytest.mark.parametrize("severity", SEVERITIES)
def test_elements_field_and_f_number_equal_the_papers(severity):
    lens, wanted = shipped_lens(severity), SPECIFICATIONS[severity - 1]
    order = first_order_of(lens)
    assert lens.elements == wanted.elements
    assert lens.half_field == wanted.half_field
    assert order.focal_length == pytest.approx(IMAGE_RADIUS / np.tan(np.radians(wanted.half_field)), rel=1e-5)
    diameter = 2 * order.pupil_magnification * lens.stop_radius
    assert order.focal_length / diameter == pytest.approx(wanted.f_number, rel=1e-4)


@pytest.mark.parametrize("severity", SEVERITIES)
def test_the_rms_radius_is_the_one_stated_and_within_eight_percent_of_the_papers(severity):
    assert round(nominal_rms(shipped_lens(severity)), 4) == shipped.RMS_RADII[severity - 1]
    assert shipped.RMS_RADII[severity - 1] == pytest.approx(SPECIFICATIONS[severity - 1].rms, rel=0.08)


@pytest.mark.parametrize("severity", SEVERITIES)
def test_transfer_and_radius_are_those_measured_on_the_reference(severity):
    field, (_, goal) = shipped.shipped_field(severity), goal_of(severity)
    rows = [0, 13, 25, 38, 50, 63]
    tangential, sagittal = modulation(field, FREQUENCIES)
    errors = np.concatenate([tangential[rows] - goal.tangential, sagittal[rows] - goal.sagittal])
    assert np.sqrt((errors**2).mean()) <= MTF_TOLERANCE[severity]
    assert moments(field).rms[rows].mean() == pytest.approx(goal.rms.mean(), rel=0.1)


@pytest.mark.fidelity
@pytest.mark.parametrize("severity", SEVERITIES)
def test_radius_and_energy_over_the_whole_field_are_the_references(shared, severity):
    path = shared("corruption-reference", "reference.json")
    measured = json.loads(path.read_text())["psf_stacks"][f"s{severity}"]
    field = shipped.shipped_field(severity)
    assert moments(field).rms.mean() == pytest.approx(measured["mean_rms_px"], rel=0.1)
    for side in (3, 5, 9, 15, 31):
        wanted = np.array(measured["energy_in_kxk_centre_box"][str(side)])
        middle = slice(SIZE // 2 - side // 2, SIZE // 2 + side // 2 + 1)
        energy = field.stack[..., middle, middle].astype(np.float64).sum((2, 3))
        assert energy.mean() == pytest.approx(wanted.mean(), abs=0.12)


@pytest.mark.parametrize("severity", SEVERITIES)
def test_a_shipped_lens_can_be_made(severity):
    """Glass and air gaps are thick enough, and all semi-diameters are less than 0.9 times the radius of curvature."""
    lens, limits = shipped_lens(severity), Limits()
    slack = 0.05
    for k, surface in enumerate(lens.surfaces[:-1]):
        behind = lens.surfaces[k + 1]
        height = max(surface.semi_diameter, behind.semi_diameter)
        assert abs(surface.curvature) * surface.semi_diameter < 0.92
        sags = []
        for c in (surface.curvature, behind.curvature):
            h = min(height, 0.95 / abs(c)) if c else height
            sags.append(c * h * h / (1 + np.sqrt(1 - c * c * h * h)))
        edge = surface.thickness + sags[1] - sags[0]
        glass = surface.glass != AIR
        assert surface.thickness >= (limits.glass_centre if glass else limits.air_centre) - slack
        assert edge >= (limits.glass_edge if glass else limits.air_edge) - slack
    assert lens.surfaces[-1].thickness >= limits.back - slack


@pytest.fixture
def copy(tmp_path, monkeypatch):
    """Copy the shipped data to a folder in which it may be damaged."""
    for file in shipped.DATA.iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    monkeypatch.setattr(shipped, "DATA", tmp_path)
    shipped.shipped_field.cache_clear()
    yield tmp_path
    shipped.shipped_field.cache_clear()


def test_a_changed_lens_is_refused(copy):
    path = copy / "lens_s1.json"
    lens = json.loads(path.read_text())
    lens["surfaces"][2]["curvature"] += 1e-6
    path.write_text(json.dumps(lens))
    with pytest.raises(DataError, match="not the shipped file"):
        shipped_lens(1)


def test_changed_psfs_are_refused(copy):
    half = np.load(copy / "psf_s2.npz")["half"].copy()
    half[3, 1, 30, 0] *= 1.01
    np.savez_compressed(copy / "psf_s2.npz", half=half)
    with pytest.raises(DataError, match="not the shipped file"):
        shipped.shipped_field(2)


@pytest.mark.parametrize("content", [b"", b"not a zip", b"PK\x03\x04broken"])
def test_damaged_psfs_are_refused(copy, content):
    (copy / "psf_s2.npz").write_bytes(content)
    with pytest.raises(DataError, match="reinstall robustflow"):
        shipped.shipped_field(2)


def test_written_lens_files_are_accepted_by_the_loader(copy):
    lens, field = shipped_lens(2), shipped.shipped_field(2)
    ship_lens(3, lens, field, copy)
    assert shipped_lens(3) == lens
    assert shipped.half_digest(shipped.halved(shipped.shipped_field(3))) == shipped.manifest()["psf_s2"]


def test_all_data_is_small():
    assert sum(file.stat().st_size for file in shipped.DATA.iterdir()) < 2.5e6
