"""Histograms of flow magnitudes match a pixel-by-pixel count, and are stored with a run's rows."""

import json
import math
import shutil
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import robustflow as rf
from robustflow.core.errors import DataError, ModelError, RunError
from robustflow.core.files import sealed
from robustflow.data.benchmarks import load_benchmark
from robustflow.media.flow import write_flow
from robustflow.media.images import write_image
from robustflow.report.site import render_site, whole_content
from robustflow.run.displacement import (
    EDGES,
    displacement_histogram,
    displacements_of,
    histogram,
    read_displacement,
    write_displacement,
)
from robustflow.run.manifest import Cells
from robustflow.testing import ZeroFlow
from tests.made_rows import change_manifest

from ..refusals import refusal

pytestmark = pytest.mark.usefixtures("demo_is_small")

CELL = {"corruptions": ["contrast"], "severities": [1]}


@given(st.integers(0, 2**32 - 1))
def test_every_valid_pixel_is_counted_once(seed):
    rng = np.random.default_rng(seed)
    flows = [(rng.integers(-80, 80, (4, 5, 2)).astype(np.float32), rng.random((4, 5)) < 0.7) for _ in range(3)]
    expected = [0] * (len(EDGES) - 1)
    valid = 0
    for flow, mask in flows:
        for (u, v), known in zip(flow.reshape(-1, 2), mask.ravel(), strict=True):
            valid += bool(known)
            for bin_, (low, high) in enumerate(pairwise(EDGES)):
                expected[bin_] += bool(known and low <= math.hypot(u, v) < high)
    table = histogram(flows)
    assert table["pixels"].to_list() == expected
    assert table["share"].sum() == pytest.approx(sum(expected) / valid)


def test_a_flow_that_is_not_finite_is_refused():
    class Broken(ZeroFlow):
        def predict(self, frame1, frame2):
            flow = super().predict(frame1, frame2)
            flow[0, :3, 1] = math.nan, math.inf, -math.inf
            return flow

    error = refusal(
        lambda: displacement_histogram(load_benchmark("demo"), Broken()), ModelError, "sample 'motorcycle', clean"
    )
    assert " 3 " in str(error)


def test_displacement_without_ground_truth_needs_a_model(tmp_path):
    for index in range(2):
        write_image(tmp_path / f"{index}.png", np.zeros((8, 8, 3), np.uint8))
    refusal(lambda: displacement_histogram(load_benchmark("folder", tmp_path)), DataError, "folder")


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    return rf.evaluate(ZeroFlow(), output=tmp_path_factory.mktemp("moved") / "run", examples=True, **CELL)


@pytest.fixture
def run(kept, tmp_path):
    shutil.copytree(kept.path, tmp_path / "run")
    return rf.Result(tmp_path / "run")


def test_run_stores_the_displacement_of_its_ground_truth(kept):
    expected = displacement_histogram(load_benchmark("demo"))
    found = read_displacement(kept)
    assert (found.source, found.samples) == ("ground truth", 1)
    assert found.pixels == expected["pixels"].to_list()
    assert found.table["share"].to_list() == pytest.approx(expected["share"].to_list(), abs=1e-15)
    assert found.table["high"][-1] == math.inf


def test_run_without_examples_or_ground_truth_has_no_displacement(tmp_path):
    assert read_displacement(rf.evaluate(ZeroFlow(), output=tmp_path / "a", **CELL)) is None
    (tmp_path / "data").mkdir()
    for index in range(2):
        write_image(tmp_path / "data" / f"{index}.png", np.full((32, 32, 3), 40 * index, np.uint8))
    bare = rf.evaluate(ZeroFlow(), "folder", tmp_path / "data", tmp_path / "b", examples=True, **CELL)
    assert read_displacement(bare) is None
    assert "Flow magnitudes" not in render_site(whole_content([bare], published=False))


def test_displacement_is_counted_again_for_more_samples(tmp_path):
    home = tmp_path / "training"
    (home / "clean" / "alley").mkdir(parents=True)
    for index in (1, 2, 3):
        write_image(home / "clean" / "alley" / f"frame_000{index}.png", np.full((16, 16, 3), 40 * index, np.uint8))
    (home / "flow" / "alley").mkdir(parents=True)
    for index in (1, 2):
        write_flow(home / "flow" / "alley" / f"frame_000{index}.flo", np.full((16, 16, 2), 3.0 * index, np.float32))
    first = rf.evaluate(ZeroFlow(), "sintel", tmp_path, tmp_path / "run", limit=1, examples=True, **CELL)
    assert sum(read_displacement(first).pixels) == 256
    more = rf.evaluate(ZeroFlow(), "sintel", tmp_path, tmp_path / "run", examples=True, **CELL)
    assert sum(read_displacement(more).pixels) == 512


def test_damaged_displacement_file_is_written_again_by_a_run(run):
    path = run.path / "displacement.json"
    whole = path.read_bytes()
    path.write_text("{")
    rf.evaluate(ZeroFlow(), output=run.path, examples=True, **CELL)
    assert path.read_bytes() == whole


def test_ground_truth_takes_precedence_over_a_model_and_equal_displacements_are_merged(kept, run):
    write_displacement(run, displacement_histogram(load_benchmark("demo"), rf.load_model("dis"), "dis"))
    assert list(displacements_of([run])) == ["demo, 1 pair (dis)"]
    assert list(displacements_of([run, kept])) == ["demo, 1 pair (ground truth)"]
    other = rf.Result(kept.path)
    change_manifest(other, planned=(Cells(samples=tuple(kept.manifest.samples), corruptions={"fog": (1,)}),))
    assert list(displacements_of([kept, other])) == ["demo, 1 pair (ground truth)"]


@pytest.mark.parametrize(
    "change",
    [
        lambda kept: kept | {"low": kept["low"][::-1]},
        lambda kept: kept | {"low": kept["low"][:-1]},
        lambda kept: kept | {"pixels": [-1, *kept["pixels"][1:]]},
    ],
)
def test_damaged_displacement_file_is_refused_by_its_path(run, change):
    path = run.path / "displacement.json"
    path.write_text(json.dumps(sealed(change(json.loads(path.read_text())))))
    refusal(lambda: read_displacement(run), RunError, path)
