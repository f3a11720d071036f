"""Conclusions about a user's own frames state the run's numbers and the evidence, and never favour a model that
ignores its frames.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from skimage import data

from robustflow.api import Result, evaluate
from robustflow.cli.main import main
from robustflow.media.images import write_image
from robustflow.metrics.rows import ROW_SCHEMA
from robustflow.report.assemble import tables_of
from robustflow.report.site.content import run_content, whole_content
from robustflow.report.site.headline import headline
from robustflow.report.site.page import render_site
from robustflow.run.run import Run
from robustflow.stats.conclusion import CAVEAT, conclusions, without_truth
from robustflow.stats.run_results import comparison_note, run_results
from robustflow.testing import ConstantFlow
from tests.made_rows import made_run

from .simulated import Truth, rows_of

OPTIONS = {"corruptions": ["contrast", "gaussian_noise"], "severities": [1, 3], "examples": False}
WITHOUT_TRUTH = ("n_all", "n_invalid", "rcre_all_sum", "pred_magnitude_sum", "height", "width", "severity")


@pytest.fixture(scope="module")
def frames(tmp_path_factory) -> Path:
    """Four frames of a moving image, which form three pairs from one sequence."""
    folder = tmp_path_factory.mktemp("frames")
    for index in range(4):
        write_image(folder / f"{index}.png", data.astronaut()[60:156, 60 + 3 * index : 188 + 3 * index].copy())
    return folder


@pytest.fixture(scope="module")
def runs(frames, tmp_path_factory) -> list[Result]:
    """Runs of two real models and of a model that ignores its frames, all on the same frames."""
    folder = tmp_path_factory.mktemp("runs")
    models = {"dis": "dis", "dis_rgb": "dis_rgb", "blind": ConstantFlow(1, 1)}
    return [evaluate(model, "folder", frames, folder / name, **OPTIONS) for name, model in models.items()]


def _scenes(run: Result, worse: float) -> Run:
    """A copy of the run with synthetic rows from 40 independent scenes, without ground truth."""
    clean, corrupted = Truth().draw(np.random.default_rng(0), np.ones(40, int))
    moved = corrupted * worse
    rows = rows_of(clean, moved, moved)
    gone = [name for name, dtype in ROW_SCHEMA.items() if dtype in (pl.Int64, pl.Float64) and name not in WITHOUT_TRUTH]
    without = rows.with_columns(pl.lit(None, ROW_SCHEMA[name]).alias(name) for name in gone)
    return made_run(run, without, run.manifest.identity.model.settings)


def test_conclusion_about_models_with_equally_shortened_names_compares_them(runs):
    lines = [replace(line, name=f"{'m' * 90}{index}") for index, line in enumerate(run_results(runs[:2]))]
    (text,) = conclusions(lines)
    assert "changes least on average" in text


def test_one_run_says_what_changes_its_flow_most_and_least(runs):
    dis = runs[0]
    assert without_truth(dis)
    (text,) = conclusions(run_results([dis]))
    values = {name: dis.mean("rcre", name) for name in dis.measured.corruptions}
    order = (
        ["Gaussian noise", "Contrast"] if values["gaussian_noise"] > values["contrast"] else ["Contrast", "Gaussian"]
    )
    clean = dis.rows.filter(corruption="clean")
    length = (clean["pred_magnitude_sum"] / clean["n_all"]).mean()
    assert f"on clean frames the flow is {length:.2f} px long on average, " in text
    still = (clean["photometric_still_sum"] / clean["n_photometric"]).mean()
    assert f"(zero flow: {still:.2f})" in text
    assert f"clean flow {length:.4g} px long" in str(dis)
    assert text.startswith(f"On 3 pairs in 1 sequence, corruption changes the flow of DIS by {dis.rcre:.2f} px")
    assert f"most under {order[0]} ({max(values.values()):.2f} px)" in text
    assert f"least under {order[1]}" in text
    assert "1 sequence is too few" in text
    assert "at least 3 more from different scenes are needed" in text
    assert text.endswith(CAVEAT)


def test_several_runs_say_which_changes_least(runs):
    dis, rgb, _ = runs
    (text,) = conclusions(run_results([dis, rgb]))
    first = min((dis, rgb), key=lambda run: run.rcre)
    assert f"{first.name} changes least on average (RCRE {first.rcre:.2f} px for a clean flow of" in text
    assert text.endswith(CAVEAT)


def test_model_that_ignores_the_frames_is_not_named_as_changing_least(runs):
    (text,) = conclusions(run_results(runs))
    assert runs[2].rcre == 0
    assert f"{runs[2].name} changes least" not in text
    assert "No conclusion about" in text
    assert "its flow hardly depends on the frames" in text
    (alone,) = conclusions(run_results([runs[2]]))
    assert alone.startswith("No conclusion about")


def test_enough_scenes_give_an_interval_and_a_verdict(runs):
    calm, shaky = _scenes(runs[0], 1.0), _scenes(runs[1], 1.5)
    (text,) = conclusions(run_results([calm]))
    assert "On 40 pairs, " in text
    assert "95 % interval" in text
    assert "more pairs from different scenes" in text
    (text,) = conclusions(run_results([calm, shaky]))
    assert "the difference between DIS and DIS-RGB is significant (p < 0.001)" in text
    (text,) = conclusions(run_results([calm, _scenes(runs[1], 1.0)]))
    assert "is significant" not in text


def test_runs_without_ground_truth_are_not_compared_with_the_paper(runs):
    for run in runs:
        note = comparison_note(run)
        assert note.startswith("3 pairs of your own frames; average over contrast and gaussian noise")
        assert "paper" not in note
    for table in tables_of(runs, published=False):
        assert not any("paper" in line.note for section in table.sections for line in section.lines)
    assert "the paper's 80" not in render_site(whole_content(runs, published=False))


def test_pages_tables_and_the_terminal_conclude(runs, frames, tmp_path, monkeypatch, capsys):
    (text,) = conclusions(run_results(runs[:2]))
    assert headline(whole_content(runs[:2], published=False)) == [text]
    assert headline(run_content(runs[0])) == conclusions(run_results(runs[:1]))
    for wanted in (None, ["rcre"], ["means"]):
        tables = tables_of(runs[:2], published=False, wanted=wanted)
        assert all(column.label != "clean EPE (px)" for table in tables for column in table.columns)
        assert [table.remarks[-1:] == (text,) for table in tables].count(True) == 1
    command = ["run", "-m", "dis", "-b", "folder", "-d", str(frames), "-c", "contrast", "-s", "1", "--no-examples"]
    monkeypatch.setattr(sys, "argv", ["robustflow", *command, "-o", str(tmp_path / "run")])
    with pytest.raises(SystemExit):
        main()
    assert CAVEAT in capsys.readouterr().out


def test_run_with_ground_truth_has_no_conclusion_about_rcre(runs):
    errors = np.ones((4, 3))
    run = made_run(runs[0], rows_of(np.ones(4), 1 + errors, errors))
    assert not without_truth(run)
    assert conclusions(run_results([run])) == []
