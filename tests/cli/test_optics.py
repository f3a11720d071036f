"""Test the command `robustflow optics`."""

import json
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from robustflow.corruptions.optics import design as design_module
from robustflow.corruptions.optics.design import Budget, shipped_lens
from robustflow.corruptions.optics.psf_field import shipped_field

SMALL = Budget(structures=30, screened=2, pool=2, moves=2, first_iterations=3, iterations=2, last_iterations=2)


@pytest.mark.slow
def test_design_writes_a_prescription(robustflow, monkeypatch):
    search = design_module.design
    monkeypatch.setattr(design_module, "design", lambda severity, seed, report: search(severity, seed, SMALL, report))
    assert "found: | " in robustflow.prints("optics", "design", "--severity", 2, "--seed", 3, "--output", "lens.json")
    assert json.loads(Path("lens.json").read_text())["name"] == "severity 2, seed 3"


def test_show_writes_png_and_pdf(robustflow, monkeypatch):
    for slow in ("lens_figure", "contact_sheet"):  # tests/corruptions/optics draws them
        monkeypatch.setattr(f"robustflow.corruptions.optics.draw.{slow}", lambda *_: Figure())
    robustflow.prints("optics", "show", "--severity", "2", "--output", "figures")
    names = sorted(file.name for file in Path("figures").iterdir())
    assert names == [f"{name}{end}" for name in ("lens_s2", "psf_profile", "psf_sheet") for end in (".pdf", ".png")]


def test_render_says_that_the_psfs_are_as_shipped(robustflow):
    assert robustflow.prints("optics", "render", "--severity", 2) == "severity 2: as shipped\n"


def test_own_prescription_is_rendered(robustflow, monkeypatch):
    psfs = {shipped_lens(severity): shipped_field(severity) for severity in (1, 2)}
    monkeypatch.setattr("robustflow.corruptions.optics.render.render_psfs", psfs.get)  # the test above renders
    Path("lens.json").write_text(shipped_lens(2).model_dump_json())
    robustflow.prints("optics", "render", "--lens", "lens.json", "--output", "psf.npy")
    assert np.array_equal(np.load("psf.npy"), shipped_field(2).stack)
