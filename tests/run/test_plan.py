"""The planned units and cells of a run match lists written by hand."""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robustflow.api import evaluate, load_run
from robustflow.corruptions import Corruption
from robustflow.corruptions.digital import Contrast
from robustflow.corruptions.scale import calibration_digest
from robustflow.data.benchmarks import load_benchmark
from robustflow.run.config import FrameOptions, MeasuringOptions, RunConfig
from robustflow.run.manifest import Cells, Manifest
from robustflow.run.plan import Plan, Unit
from robustflow.testing import ZeroFlow

pytestmark = pytest.mark.usefixtures("demo_is_small")

FIXED = "fog:2+snow:4"
"""A stack that exists only at severity 4."""


@pytest.fixture(scope="module")
def benchmark():
    """Two samples and three conditions; no frame is read."""
    demo = load_benchmark("demo").narrowed(["fog", "snow"], [1, 3])
    return replace(demo, keys=("a", "b"), corruptions=("fog", FIXED), attacks=("square",))


PLANNED = Cells(samples=("a", "b"), corruptions={"fog": (1, 3), FIXED: (4,)}, attacks={"square": (1, 3)})


CELLS = [(key, name, severity) for key in "ab" for name, severity in (("clean", 0), ("fog", 1), ("fog", 3), (FIXED, 4))]
ATTACKED = [(key, "square", severity) for key in "ab" for severity in (1, 3)]


def test_units_of_a_plan_are_each_sample_clean_first_then_every_condition(benchmark):
    plan = Plan(benchmark)
    expected = [
        Unit(key, name, levels)
        for key in "ab"
        for name, levels in (("clean", (0,)), ("fog", (1, 3)), (FIXED, (4,)), ("square", (1, 3)))
    ]
    assert plan.units() == expected
    assert plan.count() == 8


@given(st.sets(st.sampled_from([*CELLS, *ATTACKED])))
def test_missing_units_and_done_cells_are_the_whole_plan(benchmark, done):
    plan = Plan(benchmark)
    left = plan.missing(done)
    cells = [cell for unit in left for cell in unit.cells]
    assert sorted([*cells, *done]) == sorted([*CELLS, *ATTACKED])
    assert all(unit.severities for unit in left)


def test_severities_that_the_calibrated_scale_lacks_are_left_out_and_not_counted(benchmark):
    whole = replace(benchmark, corruptions=("fog", "h264_crf"), attacks=())
    plan = Plan(whole, config=RunConfig(frames=FrameOptions(severity_scale="calibrated")))
    assert plan.left_out() == {"h264_crf": (1, 3)}
    assert {unit.corruption for unit in plan.units()} == {"clean", "fog"}
    assert plan.count() == len(plan.units()) == 4
    assert Plan(whole).left_out() == {}


def test_a_severity_that_the_scale_lacks_is_left_out_of_the_call_that_asked_for_it_and_of_the_folder(tmp_path):
    options = {"output": tmp_path / "run", "severity_scale": "calibrated"}
    evaluate(ZeroFlow(), corruptions=["saturate", "contrast"], severities=[1, 5], **options)
    run = evaluate(ZeroFlow(), corruptions=["contrast"], severities=[5], **options)
    assert run.left_out == {}
    assert load_run(tmp_path / "run").left_out == {"saturate": (5,)}
    assert run.measured.complete


def test_the_identity_names_the_scale_that_is_not_the_papers_and_options_that_were_set(benchmark):
    plain = Plan(benchmark).identity
    assert plain.frames.severity_scale == "paper"
    assert not plain.measuring.allow_invalid
    frames = FrameOptions(severity_scale="calibrated")
    chosen = RunConfig(frames=frames, measuring=MeasuringOptions(allow_invalid=True))
    other = Plan(benchmark, config=chosen).identity
    assert other.frames.severity_scale == f"calibrated {calibration_digest()}"
    assert other.measuring.allow_invalid


def test_a_run_builds_a_corruption_once(tmp_path, monkeypatch):
    built = []

    def init(self, *arguments):
        built.append(arguments)
        Corruption.__init__(self, *arguments)

    monkeypatch.setattr(Contrast, "__init__", init)
    evaluate(ZeroFlow(), output=tmp_path, corruptions=["contrast"], severities=[1])
    assert len(built) == 1


def test_cells_of_a_plan_are_listed_without_and_with_attacks(benchmark):
    cells = Plan(benchmark).cells()
    assert cells == PLANNED
    assert list(cells.corrupted()) == CELLS
    assert list(cells.attacked()) == ATTACKED
    assert cells.count() == len([*CELLS, *ATTACKED])


@pytest.mark.parametrize(
    ("planned", "uneven"),
    [
        ([PLANNED], False),
        ([Cells(samples=("a",), corruptions={"fog": (1, 3), "snow": (1,)})], True),
        ([Cells(samples=("a",), corruptions={"fog": (1, 3), "saturate": (1,)})], False),
        ([Cells(samples=("a",), corruptions={"fog": (1,)}, attacks={"square": (3,)})], False),
        ([Cells(samples=("a",), corruptions={"fog": (1,)}), Cells(samples=("b",), corruptions={"fog": (2,)})], True),
    ],
)
def test_a_plan_is_uneven_if_corruptions_differ_in_severities_or_samples_unless_the_scale_lacks_them(planned, uneven):
    manifest = Manifest.model_construct(planned=tuple(planned), left_out={"saturate": (3,)})
    assert manifest.uneven == uneven
