"""Fixtures for page tests: synthetic runs with many images and known rows."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from robustflow.run.identity import Provenance
from robustflow.run.run import Run
from tests.made_rows import change_manifest, made_run

from ...analysis.simulated import Truth, rows_of


@pytest.fixture(scope="session")
def many_images(small_run) -> Callable[..., Run]:
    """A function that makes a synthetic run of 40 images: `many_images(name, worse_by)`; equal seeds give the same
    images.
    """

    def make(name: str, worse_by: float = 1.0, seed: int = 0) -> Run:
        clean, corrupted = Truth().draw(np.random.default_rng(seed), np.ones(40, int))
        rows = rows_of(clean, corrupted * worse_by, corrupted * worse_by)
        run = made_run(small_run, rows, name, benchmark="kitti-fc")
        declared = Provenance(setting="OOD", trained_on=("flyingchairs",), basis="declared")
        # the digest is that of the run to which the other files of the folder belong
        change_manifest(run, provenance=declared, identity_digest=small_run.manifest.identity_digest)
        return run

    return make
