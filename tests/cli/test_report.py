"""Test the commands `report`, with the pictures that it draws, `reproduce audit` and `compare`."""

import csv
import io
import json
import shutil
from pathlib import Path

import pytest
import skimage
from PIL import Image

from robustflow.api import Result, evaluate, load_run
from robustflow.core.errors import RunError, UsageError
from robustflow.media.images import read_image, write_image
from robustflow.models import ModelRef
from robustflow.report.comparison import compare
from robustflow.report.render import render

from .conftest import WHOLE_DEMO, two_runs, write_frames


@pytest.fixture(scope="module")
def runs(tmp_path_factory) -> list[Path]:
    """Runs on the whole pair, because only there Farneback's error is too high for it to be ranked."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(skimage, "__file__", WHOLE_DEMO)
        return two_runs(tmp_path_factory.mktemp("whole"))


def test_report_shows_a_run_beside_the_published_rows(robustflow, runs):
    out = robustflow.prints("report", *runs, "--published", "--table", "epe,means", "--format", "csv")
    first, _, second = out.partition("\nsection,")
    lines = list(csv.DictReader(io.StringIO(first)))
    assert [line["model"] for line in lines if line["note"]] == ["DIS", "Farneback"]
    assert len(lines) == 31
    labels = [line.split(",")[:2] for line in second.splitlines()[1:]]
    assert [model for section, model in labels if section == "Runs"] == ["DIS", "Farneback"]
    assert second.count("\n") == 3 + 40


def test_table_row_prints_one_latex_line_per_run(robustflow, runs):
    out = robustflow.prints("report", *runs, "--table", "row")
    lines = out.splitlines()
    assert len(lines) == 2
    for line, path, name in zip(lines, runs, ("DIS", "Farneback"), strict=True):
        run = load_run(path)
        numbers = [getattr(run, metric) for metric in ("epe_clean", "epe", "cre", "rcre", "crer")]
        cells, _, comment = line.partition(r" \\ % ")
        assert cells == " & ".join([name, *(f"{number:.2f}" for number in numbers)])
        assert comment.startswith("clean EPE (px), EPE (px), CRE (px), RCRE (px), CREr; 1 pair of the demo")
    assert "not ranked" in lines[1]
    assert robustflow("report", *runs, "--table", "row", "-f", "latex")[1] == out


def test_effective_robustness_of_two_runs_is_only_that_of_the_published_results(robustflow, runs):
    """Two runs are too few for a trend."""
    whole = robustflow.prints("report", *runs, "--published", "-f", "markdown")
    headings = [line for line in whole.splitlines() if line.startswith("### Effective")]
    assert headings == ["### Effective robustness: published models"]


def test_the_observations_are_printed(robustflow):
    printed = robustflow.prints("reproduce", "observations")
    assert all(words in printed for words in ("As printed", "Generalises", "false: exceptions 3; models 29"))


def test_figures_of_one_ranked_run_need_no_trend_and_no_published_results(robustflow, runs):
    """Farneback is excluded, so only DIS remains. Figures that need the paper's results, a trend, or more than one
    class are not drawn.
    """
    command = ("report", *runs, "-t", "means", "-f", "latex", "-o", "means.tex", "--figures", "figures")
    assert robustflow.prints(*command).split()[0] == "means.tex"
    assert r"\toprule" in Path("means.tex").read_text()
    assert {path.suffix for path in Path("figures").iterdir()} == {".png", ".svg", ".pdf"}
    drawn = {path.stem for path in Path("figures").glob("*.svg")}
    assert drawn == {"clean_against_cre", "severity_rcre", "severity_epe"}
    robustflow.refuses("report", *runs, "-t", "effective")


def test_a_folder_of_runs_is_reported_like_its_runs(robustflow, runs, tmp_path):
    of_folder = robustflow.prints("report", runs[0].parent, "--table", "means")
    assert of_folder == robustflow.prints("report", *runs, "--table", "means")
    (tmp_path / "empty").mkdir()
    robustflow.refuses("report", "empty", code=1)


@pytest.mark.parametrize(
    "options",
    [
        {"severities": [3]},  # every corruption
        {"corruptions": ["contrast", "fog"], "attacks": ["square:queries=2"], "severities": [1, 3]},
        {"corruptions": ["contrast", "fog"], "severities": [1, 5], "confidence": "forward-backward"},
    ],
)
def test_report_of_a_run_is_at_most_forty_lines(robustflow, options):
    model = "tiny" if "attacks" in options else "farneback"
    evaluate(model, output="run", **options)
    out = robustflow.prints("report", "run")
    assert 5 < out.count("\n") <= 40
    assert "clean EPE" in out
    assert ("Attacks" in out) == ("attacks" in options)
    assert ("Confidence" in out) == ("confidence" in options)


def test_several_runs_are_printed_a_line_each_and_in_every_table_on_request(robustflow, runs):
    out = robustflow.prints("report", *runs)
    assert out.count("\n") <= 40
    assert out == robustflow.prints("report", runs[0].parent)
    tables = robustflow.prints("report", *runs, "--table", "all")
    assert tables.count("\n") > 40
    assert [run["name"] for run in json.loads(robustflow.prints("report", *runs, "--json"))] == ["DIS", "Farneback"]


def test_audit_of_the_published_tables_prints_the_findings(robustflow):
    code, out, _ = robustflow("reproduce", "audit")
    assert code == 3
    assert any({"BrightFlow", "UPFlow"} <= set(line.split()) for line in out.splitlines())
    code, text, _ = robustflow("reproduce", "audit", "--json")
    assert code == 3
    found = json.loads(text)
    assert out.count("\n  ") == len(found["findings"])
    assert {"given", "recomputed", "tolerance", "source", "message"} <= found["findings"][0].keys()


def test_audit_of_own_results_finds_inconsistent_rows(robustflow):
    path = Path("mine.csv")
    head = "setting,model,metric,corruption,value\nOOD,A,epe,clean,2.00\n"
    path.write_text(head)
    assert "nothing was checked" in robustflow.prints("reproduce", "audit", path)
    head += "OOD,A,epe,fog,3.00\n"
    path.write_text(head + "OOD,A,cre,fog,1.01\n")
    robustflow.prints("reproduce", "audit", path)
    path.write_text((head + "OOD,A,cre,fog,1.02\n").replace(",A,", ",A\x1b[31m,"))
    code, out, _ = robustflow("reproduce", "audit", path)
    assert code == 3
    (finding,) = (line for line in out.splitlines() if line.startswith("  "))
    assert {"1.02", "1.00"} <= set(finding.replace(",", "").split())
    assert "\n  OOD A" in out  # without a source, none is mentioned
    assert "\x1b" not in out


def test_compare_prints_one_table_of_two_runs_and_a_row_a_pair_of_three(robustflow, runs):
    out = robustflow.prints("compare", *runs, "--metric", "cre")
    assert {f"{Result(run).cre:.2f}" for run in runs} <= set(out.split())
    assert len(json.loads(robustflow.prints("compare", *runs, runs[0], "--json"))) == 3


def test_comparison_is_written_in_a_format_for_papers(robustflow, runs):
    assert robustflow.prints("compare", *runs, "--format", "latex", "-o", "two.tex") == "two.tex\n"
    assert Path("two.tex").read_text() == render(compare(*map(Result, runs)).table(), "latex")


def test_power_of_rows_without_variance_is_refused_in_one_line(robustflow, runs):
    robustflow.refuses("compare", *runs, "--effect", 0.1, code=1)  # a single pair
    for wrong in (("--effect", 0), ("--power", 0.9)):
        robustflow.refuses("compare", *runs, *wrong)


def test_comparison_of_many_runs_prints_one_line_per_pair(robustflow, runs):
    third = (*runs, runs[0])  # the same run twice, distinguished by a number
    out = robustflow.prints("compare", *third, "--metric", "epe", "--format", "csv")
    first, same, _ = csv.DictReader(io.StringIO(out))
    ranked = robustflow.prints("compare", *third, "--metric", "epe", "--format", "markdown")
    assert ranked.index("### Ranking") < ranked.index("### Every two models")
    dis, farneback = (Result(run).epe for run in runs)
    assert first["models"].endswith("against Farneback")
    assert [float(first[column]) for column in ("first", "second", "difference")] == pytest.approx(
        [dis, farneback, dis - farneback], abs=0.005
    )
    assert (same["difference"], same["p"]) == ("+0.00", "")


def test_seeds_of_one_model_are_compared_by_the_sources_of_variance(robustflow, tmp_path):
    options = {"corruptions": ["fog"], "severities": [1], "data_options": {"pairs": 2, "size": "32x48"}}
    seeds = [evaluate("dis", "shapes", output=tmp_path / str(seed), seed=seed, **options).path for seed in (0, 1)]
    assert "Sources of variance" in robustflow.prints("compare", *seeds)


def test_several_runs_without_ground_truth_are_compared_in_rcre(robustflow, tmp_path):
    write_frames(tmp_path, [(32, 40)] * 3)
    options = {"corruptions": ["contrast"], "severities": [1], "examples": False}
    for model in ("dis", "farneback"):
        evaluate(model, "folder", tmp_path, tmp_path / model, **options)
    three = ("compare", "dis", "farneback", "dis")
    assert robustflow.prints(*three).count(" against ") == 6  # in RCRE and in photometric error
    robustflow.refusal(f"{' '.join(three)} --metric cre", RunError, "--metric")
    for runs in (three, three[:3]):
        assert "photometric error" in robustflow.prints(*runs, "--metric", "photometric")
        robustflow.refusal(f"{' '.join(runs)} --metric sharpness", UsageError, "sharpness")


def test_report_with_examples_draws_the_same_pictures_as_the_run(robustflow, real_pictures):
    with real_pictures():
        robustflow.prints("run", "-m", "dis", "-O", "preset=ultrafast", "-c", "contrast", "-s", "3", "-o", "run")
        before = {path.name: path.read_bytes() for path in Path("run/examples").iterdir()}
        shutil.rmtree("run/examples")
        assert robustflow.prints("report", "run", "--examples").strip() == "run/examples"
    assert {path.name: path.read_bytes() for path in Path("run/examples").iterdir()} == before


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    """Such a run without example pictures."""
    folder = tmp_path_factory.mktemp("measured") / "run"
    model = ModelRef.parse("dis", {"preset": "ultrafast"})
    return evaluate(model, output=folder, corruptions=["contrast"], severities=[1, 3]).path


def test_examples_of_one_cell_are_drawn_after_a_run_without_examples(robustflow, measured, real_pictures):
    shutil.copytree(measured, "run")
    cell = ("--sample", "motorcycle", "-c", "contrast", "-s", 3)
    with real_pictures():
        assert robustflow.prints("report", "run", *cell, "-o", "cell.png").strip() == "cell.png"
    with Image.open("cell.png") as picture:
        assert (picture.format, picture.width) == ("PNG", 1400)
    assert not Path("run/examples").exists()


@pytest.mark.parametrize(
    ("arguments", "code"),
    [
        (("--sample", "motorcycle", "-c", "contrast", "-s", 5), 2),
        (("--sample", "motorcycle", "-c", "fog", "-s", 1), 2),
        (("--sample", "car", "-c", "contrast", "-s", 1), 2),
        (("--examples", "-m", "farneback"), 1),
        (("--examples", "-O", "preset=fast"), 1),
        (("--examples", "-m", "no_such_module:net"), 1),
    ],
)
def test_an_example_of_another_cell_or_model_is_refused(robustflow, measured, arguments, code):
    robustflow.refuses("report", measured, *arguments, code=code)


def test_examples_from_moved_data_work_and_from_changed_data_are_refused(robustflow, tmp_path):
    write_frames(tmp_path / "frames")
    (tmp_path / "mine_for_examples.py").write_text(
        "import numpy as np\ndef flow(a, b): return np.full((*a.shape[:2], 2), a.mean() / 50, np.float32)\n"
    )
    model = ("-m", "mine_for_examples:flow")
    robustflow.prints("run", *model, "-d", "frames", "-c", "contrast", "-s", 1, "-o", "run", "--no-examples")
    Path("frames").rename("moved")
    draw = ("report", "run", "--examples", *model)
    robustflow.refuses(*draw, code=1)
    robustflow.prints(*draw, "--data", "moved")
    shutil.rmtree("run/examples")
    write_image(Path("moved/000.png"), 255 - read_image(Path("moved/001.png")))
    robustflow.refuses(*draw, "--data", "moved", code=1)
    assert not Path("run/examples").exists()
