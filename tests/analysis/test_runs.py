"""Runs listed next to published results have the right values, names, settings and marks."""

from __future__ import annotations

import shutil

import numpy as np
import polars as pl
import pytest

from robustflow.analysis.model_result import by_frames, ranked
from robustflow.analysis.run_names import run_names
from robustflow.analysis.run_results import comparison_note, run_results, run_setting
from robustflow.api import Result, evaluate
from robustflow.corruptions.registry import IMAGE_PAIR, PAPER_ORDER
from robustflow.errors import UsageError
from robustflow.images.io import write_image
from robustflow.report.assemble import ALL_TABLES, ATTACK_TABLES, FLAT_AND_DEPTH, figures_of, results_of, tables_of
from robustflow.report.leaderboard import by_error
from robustflow.report.render import FORMATS, render
from robustflow.report.site.content import whole_content
from robustflow.report.site.figures import page_figures
from robustflow.runs.comparable import sample_set
from robustflow.runs.manifest import Selection
from robustflow.runs.provenance import Provenance
from robustflow.runs.shards import list_shards, write_shard
from robustflow.runs.store import RunFolder
from robustflow.testing import ZeroFlow
from tests.made_rows import change_identity, change_manifest


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


def test_other_severities_and_other_data_of_the_same_names_are_other_sample_sets(tmp_path):
    options = {"corruptions": ["contrast"], "severities": [1]}
    for folder, grey in (("a", 40), ("b", 60)):
        (tmp_path / folder).mkdir()
        for index in range(2):
            write_image(tmp_path / folder / f"{index}.png", np.full((24, 24, 3), grey + 20 * index, np.uint8))

    def run(data, name, **more):
        return evaluate(Still(), "folder", tmp_path / data, tmp_path / name, **options, **more)

    first, again = run("a", "first"), run("a", "again")
    assert sample_set(first) == sample_set(again)
    assert sample_set(run("b", "other")) != sample_set(first)
    calibrated = run("a", "calibrated", severity_scale="calibrated")
    assert sample_set(calibrated) != sample_set(first)
    assert "calibrated severities" in comparison_note(calibrated)
    assert "calibrated" not in comparison_note(first)


def test_values_are_those_of_the_summary(runs):
    for run, line in zip(runs, run_results(runs), strict=True):
        found = {key: value.number for key, value in line.values.items()}
        assert found["epe", "clean"] == run.summary.epe_clean
        assert found["cre", "average"] == run.summary.cre
        assert found["rcre", "contrast"] == run.summary.corruptions["contrast"].rcre
        assert len(found) == 1 + 4 * 3


def _with_rows(run, rows, tmp_path):
    out = Result(shutil.copytree(run.path, tmp_path / "made", dirs_exist_ok=True))
    (out.path / "summary.json").unlink(missing_ok=True)
    out.rows = rows
    names = tuple(sorted(set(rows["corruption"]) - {"clean"}))
    change_manifest(out, selection=Selection(corruptions=names, severities=(1, 3)))
    return out


def _average(run, published):
    (table,) = tables_of([run], published=published, wanted=["epe"])
    line = next(line for section in table.sections for line in section.lines if line.label == "DIS" and line.note)
    labels = [column.label for column in table.columns]
    return dict(zip(labels, (cell.text for cell in line.cells), strict=True)), line.note


def test_beside_published_rows_an_average_is_the_papers_where_all_of_its_corruptions_were_run(runs, tmp_path):
    """All corruptions of the paper have the same error; one outside the paper has a hundred times that error."""
    base = runs[0].rows.filter(pl.col("corruption").is_in(["clean", "contrast"]))
    one = base.filter(pl.col("corruption") == "contrast")
    others = [one.with_columns(corruption=pl.lit(name)) for name in PAPER_ORDER if name in IMAGE_PAIR]
    far = one.with_columns(corruption=pl.lit("elastic_transform"), epe_sum=100 * pl.col("epe_sum"))
    mean = runs[0].summary.corruptions["contrast"].epe
    whole = _with_rows(runs[0], pl.concat([base.filter(corruption="clean"), *others, far]), tmp_path)
    cells, note = _average(whole, published=True)
    assert cells["AVG EPE"] == f"{mean:.2f}"
    assert cells["Elastic transform"] == f"{100 * mean:.2f}"
    assert "average over the paper's 20 of 21 corruptions" in note
    cells, note = _average(whole, published=False)
    assert cells["AVG EPE"] == f"{120 * mean / 21:.2f}"
    assert "average over 21 corruptions" in note
    part = _with_rows(runs[0], pl.concat([base, far]), tmp_path / "part")
    for published in (True, False):
        cells, note = _average(part, published)
        assert cells["AVG EPE"] == f"{101 * mean / 2:.2f}"
        assert "average over contrast and elastic transform" in note
    content = whole_content([whole])
    line = next(line for line in content.lines if line.name == "DIS" and line.note)
    assert content.cells[line]["epe", "average"].text == f"{mean:.2f}"


def test_an_excluded_model_is_the_best_of_nothing_and_a_footnote_says_why(runs, tmp_path):
    """A model with the lowest errors under corruption that is no better than zero flow on clean frames."""

    def made(name, rows):
        return _made(runs[0], name, rows, tmp_path)

    rows = runs[0].rows
    low = rows.with_columns(epe_sum=pl.col("epe_sum") / 100, clean_epe_sum=pl.col("clean_epe_sum") / 100)
    others = [made("Good", rows), made("Bad", rows.with_columns(epe_sum=2 * pl.col("epe_sum")))]
    assert _marked([made("Lucky", low), *others])["Lucky"][0] > 0, "it would be the best if it were ranked"
    useless = made("Useless", low.with_columns(magnitude_sum=pl.col("n_valid") * 0.001))
    best = _marked([useless, *others])
    assert best["Useless"][0] == 0
    assert "not ranked: its clean EPE of 0.03 px is at least half of the 0.00 px of zero flow" in best["Useless"][1]
    assert best["Good"][0] > 0
    assert {line.name for line in ranked(run_results([useless, *others]))} == {"Good", "Bad"}
    content = whole_content([useless, *others], published=False)
    lines = {line.name: line for line in content.lines}
    assert not any(cell.best for cell in content.cells[lines["Useless"]].values())
    assert content.cells[lines["Good"]]["epe", "average"].best
    assert "zero flow" in lines["Useless"].excluded


def _made(base, name, rows, tmp_path):
    run = _with_rows(base, rows, tmp_path / name)
    change_manifest(run, selection=base.manifest.selection)
    change_identity(run, {"name": name})
    run.__dict__["provenance"] = Provenance(setting="OOD", trained_on=(), basis="declared")
    return run


def test_excluded_runs_are_in_no_trend_correlation_or_figure_and_a_remark_names_them(runs, tmp_path):
    """Five models of different accuracy, and a nearly blind one whose errors would distort every fitted line."""
    rows = runs[0].rows

    def scaled(clean, ratio):
        factor = pl.when(pl.col("corruption") == "clean").then(clean).otherwise(clean * ratio)
        return rows.with_columns(epe_sum=pl.col("epe_sum") * factor, clean_epe_sum=pl.col("clean_epe_sum") * clean)

    models = {"A": (1.0, 1.0), "B": (1.2, 0.9), "C": (1.5, 1.3), "D": (2.0, 1.1), "E": (3.0, 1.2)}
    sound = [_made(runs[0], name, scaled(*factors), tmp_path) for name, factors in models.items()]
    useless = _made(runs[0], "Useless", scaled(9.0, 0.8), tmp_path)

    def numbers(name, of):
        (table,) = tables_of(of, published=False, wanted=[name])
        lines = {line.label: [cell.text for cell in line.cells] for each in table.sections for line in each.lines}
        return table.remarks, {label: cells for label, cells in lines.items() if label != "Useless"}

    for name in ("effective", "uncoupled", "observations"):
        (remarks, lines), (alone, lines_alone) = numbers(name, [*sound, useless]), numbers(name, sound)
        assert lines == lines_alone
        assert remarks[:-1] == alone
        assert remarks[-1].startswith("Left out of trends and correlations: Useless, because its clean EPE of 23.7")
    assert "Over 5 models" in numbers("uncoupled", [*sound, useless])[0][1]

    figures = figures_of([*sound, useless], published=False)
    for name in ("effective_trend_0", "relations_0", "clean_against_cre_0"):
        assert {mark.model for marks in figures[name].marks.values() for mark in marks} == set(models), name
    content = whole_content([*sound, useless], published=False)
    (group,) = page_figures(content)
    trend = next(one for one in group.figures if one.title == "Effective robustness")
    assert {label for label, _ in trend.lines} == set(models)
    assert "Not drawn because not ranked: Useless." in trend.caption
    assert [line.name for line in sorted(content.lines, key=by_error)][-1] == "Useless"


def _marked(runs):
    (table,) = tables_of(runs, published=False, wanted=["epe"])
    return {
        line.label: (sum(cell.best for cell in line.cells), line.note)
        for section in table.sections
        for line in section.lines
    }


def test_coverage_is_a_column_where_a_model_left_out_pixels(runs, tmp_path):
    assert "Coverage" not in _average(runs[0], published=True)[0]
    half = runs[0].rows.with_columns(
        n_valid=pl.when(corruption="contrast").then(pl.col("n_valid") // 2).otherwise("n_valid")
    )
    gaps = _with_rows(runs[0], half, tmp_path)
    cells, _ = _average(gaps, published=True)
    assert cells["Coverage"] == f"{gaps.summary.coverage:.2f}" == "0.75"
    (cells_of_line,) = whole_content([gaps], published=False).cells.values()
    assert cells_of_line["coverage", ""].text == "0.75"


def test_settings_and_notes(runs):
    assert [run_setting(run) for run in runs] == ["knowledge", "own", "ID"]
    for run in runs:
        note = comparison_note(run)
        assert note == "1 pair of the demo; average over JPEG compression and contrast; severities 1 and 3 only"


def test_runs_over_the_same_frames_are_one_sample_set(runs, tmp_path):
    assert len({sample_set(run) for run in runs}) == 1
    other = evaluate(Still(), "demo", output=tmp_path / "o", corruptions=["contrast"], severities=[1], seed=5)
    assert sample_set(other) not in {sample_set(run) for run in runs}


def test_what_is_averaged_over_less_is_not_a_rival(runs, tmp_path):
    """The plan is the same, but the hardest conditions are missing, so the averages are not comparable."""
    folder = RunFolder(shutil.copytree(runs[0].path, tmp_path / "part"))
    rows = folder.rows()
    for shard in list_shards(folder.rows_folder):
        shard.unlink()
    hardest = (pl.col("corruption") == "contrast") & (pl.col("severity") == 3)
    write_shard(folder.rows_folder, "pack", rows.filter(~hardest))
    part = Result(folder.path)
    assert part.rows.height < runs[0].rows.height
    assert sample_set(part) != sample_set(runs[0])
    assert "not complete" in comparison_note(part)


def test_runs_of_one_name_alike_in_everything_are_named_by_digest_and_number(runs, tmp_path):
    copy = Result(shutil.copytree(runs[1].path, tmp_path / "copy"))
    digest = runs[1].manifest.identity_digest[:8]
    assert run_names([runs[1], copy]) == [f"{runs[1].name} ({digest})", f"{runs[1].name} ({digest}) #2"]


def test_runs_that_differ_in_their_files_alone_are_named_by_these(runs, tmp_path):
    copies = [Result(shutil.copytree(runs[0].path, tmp_path / name)) for name in ("one", "other")]
    change_manifest(copies[1], file_digests=dict.fromkeys(copies[1].manifest.samples, ("0" * 16,) * 3))
    names = run_names(copies)
    assert all(name.startswith("DIS (files ") for name in names)
    assert len(set(names)) == 2


def _changed(run, folder, **identity):
    """A copy of a run with a different identity; `model` updates the model's settings in it."""
    copy = Result(shutil.copytree(run.path, folder))
    model = {**copy.manifest.identity.model.settings, **identity.pop("model", {})}
    change_identity(copy, model, **identity)
    return copy


def test_runs_of_one_name_are_named_by_what_differs(runs, tmp_path):
    fast = _changed(runs[0], tmp_path / "fast", model={"preset": "fast"})
    assert run_names([runs[0], fast]) == ["DIS (preset medium)", "DIS (preset fast)"]
    again = _changed(runs[0], tmp_path / "again", model={"preset": "fast"}, seed=1)
    assert run_names([runs[0], fast, again]) == [
        "DIS (preset medium, seed 0)",
        "DIS (preset fast, seed 0)",
        "DIS (preset fast, seed 1)",
    ]
    weights = [_changed(runs[0], tmp_path / letter, model={"checkpoint": letter * 64}) for letter in "ab"]
    assert run_names(weights) == ["DIS (checkpoint aaaaaaaa)", "DIS (checkpoint bbbbbbbb)"]
    few = _changed(runs[0], tmp_path / "few")
    change_manifest(few, selection=Selection(corruptions=("contrast",), severities=(1, 3)))
    assert run_names([runs[0], few]) == ["DIS (contrast+jpeg_compression)", "DIS (contrast)"]


def test_one_model_on_several_benchmarks_is_named_by_them(runs, tmp_path):
    other = _changed(runs[1], tmp_path / "other", benchmark="kitti-fc")
    name = runs[1].name
    assert run_names([runs[0], runs[1], other]) == ["DIS", f"{name} (demo)", f"{name} (KITTI-FC)"]


def test_models_of_one_name_are_told_apart_where_their_benchmarks_differ_too(runs, tmp_path):
    other = _changed(runs[0], tmp_path / "other", model={"preset": "fast"}, benchmark="kitti-fc")
    assert run_names([runs[0], other]) == ["DIS (demo, preset medium)", "DIS (KITTI-FC, preset fast)"]


def test_a_blank_name_gives_way_to_the_next(runs, tmp_path):
    run = Result(shutil.copytree(runs[1].path, tmp_path / "copy"))
    for model, name in (
        ({"spec": " ", "name": "\t", "object": "a.B"}, "a.B"),
        ({"name": " A "}, "A"),
        ({"name": ""}, "(no name)"),
    ):
        change_identity(run, model)
        assert run.name == name


def test_published_rows_keep_their_marks_beside_runs(runs):
    alone = {table.name: table for table in tables_of([], published=True)}
    beside = {table.name: table for table in tables_of(runs, published=True)}
    for name in ("epe", "cre", "rcre"):
        lines = {(s.title, line.label): line.cells for s in beside[name].sections for line in s.lines if not line.note}
        assert lines == {(s.title, line.label): line.cells for s in alone[name].sections for line in s.lines}
    noted = [line.label for s in beside["epe"].sections for line in s.lines if line.note]
    assert noted == ["DIS", "Trained", "<img src=x onerror=alert(1)>"]


@pytest.mark.parametrize("format", FORMATS)
def test_every_table_in_every_format(runs, format):
    tables = tables_of(runs, published=True)
    assert {table.name for table in tables} == set(ALL_TABLES) - {*ATTACK_TABLES, FLAT_AND_DEPTH}
    for table in tables:
        text = render(table, format)
        assert "<img" not in text or format in ("terminal", "csv")


def test_runs_alone(runs):
    names = {table.name for table in tables_of(runs, published=False)}
    assert {"epe", "cre", "rcre", "cost", "means", "anatomy"} <= names
    with pytest.raises(UsageError, match="gopro"):
        tables_of(runs, published=False, wanted=["gopro-rcre"])
    with pytest.raises(UsageError, match="give at least one"):
        tables_of([], published=True, wanted=["means"])
    with pytest.raises(UsageError, match="did you mean 'means'"):
        tables_of(runs, published=True, wanted=["meanss"])
    figures = figures_of(runs, published=False)
    assert {"severity_rcre", "severity_epe"} <= set(figures)


def test_results_of_both(runs):
    both = by_frames(results_of(runs, published=True))
    assert set(both) == {"paper", sample_set(runs[0])}
    assert [value.decimals for line in both[sample_set(runs[0])] for value in line.values.values()] == [None] * 3 * 13


def test_real_pairs_beside_the_published_rows(shared, tmp_path):
    """A run on KITTI pairs outside the paper's selection is listed in the table, marked, and not compared with its
    rows.
    """
    data = shared("data/kitti2015")
    options = {"corruptions": ["contrast", "low_light"], "severities": [1, 5], "limit": 2}
    found = [
        evaluate(m, "kitti-fc", data, tmp_path / str(i), **options) for i, m in enumerate(["dis", "farneback", Still()])
    ]
    pairs = found[0].summary.samples
    table = tables_of(found, published=True, wanted=["epe"])[0]
    own = [line for section in table.sections for line in section.lines if line.note]
    assert [line.label for line in own] == ["DIS", "Farneback", "<img src=x onerror=alert(1)>"]
    assert all(f"{pairs} pair{'s' if pairs > 1 else ''}, not the paper's 80" in line.note for line in own)
    assert sum(len(section.lines) for section in table.sections) == 29 + 3
