"""The paper's tables have the printed values, marks and ranks; runs next to them are labelled."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from robustflow.core.errors import UsageError
from robustflow.models.provenance import Training
from robustflow.report.paper_tables import PAPER_TABLES, build_table, cost_table
from robustflow.report.tables import tables_of
from robustflow.stats.lines import Lines, Numbers, lines_of
from robustflow.stats.published.tables import published_frame, published_lines
from robustflow.stats.results_file import parse_results
from tests.made_rows import change_manifest, made_run
from tests.refusals import refusal

from ..stats.simulated import Truth, rows_of

_SETTING = {"Knowledge-driven (knowledge)": "knowledge", "Out-of-domain (OOD)": "OOD", "In-domain (ID)": "ID"}


def _printed(table) -> dict[tuple[str, str], list[tuple[str, bool]]]:
    return {
        (_SETTING.get(section.title, section.title), line.label): [(cell.text, cell.best) for cell in line.cells]
        for section in table.sections
        for line in section.lines
    }


@pytest.mark.parametrize(
    ("name", "metric", "benchmark"), [("epe", "epe", "kitti-fc"), ("gopro-rcre", "rcre", "gopro-fc")]
)
def test_values_and_marks_are_the_printed_ones(name, metric, benchmark):
    """Check Tab. 2 and 4 only, because some marks in Tab. 7 and 8 are misplaced in the paper (see the audit)."""
    table, published = build_table(name, published_lines()), published_frame()
    for (setting, model), cells in _printed(table).items():
        rows = published.filter(measure=metric, benchmark=benchmark, setting=setting, model=model)
        expected = sorted((f"{row['value']:.2f}", bool(row["marked"])) for row in rows.iter_rows(named=True))
        assert sorted(cells) == expected, (setting, model)
        assert len(cells) == len(table.columns)


@pytest.mark.parametrize(
    ("benchmarks", "title"),
    [
        (["kitti-fc"], "EPE on KITTI-FC"),
        (["sintel"], "EPE on MPI-Sintel"),
        (["sintel", "demo", "kitti-fc"], "EPE on KITTI-FC, the demo and MPI-Sintel"),
    ],
)
def test_the_title_names_what_was_measured_on(benchmarks, title):
    lines = "".join(f"{name},OOD,A,epe,clean,2.00\n{name},OOD,A,epe,average,3.00\n" for name in benchmarks)
    results = lines_of(parse_results(f"benchmark,setting,model,metric,corruption,value\n{lines}", "mine.csv", "file"))
    assert build_table("epe", results).title == title


def test_columns_follow_the_paper():
    table = build_table("epe", published_lines())
    assert [c.label for c in table.columns][:3] == ["Clean", "JPEG", "Pixelate"]
    assert table.columns[-1].label == "AVG EPE"
    cells = dict(zip([(c.group, c.label) for c in table.columns], _printed(table)["ID", "GMA"], strict=True))
    assert cells["Weather", "Snow"] == ("51.76", False)
    assert cells["Blur", "PSF"] == ("3.82", False)


def test_the_cost_table_has_the_printed_ranks():
    texts, best = zip(*_printed(cost_table(published_lines()))["Published", "CSFlow"], strict=True)
    assert texts == ("5.60", "251.7 (5)", "1.16 (3)", "2.19 (5)", "1", "4")
    assert best == (False, False, False, False, True, False)


def _own(text: str) -> Lines:
    return lines_of(parse_results("setting,model,metric,corruption,value,note\n" + text, "own.csv", "own"))


def test_runs_are_compared_only_on_the_same_frames():
    """A model with a tiny error on different pairs does not take the mark from a published one."""
    own = _own("OOD,Tiny,epe,clean,0.01,4 pairs\nOOD,Tiny,epe,fog,0.02,4 pairs\nOOD,Tiny,epe,average,0.02,4 pairs\n")
    table = build_table("epe", {**published_lines(), **own})
    ood = {line.label: line for section in table.sections if "OOD" in section.title for line in section.lines}
    assert ood["Tiny"].note == "4 pairs"
    assert not any(cell.best for cell in ood["Tiny"].cells)
    assert [cell.text for cell in ood["Tiny"].cells].count("-") == 19
    assert ood["SAMFlow-H"].cells[0].best
    claimed = _own("OOD,A,epe,clean,2.0,\nOOD,B,epe,clean,1.0,\nOOD,C,epe,clean,1.00,\n")
    runs = {
        key: Numbers((of, row | {"source": "measured"}) for of, row in line.items()) for key, line in claimed.items()
    }
    table = build_table("epe", {**published_lines(), **runs})
    best = [
        line.label
        for section in table.sections
        if "OOD" in section.title
        for line in section.lines
        if line.cells[0].best
    ]
    assert best == ["SAMFlow-H", "B", "C"]


def test_seeds_have_a_mean_only_in_a_section_with_all_of_them(small_run):
    """Runs of one model may differ in the declared training data."""
    runs = [made_run(small_run, small_run.rows, "A", seed=seed) for seed in (0, 1)]
    (table,) = tables_of(runs, published=False, wanted=["epe"])
    assert [line.label for line in table.lines] == ["A (seed 0)", "A (seed 1)", "A, 2 seeds"]
    change_manifest(runs[1], training=Training(sets=("flyingchairs",), basis="declared"))
    (table,) = tables_of(runs, published=False, wanted=["epe"])
    assert len(table.lines) == 2
    assert not any("seeds" in line.label for line in table.lines)


def test_unknown_or_empty_table_is_refused():
    refusal(lambda: build_table("eppe", published_lines()), UsageError, "eppe")
    for make in (*(lambda name=name: build_table(name, {}) for name in PAPER_TABLES), lambda: cost_table({})):
        refusal(make, UsageError, "--table")


@pytest.mark.parametrize("name", ["epe", "cre", "cost", "effective"])
def test_table_that_shows_none_of_the_runs_is_refused(runs_without_truth, name):
    runs = list(runs_without_truth)
    refusal(partial(tables_of, runs, published=True, wanted=[name]), UsageError, "--table")


def test_every_run_and_published_row_is_in_a_table_or_named(runs_without_truth, small_run):
    runs = list(runs_without_truth)
    (table,) = tables_of(runs, published=True, wanted=["means"])
    assert [len(section.lines) for section in table.sections] == [2, 2, 12, 15, 11]
    refusal(partial(tables_of, runs, published=True, wanted=["row"]), UsageError, "--published")
    with pytest.warns(UserWarning, match="Farneback"):
        tables_of([small_run, *runs], published=True, wanted=["epe"])


@pytest.mark.parametrize(("scale", "reason"), [(1.0, ""), (1e28, "no CRE"), (1e-4, "no CREr")])
def test_line_of_a_run_names_why_it_has_no_cre_or_crer(small_run, scale, reason):
    clean, corrupted = Truth().draw(np.random.default_rng(0), np.ones(8, int))
    run = made_run(small_run, rows_of(scale * clean, scale * corrupted, scale * corrupted), "model")
    (table,) = tables_of([run], published=False, wanted=["means"])
    assert f"{reason}:" in table.lines[0].note if reason else "no CRE" not in table.lines[0].note
    assert (run.cre is None, run.crer is None) == (reason == "no CRE", bool(reason))
