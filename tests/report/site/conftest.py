"""Fixtures for page tests: synthetic runs with many images and known rows."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from robustflow.api import Result
from robustflow.runs.manifest import Selection
from robustflow.runs.provenance import Provenance
from tests.made_rows import change_identity, change_manifest

from ...analysis.simulated import Truth, rows_of


@pytest.fixture(scope="session")
def many_images(small_run) -> Callable[..., Result]:
    """A function that makes a synthetic run of 40 images: `many_images(name, worse_by)`; equal seeds give the same
    images.
    """

    def make(name: str, worse_by: float = 1.0, seed: int = 0) -> Result:
        clean, corrupted = Truth().draw(np.random.default_rng(seed), np.ones(40, int))
        rows = rows_of(clean, corrupted * worse_by, corrupted * worse_by)
        result = Result(small_run.path)
        result.manifest = small_run.manifest
        change_identity(result, {"name": name}, benchmark="kitti-fc")
        change_manifest(
            result,
            identity_digest=f"{len(name):016x}",
            provenance=Provenance(setting="OOD", trained_on=("flyingchairs",), basis="declared"),
            samples=dict.fromkeys(rows["sample"].unique(maintain_order=True), ()),
            selection=Selection(corruptions=("fog", "snow"), severities=(1, 2, 3)),
        )
        result.rows = rows
        return result

    return make
