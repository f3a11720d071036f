"""Rows and the way frames were made decide which runs are comparable, and every difference is described."""

import json

import polars as pl
import pytest
from pydantic.fields import FieldInfo

from robustflow.api import evaluate
from robustflow.core.errors import RunError
from robustflow.core.files import digest_of_value, sealed, write_json
from robustflow.metrics.rows import CLEAN
from robustflow.report.comparison import compare
from robustflow.report.tables import tables_of
from robustflow.run.comparable import common_rows, common_to, differences, run_facts, run_names, sample_set
from robustflow.run.identity import FrameIdentity, Identity
from robustflow.run.manifest import Manifest
from robustflow.run.records.pack import load_any_run, pack
from robustflow.run.repeat import recheck
from robustflow.run.run import Run
from robustflow.stats.frame import results_frame
from robustflow.stats.lines import lines_of
from robustflow.stats.notes import comparison_notes
from robustflow.stats.seeds import seeds_of
from robustflow.testing import ZeroFlow
from tests.made_rows import made_run, rows_frame

from ..refusals import refusal
from .mean_rows import row

pytestmark = pytest.mark.usefixtures("demo_is_small")

CELLS = ((CLEAN, 0), ("fog", 1), ("fog", 3), ("snow", 1), ("snow", 3))


def rows(shift: float = 0.0, pairs: int = 6, cells=CELLS, seed: int = 0) -> pl.DataFrame:
    """Errors of a model: 1 to 2 px on clean frames, and `shift` px more under corruption; `seed` selects the frames."""
    return rows_frame(
        row(
            *(f"{pair}", corruption, severity, 10),
            epe=1 + pair / 5 + (severity and (1 + shift) * severity * (1 + pair / 10)),
            rcre=float(severity),
            frames_digest=f"{pair} {corruption} {severity} {seed if severity else 0}",
            magnitude_sum=100.0,
        )
        for pair in range(pairs)
        for corruption, severity in cells
    )


def edited(column: str, where: pl.Expr) -> pl.DataFrame:
    return rows().with_columns(pl.when(where).then(pl.lit("other")).otherwise(column).alias(column))


FOG = pl.col("corruption") == "fog"
DIFFERENT = {
    "a seed": ({"seed": 1}, rows(), "1"),
    "a variant": ({"variant": "reference"}, rows(), "reference"),
    "a scale": ({"severity_scale": "calibrated 00"}, rows(), "calibrated 00"),
    "lenses": ({"psf": "reference 00"}, rows(), "reference 00"),
    "streams": ({"streams": 99}, rows(), "99"),
    "an edited corruption": ({"corruptions": {"tint": "ab"}}, rows(), "tint"),
    "a benchmark": ({"benchmark": "kitti-fc"}, rows(), "KITTI-FC"),
    "a dataset": ({"dataset": "kitti2012"}, rows(), "kitti2012"),
    "options of the data": ({"protocol": {"options": {"render_pass": "final"}}}, rows(), "render_pass=final"),
    "non-occluded truth": ({"protocol": {"ground_truth": "non-occluded"}}, rows(), "non-occluded"),
    "the truth of one pair": ({}, edited("truth_digest", pl.col("sample") == "3"), ""),
    "no truth": ({}, rows().with_columns(truth_digest=pl.lit(None, pl.String)), ""),
    "the clean frames of one pair": (
        {},
        edited("frames_digest", (pl.col("sample") == "3") & (pl.col("severity") == 0)),
        "",
    ),
    "one corrupted pair": ({}, edited("frames_digest", (pl.col("sample") == "3") & FOG), ""),
    "a corruption less": ({}, rows().filter(~FOG), "snow"),
    "a severity less": ({}, rows().filter(pl.col("severity") < 3), "1"),
    "a pair less": ({}, rows(pairs=5), "5"),
    "another pair": ({}, rows(pairs=7).filter(pl.col("sample") != "0"), "pairs"),
    "a row less": ({}, rows().filter(~(FOG & (pl.col("sample") == "3"))), ""),
    "nothing predicted in a row": (
        {},
        rows().with_columns(n_valid=pl.when(FOG & (pl.col("sample") == "3")).then(0).otherwise("n_valid")),
        "",
    ),
}


@pytest.mark.parametrize("what", DIFFERENT)
def test_different_data_are_a_different_sample_set_and_the_difference_is_named(base, what):
    identity, changed, words = DIFFERENT[what]
    one, other = made_run(base, rows()), made_run(base, changed, **identity)
    assert sample_set(one) != sample_set(other)
    described = differences({"A": one, "B": other})
    assert described
    assert words in described
    assert [line.sample_set for line in lines_of(results_frame([one, other]))] == [sample_set(one), sample_set(other)]


@pytest.mark.parametrize(
    "identity", [{"allow_invalid": True}, {"window": {"before": 1}}, {"model": {"name": "B", "preset": "fast"}}]
)
def test_sample_set_does_not_depend_on_the_model(base, identity):
    one, other = made_run(base, rows()), made_run(base, rows(1.0).reverse(), **identity)
    assert sample_set(one) == sample_set(other)
    assert differences({"A": one, "B": other}) == ""


WEIGHTS = [{"checkpoint": letter * 64} for letter in "ab"]
NAMES = [
    ([{}, {"model": {"preset": "fast"}}], ["preset medium", "preset fast"]),
    (
        [{}, {"model": {"preset": "fast"}}, {"model": {"preset": "fast"}, "seed": 1}],
        ["preset medium, seed 0", "preset fast, seed 0", "preset fast, seed 1"],
    ),
    ([{"model": WEIGHTS[0]}, {"model": WEIGHTS[1]}], ["checkpoint aaaaaaaa", "checkpoint bbbbbbbb"]),
    ([{}, {"benchmark": "kitti-fc"}], ["Your own frames", "KITTI-FC"]),
    (
        [{}, {"benchmark": "kitti-fc", "model": {"preset": "fast"}}],
        ["Your own frames, preset medium", "KITTI-FC, preset fast"],
    ),
    ([{}, {"rows": rows().filter(~FOG)}], ["fog and snow", "snow"]),
    ([{}, {"rows": rows(pairs=5)}], ["6 pairs", "5 pairs"]),
]


@pytest.mark.parametrize(("changes", "names"), NAMES)
def test_runs_of_one_model_are_named_by_the_fewest_facts_that_tell_them_apart(base, changes, names):
    def made(rows=rows(), model=(), **identity):  # noqa: B008
        return made_run(base, rows, {"name": "DIS", "preset": "medium"} | dict(model), **identity)

    other = made_run(base, rows(), "other")
    named = run_names([*(made(**change) for change in changes), other])
    assert named == [*(f"DIS ({name})" for name in names), "other"]


def test_runs_that_no_fact_tells_apart_are_named_by_digest_and_number(base):
    one, other, data = made_run(base, rows(), "A"), made_run(base, rows(), "A"), made_run(base, rows(seed=1), "A")
    digest = one.manifest.identity_digest[:8]
    assert run_names([one, other]) == [f"A ({digest})", f"A ({digest}) #2"]
    names = run_names([one, data])
    assert len(set(names)) == 2
    assert all(name.startswith("A (frames ") for name in names)


def test_lines_of_different_seeds_state_their_seed(base):
    runs = [made_run(base, rows(), "A"), made_run(base, rows(), "B", seed=1), made_run(base, rows(), "C")]
    notes = comparison_notes(runs)
    assert notes[0] == notes[2] != notes[1]
    assert [line.fact("note") for line in lines_of(results_frame(runs)).values()] == notes
    assert len(set(comparison_notes(runs[::2]))) == 1


def test_best_value_is_not_marked_across_different_frames(base):
    def best(**other):
        pair = [made_run(base, rows(index), str(index), **(other if index else {})) for index in (0, 1)]
        (table,) = tables_of(pair, published=False, wanted=["epe"])
        return [line.cells[-1].best for section in table.sections for line in section.lines]

    assert best() == [True, False]
    assert best(variant="reference") == [False, False]


def test_common_rows_leave_out_what_differs_entirely():
    other = edited("frames_digest", (pl.col("sample") == "3") & FOG)
    (one, _), remark = common_rows([rows(), other], ["A", "B"])
    assert set(one["corruption"]) == {CLEAN, "snow"}
    assert one.height == 18
    assert all(part in remark for part in ("18", "30 in A", "30 in B", "1 corruption (fog)"))
    other = edited("truth_digest", pl.col("sample") == "3")
    (one, _), remark = common_rows([rows(), other], ["A", "B"])
    assert "3" not in set(one["sample"])
    assert "1 pair (3)" in remark
    assert common_rows([rows(), rows(1.0)], ["A", "B"])[1] == ""


def test_comparison_without_a_common_frame_or_over_different_ground_truth_is_refused(base):
    first = made_run(base, rows(), benchmark="kitti-fc")
    other_truth = rows().with_columns(truth_digest=pl.lit("1.5 times"))
    other_frames = rows().with_columns(sample=pl.lit("x") + pl.col("sample"))
    for second in (made_run(base, other_truth), made_run(base, other_frames, benchmark="middlebury")):
        refusal(lambda second=second: common_to({"A": first, "B": second}), RunError, "A and B")


def test_one_benchmark_under_two_names_is_compared_where_the_frames_are_equal(base):
    common = common_to({"A": made_run(base, rows()), "B": made_run(base, rows(1.0, pairs=4), benchmark="kitti2015")})
    assert common.rows["A"].height == 20
    assert "KITTI flow 2015" in common.remark


def test_seeds_are_split_only_where_nothing_else_differs(base):
    runs = [made_run(base, rows(seed=seed), seed=seed) for seed in (0, 1, 2)]
    assert list(seeds_of(runs).rows) == [0, 1, 2]
    assert seeds_of([*runs[:2], made_run(base, rows(seed=2), seed=2, variant="reference")]) is None
    assert seeds_of([*runs[:2], made_run(base, rows(seed=2), "other", seed=2)]) is None
    assert seeds_of([*runs, runs[0]]) is None
    other = rows(seed=2).with_columns(truth_digest=pl.lit("other"))
    assert seeds_of([*runs[:2], made_run(base, other, seed=2)]) is None
    fewer = seeds_of([*runs[:2], made_run(base, rows(seed=2, pairs=4), seed=2)])
    assert {one.height for one in fewer.rows.values()} == {20}
    assert "20 common rows" in fewer.remark


@pytest.fixture
def weather():
    """Adds a field `weather` to `FrameIdentity`, with the given default."""
    originals = dict(FrameIdentity.__pydantic_fields__)

    def rebuilt(fields):
        FrameIdentity.__pydantic_fields__ = fields
        for model in (FrameIdentity, Identity, Manifest):
            model.model_rebuild(force=True)

    def default(value: str):
        rebuilt(originals | {"weather": FieldInfo(annotation=str, default=value)})

    yield default
    rebuilt(originals)


def test_a_field_added_to_the_frames_is_followed_by_resume_groups_compare_records_and_set_up(weather, tmp_path):
    chosen = {"corruptions": ["contrast"], "severities": [1]}
    dry = evaluate(ZeroFlow(), output=tmp_path / "dry", **chosen)
    weather("wet")  # as in a version that added this field to its plans
    content = json.loads(dry.manifest.document())
    content["identity"]["frames"]["weather"] = "dry"
    content["identity_digest"] = digest_of_value(content["identity"])
    write_json(dry.path / "manifest.json", sealed(content))
    dry, wet = Run(dry.path), evaluate(ZeroFlow(), output=tmp_path / "wet", **chosen)
    assert run_facts([dry])[0]["weather"] == "weather dry"
    refusal(lambda: evaluate(ZeroFlow(), output=dry.path, **chosen), RunError, dry.path)
    assert sample_set(dry) != sample_set(wet)
    assert differences({"A": dry, "B": wet}) == "A: weather dry; B: weather wet"
    assert "weather dry" in compare(dry, wet).remark
    assert [note.rpartition("; ")[2] for note in comparison_notes([dry, wet])] == ["weather dry", "weather wet"]
    packed = load_any_run(pack(dry, tmp_path / "a.robustflow"))
    assert packed.manifest.identity == dry.manifest.identity
    refusal(lambda: recheck(packed.manifest.identity, packed.rows), RunError, "weather")
    assert recheck(wet.manifest.identity, wet.rows)
