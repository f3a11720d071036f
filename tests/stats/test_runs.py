"""Runs listed next to published results have the right values, names, settings and marks."""

from __future__ import annotations

from functools import partial

import polars as pl
import pytest

from robustflow.api import Result, evaluate
from robustflow.cli.tables import print_result
from robustflow.core.errors import UsageError
from robustflow.corruptions.registry import IMAGE_PAIR, PAPER_ORDER
from robustflow.data.benchmarks import benchmark_facts, outside_remark
from robustflow.data.datasets.split import KITTI_KEYS, kitti_split
from robustflow.report.leaderboard import by_error
from robustflow.report.render import FORMATS, render
from robustflow.report.site import render_site
from robustflow.report.site.content import whole_content
from robustflow.report.site.figures import page_figures
from robustflow.report.site.headline import headline_of
from robustflow.report.table import run_frame
from robustflow.report.tables import ROW, TABLES, figures_of, tables_of
from robustflow.run.run import Run
from robustflow.stats.lines import lines_of, ranked
from robustflow.stats.notes import comparison_note
from robustflow.stats.published.tables import published_frame
from robustflow.testing import ZeroFlow
from tests.made_rows import change_identity, made_run
from tests.refusals import refusal


class Still(ZeroFlow):
    """A model that predicts zero flow."""

    def __init__(self, name: str = "<img src=x onerror=alert(1)>", trained_on: str | None = None) -> None:
        super().__init__()
        self._identity = {"name": name}
        self.trained_on = trained_on

    def identity(self):
        return self._identity


@pytest.fixture(scope="module")
def runs(tmp_path_factory) -> list[Result]:
    folder = tmp_path_factory.mktemp("runs")
    options = {"corruptions": ["contrast", "jpeg_compression"], "severities": [1, 3]}
    models = {"dis": "dis", "still": Still(), "in_domain": Still("Trained", trained_on="M:train")}
    return [evaluate(model, "demo", output=folder / name, **options) for name, model in models.items()]


def test_values_are_those_of_the_summary(runs):
    for run, line in zip(runs, lines_of(run_frame(runs)).values(), strict=True):
        assert line.number("epe", "clean") == run.epe_clean
        assert line.number("cre", "average") == run.cre
        assert line.number("rcre", "contrast") == run.mean("rcre", "contrast")


def _table(runs, published=False):
    (table,) = tables_of(runs, published=published, wanted=["epe"])
    return [column.label for column in table.columns], [line for part in table.sections for line in part.lines]


def _all_of_the_paper_and_a_far_one(run, **identity):
    """All corruptions of the paper have the same error; one outside the paper has a hundred times that error."""
    one = run.rows.filter(pl.col("corruption") == "contrast")
    others = [one.with_columns(corruption=pl.lit(name)) for name in PAPER_ORDER if name in IMAGE_PAIR]
    far = one.with_columns(corruption=pl.lit("elastic_transform"), epe_sum=100 * pl.col("epe_sum"))
    return made_run(run, pl.concat([run.rows.filter(corruption="clean"), *others, far]), "DIS", **identity)


def test_terminal_names_calibrated_severities_and_the_corruptions_of_each_mean(runs, capsys):
    for scale in ("paper", "calibrated 00"):
        print_result(_all_of_the_paper_and_a_far_one(runs[0], severity_scale=scale), report=False)
        out = capsys.readouterr().out
        assert ("calibrated" in out) == (scale != "paper")
        assert " 20" in out


def _average(run, published):
    columns, lines = _table([run], published)
    line = next(line for line in lines if line.label == "DIS" and line.note)
    return dict(zip(columns, (cell.text for cell in line.cells), strict=True)), line.note


def test_beside_published_rows_an_average_is_the_papers_where_all_of_its_corruptions_were_run(runs):
    mean = runs[0].mean("epe", "contrast")
    whole = _all_of_the_paper_and_a_far_one(runs[0])
    cells, note = _average(whole, published=True)
    assert cells["AVG EPE"] == f"{mean:.2f}"
    assert cells["Elastic transform"] == f"{100 * mean:.2f}"
    assert "20 of 21" in note
    cells, note = _average(whole, published=False)
    assert cells["AVG EPE"] == f"{120 * mean / 21:.2f}"
    assert " 21 " in note
    few = pl.col("corruption").is_in(["clean", "contrast", "elastic_transform"])
    part = made_run(runs[0], whole.rows.filter(few), "DIS")
    for published in (True, False):
        cells, note = _average(part, published)
        assert cells["AVG EPE"] == f"{101 * mean / 2:.2f}"
        assert "elastic transform" in note
    content = whole_content([whole])
    board = next(board for board in content.boards if any(line.label == "DIS" for line in board.lines))
    assert f"{mean:.2f} px under 20 corruptions" in headline_of(content, board, {}).sentence
    line = next(line for key, line in content.lines.items() if key.model == "DIS" and line.is_run)
    assert line.number("epe", "average") == mean


def test_excluded_model_is_never_marked_best_and_a_footnote_gives_the_reason(runs):
    """A model with the lowest errors under corruption that is no better than zero flow on clean frames."""

    def marked(*runs):
        return {line.label: (sum(cell.best for cell in line.cells), line.note) for line in _table(runs)[1]}

    rows, own = runs[0].rows, runs[1]
    low = rows.with_columns(epe_sum=pl.col("epe_sum") / 100, clean_epe_sum=pl.col("clean_epe_sum") / 100)
    good, bad = made_run(own, rows, "Good"), made_run(own, rows.with_columns(2 * pl.col("epe_sum")), "Bad")
    assert marked(made_run(own, low, "Lucky"), good, bad)["Lucky"][0] > 0, "it would be the best if it were ranked"
    useless = made_run(own, low.with_columns(magnitude_sum=pl.col("n_valid") * 0.001), "Useless")
    best = marked(useless, good, bad)
    assert best["Useless"][0] == 0
    assert "0.03 px" in best["Useless"][1]
    assert best["Good"][0] > 0
    assert {line.model for line in ranked(lines_of(run_frame([useless, good, bad])))} == {"Good", "Bad"}
    content = whole_content([useless, good, bad], published=False)
    cells = {line.label: line.cells for line in content.boards[0].lines}
    assert not any(cell.best for cell in cells["Useless"])
    assert any(cell.best for cell in cells["Good"])
    assert next(line for key, line in content.lines.items() if key.model == "Useless").fact("excluded")


def test_excluded_runs_are_in_no_trend_correlation_or_figure_and_a_remark_names_them(runs):
    """Five models of different accuracy, and a nearly blind one whose errors would distort every fitted line."""
    rows = runs[0].rows

    def scaled(name, clean, ratio):
        factor = pl.when(pl.col("corruption") == "clean").then(clean).otherwise(clean * ratio)
        changed = rows.with_columns(epe_sum=pl.col("epe_sum") * factor, clean_epe_sum=pl.col("clean_epe_sum") * clean)
        return made_run(runs[1], changed, name)

    models = {"A": (1.0, 1.0), "B": (1.2, 0.9), "C": (1.5, 1.3), "D": (2.0, 1.1), "E": (3.0, 1.2)}
    sound = [scaled(name, *factors) for name, factors in models.items()]
    useless = scaled("Useless", 9.0, 0.8)

    def numbers(name, of):
        (table,) = tables_of(of, published=False, wanted=[name])
        lines = {line.label: [cell.text for cell in line.cells] for each in table.sections for line in each.lines}
        return table.remarks, {label: cells for label, cells in lines.items() if label != "Useless"}

    for name in ("effective", "uncoupled"):
        (remarks, lines), (alone, lines_alone) = numbers(name, [*sound, useless]), numbers(name, sound)
        assert lines == lines_alone
        assert remarks[:-1] == alone
        assert "Useless" in remarks[-1]
    assert " 5 " in numbers("uncoupled", [*sound, useless])[0][1]

    figures = figures_of([*sound, useless], published=False)
    for name in ("effective_trend", "relations", "clean_against_cre"):
        assert {mark.model for marks in figures[name].marks.values() for mark in marks} == set(models), name
    content = whole_content([*sound, useless], published=False)
    (group,) = page_figures(content)
    trend = next(one for one in group.figures if one.title == "Effective robustness")
    assert {line.label for line in trend.numbers.lines} == set(models)
    assert "Useless" in trend.caption
    assert [key.model for key, _ in sorted(content.lines.items(), key=by_error)][-1] == "Useless"


def test_coverage_is_a_column_where_a_model_left_out_pixels(runs):
    assert "Coverage" not in _average(runs[0], published=True)[0]
    half = runs[0].rows.with_columns(
        n_valid=pl.when(corruption="contrast").then(pl.col("n_valid") // 2).otherwise("n_valid")
    )
    with_gaps = made_run(runs[0], half, "DIS")
    cells, _ = _average(with_gaps, published=True)
    assert cells["Coverage"] == f"{with_gaps.mean('coverage'):.2f}" == "0.75"
    (board,) = whole_content([with_gaps], published=False).boards
    assert dict(zip((c.label for c in board.columns), board.lines[0].cells, strict=True))["Coverage"].text == "0.75"
    for name in ("means", "uncoupled", "cost", "row"):
        (table,) = tables_of([with_gaps], published=False, wanted=[name])
        assert "75.0 %" in table.lines[0].note, name


def test_cre_of_a_run_with_gaps_is_the_same_in_tables_and_figures(runs, monkeypatch):
    """Under contrast, the prediction lacks three quarters of the pixels, which have most of the error: the EPE is below
    the clean EPE although the error grew at every pixel that was predicted.
    """
    monkeypatch.setattr("robustflow.stats.exclusion.COVERED_FROM", 0.0)  # figures do not show models without a rank

    def with_gaps(number):
        sums = {name: pl.col(name) / 16 for name in ("epe_sum", "clean_epe_sum", "rcre_sum")}
        some = {"n_valid": pl.col("n_valid") // 4, **{name: value * (1 + number / 10) for name, value in sums.items()}}
        left_out = {name: pl.when(corruption="contrast").then(value).otherwise(name) for name, value in some.items()}
        return made_run(runs[0], runs[0].rows.with_columns(**left_out), f"M{number}")

    measured = [with_gaps(number) for number in range(1, 6)]
    figures = figures_of(measured, published=False)
    for run in measured:
        assert run.epe < run.epe_clean
        assert run.cre > 0
        for name, values in (
            ("clean_against_cre", {"CRE": f"{run.cre:.2f} px", "CREr": f"{run.crer:.2f}"}),
            ("relations", {"CRE": f"{run.cre:.2f} px"}),
            ("crer_by_family", {"class": "Digital", "CREr": f"{run.mean('crer', 'digital'):.2f}"}),
        ):
            marks = (dict(mark.values) for marks in figures[name].marks.values() for mark in marks if mark.values)
            assert any(values.items() <= shown.items() for shown in marks), name


@pytest.mark.parametrize(("epe", "setting", "doubted"), [(0.9, "OOD", True), (1.0, "OOD", False), (0.9, "ID", False)])
def test_clean_epe_far_below_every_published_ood_result_is_remarked(runs, monkeypatch, epe, setting, doubted):
    """On fewer pairs than the paper's, the limit is a quarter of the lowest published one."""
    chosen = {"benchmark": "kitti-fc", "setting": "OOD", "measure": "epe", "condition": "clean"}
    assert published_frame().filter(**chosen)["value"].min() == benchmark_facts("kitti-fc").lowest_ood_clean_epe == 3.78
    run = made_run(runs[0], runs[0].rows, benchmark="kitti-fc")
    monkeypatch.setattr(type(run), "epe_clean", epe)
    monkeypatch.setattr(type(run), "setting", setting)
    assert ("3.78 px" in comparison_note(run)) == doubted


def test_notes_differ_where_what_was_measured_differs(runs):
    assert [run.setting for run in runs] == ["knowledge", "UNKNOWN", "ID"]
    (note,) = {comparison_note(run) for run in runs}
    calibrated = made_run(runs[0], runs[0].rows, severity_scale="calibrated 00")
    without_hardest = (pl.col("corruption") != "contrast") | (pl.col("severity") != 3)
    part = made_run(runs[0], runs[0].rows.filter(without_hardest))
    longer = [comparison_note(calibrated), comparison_note(part)]
    assert all(one.startswith(note) and len(one) > len(note) for one in longer)
    assert longer[0] != longer[1]


@pytest.mark.parametrize(
    ("model", "name"),
    [({"spec": " ", "name": "\t", "object": "a.B"}, "a.B"), ({"name": " A "}, "A"), ({"name": ""}, "(no name)")],
)
def test_blank_name_is_replaced_by_the_next_candidate(runs, model, name):
    run = Run(runs[1].path)
    change_identity(run, model)
    assert run.name == name


def test_published_rows_keep_their_marks_beside_runs(runs):
    alone = {table.name: table for table in tables_of([], published=True)}
    tables = {table.name: table for table in tables_of(runs, published=True)}
    for name in ("epe", "cre", "rcre"):
        lines = {(s.title, line.label): line.cells for s in tables[name].sections for line in s.lines if not line.note}
        assert lines == {(s.title, line.label): line.cells for s in alone[name].sections for line in s.lines}
    labels = [line.label for s in tables["epe"].sections for line in s.lines if line.note]
    assert labels == ["DIS", "Trained", "<img src=x onerror=alert(1)>"]


def test_every_table_is_rendered_in_every_format(runs):
    tables = tables_of(runs, published=True)
    assert {table.name for table in tables} == set(TABLES) - {
        "attacks",
        "security",
        "corruptions-and-attacks",
        ROW,
    }
    for format in FORMATS:
        texts = [render(table, format) for table in tables]
        assert format in ("terminal", "csv") or not any("<img" in text for text in texts)


def test_tables_and_figures_without_published_rows_show_runs_only(runs):
    names = {table.name for table in tables_of(runs, published=False)}
    assert {"epe", "cre", "rcre", "cost", "means"} <= names
    for call, culprit in (
        (partial(tables_of, runs, published=False, wanted=["gopro-rcre"]), "--table"),
        (partial(tables_of, [], published=True, wanted=["uncoupled"]), "--table"),
        (partial(tables_of, runs, published=True, wanted=["uncoupled"]), "--published"),
        (partial(tables_of, runs, published=True, wanted=["meanss"]), "meanss"),
    ):
        refusal(call, UsageError, culprit)
    figures = figures_of(runs, published=False)
    assert {"severity_rcre", "severity_epe"} <= set(figures)


def test_run_on_real_pairs_is_shown_beside_the_published_rows(shared, tmp_path):
    """A run on KITTI pairs outside the paper's selection is listed in the table, marked, and not compared with its
    rows.
    """
    options = {"corruptions": ["contrast"], "severities": [1], "limit": 2}
    run = evaluate("farneback", "kitti-fc", shared("data/kitti2015"), tmp_path, **options)
    _, lines = _table([run], published=True)
    (own,) = (line for line in lines if line.note)
    assert own.label == "Farneback"
    assert " 80" in own.note
    assert len(lines) == 29 + 1


def test_pairs_outside_of_a_benchmark_are_counted_in_page_latex_note_and_record(runs):
    ours = kitti_split(KITTI_KEYS).evaluation
    strange = next(key for key in KITTI_KEYS if key not in ours)
    rows = runs[0].rows
    names = dict(zip(rows["sample"].unique(maintain_order=True), (strange, *ours), strict=False))
    run = made_run(runs[0], rows.with_columns(sample=pl.col("sample").replace(names)), benchmark="kitti-fc")
    remark = f"1 of {len(names)} not of KITTI-FC"
    assert remark in comparison_note(run)
    assert remark in str(run)  # the sentence of a record
    assert remark in render(tables_of([run], published=False)[0], "latex")
    assert remark in render_site(whole_content([run]))
    for protocol, keys, text in (
        ({}, ours, ""),
        ({"frames": "released"}, [strange], ""),
        ({}, [*ours, strange], "1 of"),
    ):
        assert outside_remark("kitti-fc", protocol, keys).startswith(text)
        assert bool(outside_remark("kitti-fc", protocol, keys)) is bool(text)
    assert outside_remark("gopro-fc", {}, ["GOPR0374_11_02/000001", "mine/000001"]) == "1 of 2 not of GoPro-FC"
