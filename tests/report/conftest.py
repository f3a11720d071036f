"""Fixtures: runs that tables, figures and pages show."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from robustflow.api import Result, evaluate
from robustflow.media.images import write_image
from robustflow.models.provenance import Training
from robustflow.run.run import Run
from tests.made_rows import change_manifest, made_run

from ..stats.simulated import Truth, rows_of


@pytest.fixture(scope="session")
def small_run(tmp_path_factory) -> Result:
    """A run of DIS on the embedded pair with two corruptions, two severities and example pictures."""
    folder = tmp_path_factory.mktemp("small") / "dis"
    return evaluate("dis", "demo", output=folder, corruptions=["contrast", "fog"], severities=[1, 5], examples=True)


@pytest.fixture(scope="session")
def many_images(small_run) -> Callable[..., Run]:
    """A function that makes a synthetic run of 40 images: `many_images(name, worse_by)`; equal seeds give the same
    images.
    """

    def make(name: str, worse_by: float = 1.0, seed: int = 0) -> Run:
        clean, corrupted = Truth().draw(np.random.default_rng(seed), np.ones(40, int))
        rows = rows_of(clean, corrupted * worse_by, corrupted * worse_by)
        run = made_run(small_run, rows, name, benchmark="kitti-fc")
        declared = Training(sets=("flyingchairs",), basis="declared")
        # the digest is that of the run to which the other files of the folder belong
        change_manifest(run, training=declared, identity_digest=small_run.manifest.identity_digest)
        return run

    return make


@pytest.fixture(scope="session")
def runs_without_truth(tmp_path_factory) -> list[Result]:
    """Runs of DIS and Farneback on three frames of noise, which have no ground truth."""
    folder = tmp_path_factory.mktemp("noise")
    rng = np.random.default_rng(0)
    for index in range(3):
        write_image(folder / f"{index}.png", rng.integers(0, 255, (32, 40, 3), np.uint8))
    chosen = {"corruptions": ["elastic_transform", "fog"], "severities": [1]}
    return [evaluate(model, "folder", folder, folder / model, **chosen) for model in ("dis", "farneback")]
