"""The histogram stored with a run's rows is computed from the ground truth, drawn on the run's pages, and validated."""

import json
import math
import shutil

import numpy as np
import polars as pl
import pytest

import robustflow as rf
from robustflow.core.errors import RunError, UsageError
from robustflow.core.files import sealed
from robustflow.data.benchmarks import load_benchmark
from robustflow.media.flow import write_flow
from robustflow.media.images import write_image
from robustflow.report.figures import displacement_figure, figure_bytes
from robustflow.report.site import render_site, whole_content
from robustflow.report.tables import figures_of
from robustflow.run.cells import Cells
from robustflow.run.costs import read_displacement, write_displacement
from robustflow.run.displacement import displacement_histogram
from robustflow.stats.anatomy import displacements_of
from robustflow.testing import ZeroFlow
from tests.made_rows import change_manifest

pytestmark = pytest.mark.usefixtures("demo_is_small")

CELL = {"corruptions": ["contrast"], "severities": [1]}


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


def test_page_shows_the_displacement_with_its_numbers(kept):
    page = render_site(whole_content([kept], published=False))
    assert "Flow magnitudes" in page
    found = read_displacement(kept).table.filter(pl.col("share") > 0)
    for low, high, share in found.iter_rows():
        sentence = f"demo, 1 pair (ground truth): length {low:g} to {high:g} px, pixels {100 * share:.3g} %"
        assert page.count(f'data-label="{sentence}"') == 1
    assert "displacement" in figures_of([kept], published=False)
    assert rf.Result(kept.path).plot("displacement").marks


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


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda kept: kept | {"low": kept["low"][::-1]}, "ascend from 0"),
        (lambda kept: kept | {"low": kept["low"][:-1]}, "with one edge per count"),
        (lambda kept: kept | {"pixels": [-1, *kept["pixels"][1:]]}, "pixels.0"),
        (lambda kept: kept | {"pixels": [0.5, *kept["pixels"][1:]]}, "pixels.0"),
        (lambda kept: kept | {"else": 1}, "else"),
        (lambda kept: {}, "run: Field required"),
    ],
)
def test_damaged_displacement_file_is_refused_by_its_path(run, change, says):
    path = run.path / "displacement.json"
    path.write_text(json.dumps(sealed(change(json.loads(path.read_text())))))
    with pytest.raises(RunError, match=says) as caught:
        read_displacement(run)
    assert str(path) in str(caught.value)


def test_a_source_with_markup_stays_text(run):
    path = run.path / "displacement.json"
    path.write_text(json.dumps(sealed(json.loads(path.read_text()) | {"source": "<img src=x onerror=alert(1)>$"})))
    page = render_site(whole_content([run], published=False))
    assert "&lt;img src=x onerror=alert(1)&gt;$" in page
    assert "<img src=x" not in page


def test_ground_truth_takes_precedence_over_a_model_and_equal_displacements_are_merged(kept, run):
    write_displacement(run, displacement_histogram(load_benchmark("demo"), rf.load_model("dis"), "dis"))
    assert list(displacements_of([run])) == ["demo, 1 pair (dis)"]
    assert list(displacements_of([run, kept])) == ["demo, 1 pair (ground truth)"]
    other = rf.Result(kept.path)
    change_manifest(other, planned=(Cells(samples=tuple(kept.manifest.samples), corruptions={"fog": (1,)}),))
    assert list(displacements_of([kept, other])) == ["demo, 1 pair (ground truth)"]


def test_coinciding_lines_are_both_visible():
    table = pl.DataFrame({"low": [0.0, 2.0], "high": [2.0, math.inf], "share": [0.5, 0.5]})
    (axes,) = displacement_figure({"a": table, "b": table, "c": table}).axes
    widths = [patch.get_linewidth() for patch in axes.patches]
    assert widths == sorted(set(widths), reverse=True)


def test_axis_of_shares_ends_near_100_percent():
    table = pl.DataFrame({"low": [0.0, 2.0], "high": [2.0, math.inf], "share": [0.0, 1.0]})
    (axes,) = displacement_figure({"a": table}).axes
    assert 100 < axes.get_ylim()[1] <= 130


def test_impossible_displacement_figure_is_refused():
    empty = pl.DataFrame({"low": [0.0], "high": [math.inf], "share": [0.0]})
    full = empty.with_columns(share=pl.Series([1.0]))
    with pytest.raises(UsageError, match="no displacements to draw"):
        displacement_figure({"a": empty})
    with pytest.raises(UsageError, match="9 histograms"):
        displacement_figure(dict.fromkeys("abcdefghi", full))
    assert figure_bytes(displacement_figure({"a": empty, "b": full}), "png")[1:4] == b"PNG"
