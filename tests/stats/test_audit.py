"""The audit finds the inconsistencies in the published tables and those added deliberately, but none in consistent
tables."""

from __future__ import annotations

import json
from collections import Counter
from decimal import Decimal
from statistics import fmean

import polars as pl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robustflow.api import evaluate
from robustflow.corruptions.registry import IMAGE_PAIR
from robustflow.stats.audit import AUDIT_CHECKS, Audit, audit_published, audit_results
from robustflow.stats.frame import results_frame
from robustflow.stats.published.tables import published_frame
from robustflow.stats.results import AVERAGE, CLEAN
from robustflow.stats.results_file import parse_results, results_csv
from tests.made_rows import made_run

_FOUND = audit_published()


def _findings_with(check: str, **where: str) -> list:
    return [f for f in _FOUND.findings if f.check == check and all(getattr(f, k) == v for k, v in where.items())]


def test_rows_of_brightflow_and_upflow_are_swapped():
    assert [(f.source, f.metric) for f in _findings_with("swapped")] == [("Tab. 7", "cre"), ("Tab. 8", "rcre")]
    assert all("BrightFlow and UPFlow" in finding.message for finding in _findings_with("swapped"))


def test_samflow_t_disagrees_in_six_columns():
    found = [f.corruption for f in _findings_with("cre", setting="OOD", model="SAMFlow-T") if f.corruption != AVERAGE]
    assert found == ["low_light", "snow", "gaussian_noise", "shot_noise", "impulse_noise", "psf_blur"]
    assert "snow, gaussian_noise, shot_noise" in _findings_with("shifted")[0].message


def test_flowdiffuser_disagrees_in_both_settings():
    counts = Counter(f.setting for f in _findings_with("cre", model="FlowDiffuser") if f.corruption != AVERAGE)
    assert counts == {"OOD": 19, "ID": 15}


def test_finding_gives_the_printed_and_the_recomputed_value():
    """One value of each kind, copied from the paper's tables by hand."""
    contrast = _findings_with("cre", model="BrightFlow", corruption="contrast")[0]
    assert (contrast.given, round(contrast.recomputed, 2), round(contrast.tolerance, 3)) == (3.70, 0.20, 0.015)
    impossible = _findings_with("bound", model="UPFlow", corruption="contrast")[0]
    assert (impossible.given, round(impossible.recomputed, 2)) == (0.68, 3.70)
    ratio = _findings_with("crer", model="SAMFlow-T")[0]
    assert (ratio.given, round(ratio.recomputed, 3)) == (1.17, 1.209)
    marked = _findings_with("best", setting="OOD", corruption="spatter", metric="cre")[0]
    assert (marked.given, marked.recomputed) == (16.79, 16.27)


def test_recomputed_cre_equals_exact_decimal_arithmetic():
    """The same check with exact decimal arithmetic finds the same cells."""
    expected = set()
    for (setting, model), rows in published_frame().filter(benchmark="kitti-fc").group_by("setting", "model"):
        cells = rows.select("measure", "condition", "value").iter_rows()
        number = {(measure, name): Decimal(f"{value:.2f}") for measure, name, value in cells}
        for name in {name for metric, name in number if metric == "cre"}:
            if abs(number["epe", name] - number["epe", CLEAN] - number["cre", name]) > Decimal("0.015"):
                expected.add((setting, model, name))
    assert {(f.setting, f.model, f.corruption) for f in _findings_with("cre")} == expected


def test_consistent_values_are_not_reported():
    assert not _findings_with("average")
    assert not _findings_with("rank")
    assert {(f.setting, f.model) for f in _findings_with("cre")} == {
        ("OOD", "SAMFlow-T"),
        ("OOD", "SAMFlow-B"),
        ("OOD", "FlowDiffuser"),
        ("ID", "FlowDiffuser"),
        ("ID", "BrightFlow"),
        ("ID", "UPFlow"),
    }
    assert not [f for f in _findings_with("best") if f.source in ("Tab. 2", "Tab. 4")]
    assert (_FOUND.checked["cre"], _FOUND.checked["rank"]) == (29 * 21, 14 + 2 * (11 + 14))
    assert set(_FOUND.checked) <= set(AUDIT_CHECKS)


def _csv(values: dict[tuple[str, str, str], str], marked: set[tuple[str, str, str]] = frozenset()) -> pl.DataFrame:
    lines = ["setting,model,metric,corruption,value,marked"]
    lines += [f"ID,{','.join(key)},{value},{'yes' if key in marked else 'no'}" for key, value in values.items()]
    return parse_results("\n".join(lines), "made.csv", "made")


def _consistent(errors: dict[str, list[float]], decimals: int) -> dict[tuple[str, str, str], str]:
    """A consistent table, rounded only after everything has been computed."""
    out = {}
    for model, (clean, *epe) in errors.items():
        of_metric = {
            "epe": epe,
            "cre": [value - clean for value in epe],
            "rcre": [abs(value - clean) * 1.2 + 0.1 for value in epe],
            "crer": [(value - clean) / clean for value in epe],
        }
        table = {("epe", CLEAN): clean}
        for metric, values in of_metric.items():
            table |= {(metric, name): value for name, value in zip(IMAGE_PAIR, values, strict=False)}
            table[metric, AVERAGE] = sum(values) / len(values)
        out |= {(model, *key): f"{value:.{decimals}f}" for key, value in table.items()}
    return out


_ERRORS = st.lists(st.floats(0.5, 60, allow_nan=False), min_size=6, max_size=6)


@given(errors=st.dictionaries(st.sampled_from(["A", "B", "C"]), _ERRORS, min_size=1), decimals=st.integers(1, 5))
@settings(max_examples=60, deadline=None)
def test_consistent_table_has_no_finding_at_any_rounding(errors, decimals):
    assert not audit_results(_csv(_consistent(errors, decimals))).findings


@pytest.mark.parametrize("metric", ["cre", "crer", "rcre"])
def test_a_planted_error_is_found(metric):
    values = _consistent({"A": [2.0, 3.0, 5.0, 9.0, 4.0, 6.0]}, 2)
    values["A", metric, "saturate"] = "0.31"
    found = audit_results(_csv(values)).findings
    check = {"cre": "cre", "crer": "crer", "rcre": "bound"}[metric]
    assert ("saturate", 0.31) in [(f.corruption, f.given) for f in found if f.check == check]
    assert (AVERAGE, metric) in [(f.corruption, f.metric) for f in found if f.check == "average"]


@pytest.mark.parametrize(
    ("corruptions", "averaged", "fits"),
    [
        ("fog elastic_transform raw_noise", "fog elastic_transform raw_noise", True),
        ("fog elastic_transform raw_noise", "fog", True),
        ("fog elastic_transform raw_noise", "fog raw_noise", False),
        ("brightness zoom_blur", "brightness zoom_blur", True),
        ("brightness zoom_blur", "zoom_blur", False),
    ],
)
def test_an_average_is_over_all_corruptions_of_a_line_or_over_the_papers(corruptions, averaged, fits):
    errors = {name: 2.0**number for number, name in enumerate(corruptions.split())}
    errors[AVERAGE] = fmean(errors[name] for name in averaged.split())
    table = _csv({("A", "rcre", name): f"{value:.4f}" for name, value in errors.items()})
    found = audit_results(table).findings
    assert [f.check for f in found] == ([] if fits else ["average"])
    assert all(f"({len(errors) - 1})" in f.message for f in found)


def test_errors_over_different_pixels_are_not_compared():
    values = {"epe,clean": 2.0, "epe,fog": 5.0, "cre,fog": 1.0, "crer,fog": 0.5, "rcre,fog": 2.0}
    for coverage, inconsistent in (("0.5", []), ("", ["bound", "cre", "crer"])):
        lines = ["setting,model,metric,corruption,value,coverage"]
        lines += [f"own,A,{key},{value},{coverage}" for key, value in values.items()]
        table = parse_results("\n".join(lines), "made.csv", "made")
        assert sorted(f.check for f in audit_results(table).findings) == inconsistent


def test_swapped_rows_are_found_in_any_table():
    values = _consistent({"A": [2.0, 3, 5, 9, 4, 6], "B": [3.0, 7, 4, 5, 8, 20], "C": [1.0, 3, 2, 6, 5, 4]}, 2)
    swapped = {
        (m, metric, name): values[({"A": "B", "B": "A"}.get(m, m) if metric == "cre" else m), metric, name]
        for m, metric, name in values
    }
    messages = [f.message for f in audit_results(_csv(swapped)).findings if f.check == "swapped"]
    assert len(messages) == 1
    assert "A and B" in messages[0]


def test_wrong_best_mark_is_reported_and_a_tied_one_is_not():
    values = {("A", "epe", "fog"): "1.00", ("B", "epe", "fog"): "1.00", ("C", "epe", "fog"): "2.00"}
    both = {("A", "epe", "fog"), ("B", "epe", "fog")}
    assert not audit_results(_csv(values, both)).findings
    for marked in ({("A", "epe", "fog")}, {("C", "epe", "fog")}, both | {("C", "epe", "fog")}):
        assert [f.check for f in audit_results(_csv(values, marked)).findings] == ["best"]


def test_findings_read_back_from_json():
    text = _FOUND.model_dump_json()
    assert Audit.model_validate_json(text) == _FOUND
    assert json.loads(text)["findings"][0]["check"] == "swapped"


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    options = {"corruptions": ["contrast", "jpeg_compression"], "severities": [1, 5]}
    pairs = {"pairs": 2, "size": "64x96"}
    return evaluate("farneback", "shapes", output=tmp_path_factory.mktemp("audit"), data_options=pairs, **options)


def test_exported_means_of_an_incomplete_run_are_not_called_inconsistent(run):
    """Its clean and its corrupted errors are over different pairs."""
    last = (pl.col("sample") == run.rows["sample"][-1]) & (pl.col("corruption") == "contrast")
    part = made_run(run, run.rows.filter(~last))
    table, whole = (
        parse_results(results_csv(results_frame([one], ["means"])), "results.csv", "file") for one in (part, run)
    )
    assert table["coverage"].unique().to_list() == [pytest.approx(8 / 10)]
    assert "cre" not in audit_results(table).checked
    assert audit_results(whole).checked["cre"] == 3
