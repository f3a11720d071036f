"""The search and the shipped lenses: seeds, the paper's values, limits, damaged files, figures."""

import json

import numpy as np
import pytest

from robustflow.core.errors import DataError, UsageError
from robustflow.corruptions.optics import psf_field as shipped
from robustflow.corruptions.optics.design import (
    SAMPLES,
    SPECIFICATIONS,
    Budget,
    Structure,
    design,
    goal_of,
    lens_digest,
    ship_lens,
    shipped_lens,
)
from robustflow.corruptions.optics.draw import contact_sheet, lens_figure, save_figure
from robustflow.corruptions.optics.lens import IMAGE_RADIUS, first_order_of
from robustflow.corruptions.optics.merit import FIELDS, FREQUENCIES, Limits, blur_statistics
from robustflow.corruptions.optics.psf_field import SIZE, manifest, shipped_field
from robustflow.corruptions.optics.render import field_rays, modulation, moments, nominal_rms
from robustflow.corruptions.optics.residuals import fill_residuals, residual_count

from ...refusals import refusal

SMALL = Budget(structures=40, screened=4, pool=3, moves=6, first_iterations=4, iterations=4, last_iterations=6)


def test_different_seed_finds_a_different_lens_that_meets_the_specification():
    specification, (_, goal) = SPECIFICATIONS[1], goal_of(2)
    lines = []
    first, second = design(2, 5, SMALL, lines.append), design(2, 6, SMALL)
    assert first.surfaces != second.surfaces
    assert lines[0].endswith(tuple("0123456789"))
    for lens in (first, second):
        assert lens.elements == specification.elements
        assert first_order_of(lens).focal_length == pytest.approx(goal.focal_length, rel=1e-6)
        assert lens.stop == 0


def test_the_singlet_is_found_again_from_its_seed():
    assert lens_digest(design(2)) == manifest()["lens_s2"]


@pytest.mark.slow
@pytest.mark.parametrize("severity", [1, 3, 4, 5])
def test_each_shipped_lens_is_found_again_from_its_seed(severity):
    assert lens_digest(design(severity)) == manifest()[f"lens_s{severity}"]


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


@pytest.fixture
def copy(tmp_path, monkeypatch):
    for file in shipped.DATA.iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    monkeypatch.setattr(shipped, "DATA", tmp_path)
    shipped.shipped_field.cache_clear()
    yield tmp_path
    shipped.shipped_field.cache_clear()


def bent(folder):
    path = folder / "lens_s1.json"
    lens = json.loads(path.read_text())
    lens["surfaces"][2]["curvature"] += 1e-6
    path.write_text(json.dumps(lens))


def brightened(folder):
    half = np.load(folder / "psf_s2.npz")["half"].copy()
    half[3, 1, 30, 0] *= 1.01
    np.savez_compressed(folder / "psf_s2.npz", half=half)


@pytest.mark.parametrize(
    ("damage", "load", "culprit"),
    [
        (bent, lambda: shipped_lens(1), "lens_s1"),
        (brightened, lambda: shipped.shipped_field(2), "psf_s2"),
        *(
            (lambda folder, c=c: (folder / "psf_s2.npz").write_bytes(c), lambda: shipped.shipped_field(2), None)
            for c in (b"", b"not a zip", b"PK\x03\x04broken")
        ),
        (lambda folder: None, lambda: design(6, 0, SMALL), 6),
    ],
)
def test_changed_or_damaged_lens_files_and_unknown_severities_are_refused(copy, damage, load, culprit):
    damage(copy)
    refusal(load, UsageError if culprit == 6 else DataError, culprit or copy / "psf_s2.npz")


def test_written_lens_files_are_accepted_by_the_loader(copy):
    lens, field = shipped_lens(2), shipped.shipped_field(2)
    ship_lens(3, lens, field)
    assert shipped_lens(3) == lens
    assert shipped.half_digest(shipped.halved(shipped.shipped_field(3))) == shipped.manifest()["psf_s2"]


@pytest.fixture(scope="module")
def figure():
    return lens_figure(shipped_lens(1), shipped_field(1))


@pytest.fixture(scope="module")
def sheet():
    return contact_sheet([(f"severity {k}", shipped_field(k)) for k in (1, 5)])


def test_figures_are_written_in_three_formats_with_the_same_bytes_each_time(tmp_path, figure, sheet):
    for each, suffix, start in ((figure, ".png", b"\x89PNG"), (sheet, ".pdf", b"%PDF"), (sheet, ".svg", b"<?xml")):
        save_figure(each, tmp_path / f"lens{suffix}")
        assert (tmp_path / f"lens{suffix}").read_bytes().startswith(start)
    for name in ("a.png", "b.png"):
        save_figure(contact_sheet([("one", shipped_field(1))]), tmp_path / name)
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


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


@pytest.mark.parametrize("severity", [2, 4, 5])
def test_ray_statistics_are_those_of_the_rendered_psf(severity):
    """Statistics computed from rays agree with a Fourier sum over an image of the same rays."""
    lens, field = shipped_lens(severity), shipped_field(severity)
    tangential, sagittal = modulation(field, FREQUENCIES)
    radius = moments(field)
    for row in (0, 27, 63):
        rays = field_rays(lens, np.array([row / 63]), 48, 96)[0]
        sx, sy, weight = (np.stack([colour[part] for colour in rays]) for part in range(3))
        t, re, s, rms, mean = np.empty((3, 5)), np.empty((3, 5)), np.empty((3, 5)), np.empty(3), np.empty(3)
        blur_statistics(sx, sy, weight, t, re, s, rms, mean)
        # at the highest frequency, sampling at pixels causes aliasing, which does not affect the rays
        for frequency, tolerance in enumerate((0.02, 0.02, 0.02, 0.03, 0.06)):
            assert t[:, frequency] == pytest.approx(tangential[row, :, frequency], abs=tolerance)
            assert s[:, frequency] == pytest.approx(sagittal[row, :, frequency], abs=tolerance)
        assert rms == pytest.approx(radius.rms[row], abs=0.15)
        assert mean - mean[1] == pytest.approx(radius.y[row] - radius.y[row, 1], abs=0.1)
        assert (np.abs(re) <= t + 1e-12).all()


def singlet(bend: float):
    """Return the free parameters of a singlet, the arguments that follow them, and an array for the residuals."""
    structure, (_, goal) = Structure(("N-BK7",), 0), goal_of(2)
    index = structure.indices(SAMPLES)
    out = np.zeros(residual_count(index.shape[1] - 1))
    return np.array([bend, bend - 1.93, 0.1, 0.15, -0.5]), (index, structure.stop_surface, goal), out


def test_thin_glass_and_short_gaps_cost():
    """Violating any limit adds residuals; a manufacturable lens has none."""
    free, setting, out = singlet(1.2)

    def mechanical(limits):
        assert fill_residuals(free, *setting, limits, out)
        return (out[FIELDS.size * 51 + 2 :] ** 2).sum()

    free_of_limits = Limits(0.0, -50.0, 1e3, 0.0, -50.0, 1e3, 0.0)
    assert mechanical(free_of_limits) == 0.0
    for name, value in (("glass_centre", 50.0), ("glass_edge", 50.0), ("glass_most", 0.1), ("air_centre", 50.0),
                        ("air_edge", 50.0), ("length", 0.1), ("back", 500.0)):  # fmt: skip
        assert mechanical(free_of_limits._replace(**{name: value})) > 0.0


def test_a_lens_that_cannot_be_built_is_reported():
    free, setting, out = singlet(0.0)
    free[:2] = 0.0  # a plane-parallel plate has no focus
    assert not fill_residuals(free, *setting, Limits(), out)
