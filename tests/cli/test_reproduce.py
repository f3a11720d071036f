"""Test the commands of `reproduce`: a table beside the paper's values, and the flow magnitudes of a benchmark."""

import csv
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl
import pytest

import robustflow as rf
from robustflow.api import evaluate, load_run
from robustflow.cli.reproduce import app
from robustflow.core.errors import UsageError
from robustflow.media.images import write_image
from robustflow.paper.plan import ARTEFACTS, choose, paper_variants
from robustflow.paper.side_by_side import columns_of, comparison_csv, paper_alone, run_beside_paper
from robustflow.run.displacement import read_displacement
from robustflow.stats.published.tables import published_lines
from tests.data.datasets.layouts import flow, picture
from tests.data.video import clips

SAME = ("the published average is over the same corruptions", "the published values are over all five severities")
NARROW = ("--models", "dis,farneback", "--corruptions", "contrast,jpeg_compression", "--severities", "1")


@pytest.fixture
def data(tmp_path):
    training = tmp_path / "kitti" / "training"
    for key in ("000002", "000003"):
        for frame in ("10", "11"):
            picture(training / "image_2" / f"{key}_{frame}.png", 48, 64)
        flow(training / "flow_occ" / f"{key}_10.png", None, 48, 64)
    return tmp_path / "kitti"


def _published(model, corruption):
    line = next(n for key, n in published_lines().items() if (key.benchmark, key.model) == ("kitti-fc", model))
    return line.number("epe", corruption)


def test_table_shows_computed_beside_published_values(robustflow, data, tmp_path):
    out = robustflow.prints("reproduce", "tab2", "--data", data, *NARROW)
    run = load_run(tmp_path / "reproduced" / "kitti-fc" / "dis")
    with open("reproduced/tab2.csv", newline="") as file:
        lines = {(line["model"], line["corruption"]): line for line in csv.DictReader(file)}
    ours = run.mean("epe", "contrast")
    line = lines["DIS", "contrast"]
    assert float(line["published"]) == _published("DIS", "contrast")
    assert float(line["here"]) == pytest.approx(ours, rel=1e-5)
    assert float(line["difference"]) == pytest.approx(ours - _published("DIS", "contrast"), rel=1e-4)
    assert ("DIS", "fog") not in lines
    both = (_published("DIS", "contrast") + _published("DIS", "jpeg_compression")) / 2
    assert float(lines["DIS", "average"]["published"]) == pytest.approx(both)
    few = ("2 pairs, not the paper's 80", "average over JPEG compression and ", "severity 1 only", "on grey frames")
    for part in (*few, *SAME):
        assert part in line["note"]
    assert "2 of 2 " in out
    assert f"{ours - _published('DIS', 'contrast'):+.2f}" in out


def test_part_of_the_corruptions_is_compared_with_the_same_part_of_the_published_values(data, tmp_path):
    corruptions = ["contrast", "fog", "elastic_transform"]
    options = {"corruptions": corruptions, "severities": 1, "limit": 1}
    run = evaluate("dis", "kitti-fc", data, tmp_path / "run", **options)
    (runnable,) = choose(paper_variants("kitti-fc", ["dis"]), "kitti-fc", [])
    both = run_beside_paper(ARTEFACTS["fig5"], runnable, run)
    clean = _published("DIS", "clean")
    for family, corruption in (("digital", "contrast"), ("weather", "fog")):  # a single corruption of the family
        published = (_published("DIS", corruption) - clean) / clean
        assert both.published["crer", family] == pytest.approx(published)
        assert both.here["crer", family] == pytest.approx(run.mean("crer", corruption))
    # the paper's averages exclude elastic_transform
    assert both.here["epe", "average"] == pytest.approx((run.mean("epe", "contrast") + run.mean("epe", "fog")) / 2)
    # the printed CRE of BrightFlow is that of UPFlow (`robustflow reproduce audit`), and the printed EPE is its own
    (brightflow,) = paper_variants("kitti-fc", ["brightflow"])
    stand_in = replace(runnable, variant=brightflow, weights="stand-in " + "with a long name " * 10)
    both = run_beside_paper(ARTEFACTS["tab3"], stand_in, run)
    clean, contrast, fog = (_published("BrightFlow", name) for name in ("clean", "contrast", "fog"))
    assert both.published["crer", "average"] == pytest.approx(((contrast + fog) / 2 - clean) / clean)
    assert len(both.note) > 300
    assert both.note.replace("  ", " ") in comparison_csv(ARTEFACTS["tab3"], [both])


def test_methods_that_table_3_omits_have_no_published_crer():
    values = {v: paper_alone(ARTEFACTS["tab3"], v).published for v in paper_variants("kitti-fc")}
    without = {variant.method for variant, published in values.items() if ("crer", "average") not in published}
    assert without == {"Farneback", "DIS", "FlowDiffuser"}
    assert [column.label for column, _ in columns_of(ARTEFACTS["tab3"], [])] == ["CREr"]
    raft = next(value for variant, value in values.items() if (variant.method, variant.setting) == ("RAFT", "OOD"))
    assert raft["crer", "average"] == 1.22


def test_a_video_is_data_for_gopro_fc(robustflow, tmp_path):
    video = clips.clip(tmp_path / "walk.mp4", 8).path
    robustflow.refuses("reproduce", "tab4", "--data", video, code=1)  # too few frames


@pytest.mark.parametrize(
    ("options", "culprit"),
    [
        ("--corruptions nonsense", "nonsense"),
        ("--corruptions fog,elastic_transform", "elastic_transform"),
        ("--limit 0", "--limit"),
    ],
)
def test_options_with_which_no_variant_can_run_are_refused(robustflow, data, tmp_path, options, culprit):
    robustflow.refusal(f"reproduce tab2 --data {data} --models dis,farneback {options}", UsageError, culprit)
    assert not (tmp_path / "reproduced").exists()


def test_the_exit_status_is_1_if_every_run_failed(robustflow, data):
    code, out, _ = robustflow("reproduce", "tab2", "--data", data, "--models", "dis,raft", "--workers", "0")
    assert code == 1
    assert "failed: --workers" in " ".join(out.split())


def test_a_second_call_continues_and_the_figure_takes_the_same_runs(robustflow, data, tmp_path):
    few = ("--models", "dis", "--corruptions", "contrast", "--severities", "1")
    robustflow.prints("reproduce", "tab2", "--data", data, *few, "--limit", "1")
    assert "2 already finished" in robustflow("reproduce", "fig4", "--data", data, *few)[2]
    assert load_run(tmp_path / "reproduced" / "kitti-fc" / "dis").measured.samples == 2
    assert any(path.name.startswith("clean_against_cre") for path in (tmp_path / "reproduced" / "figures").iterdir())
    assert ",crer,average," in (tmp_path / "reproduced" / "fig4.csv").read_text()


def test_a_variant_that_fails_is_missing_and_the_others_run(robustflow, data, tmp_path):
    (tmp_path / "ckpts").mkdir()
    (tmp_path / "ckpts" / "arflow-id.pth").write_bytes(b"<html>")
    few = ("--models", "dis,arflow", "--corruptions", "contrast", "--severities", "1", "--limit", "1")
    out = robustflow.prints("reproduce", "tab2", "--data", data, "--checkpoints", tmp_path / "ckpts", *few)
    assert "1 of 2 " in out
    pytest.importorskip("torch", reason="the file is read with the torch extra")
    assert "failed:" in out


def test_a_dry_run_says_what_is_missing(robustflow, tmp_path):
    assert "0 of 11 " in robustflow.prints("reproduce", "tab4", "--dry-run", "-f", "csv")
    assert not (tmp_path / "reproduced").exists()


@pytest.mark.parametrize("name", list(ARTEFACTS))
def test_dry_run_of_every_table_and_figure_prints_its_plan(robustflow, name):
    out = robustflow.prints("reproduce", name, "--dry-run")
    assert ARTEFACTS[name].title in out or "can be run here" in out


def test_without_a_name_every_table_figure_and_command_is_listed(robustflow):
    *lines, last = robustflow.prints("reproduce").splitlines()
    assert len(lines) == len(ARTEFACTS)
    commands = {command.callback.__name__ for command in app.registered_commands} - {"table"}
    assert all(name in last for name in commands)
    assert len(commands) == 3


def test_displacement_of_the_embedded_pair_is_its_disparity(robustflow):
    out = robustflow.prints("reproduce", "displacement", "demo", "-o", "out")
    assert out.split() == [f"out/displacement.{form}" for form in ("csv", "png", "svg", "pdf")]
    table = pl.read_csv("out/displacement.csv")
    sample = rf.load_dataset("motorcycle", None).load("motorcycle")
    amplitude = np.abs(sample.flow[..., 0][sample.valid])
    assert table["pixels"].sum() == sample.valid.sum()
    assert table.filter(table["low"] >= 40)["pixels"].sum() == (amplitude >= 40).sum()
    assert Path("out/displacement.png").read_bytes()[1:4] == b"PNG"


def _stills(folder, grey):
    folder.mkdir()
    for index in range(3):
        write_image(folder / f"{index}.png", np.full((32, 32, 3), grey + 20 * index, np.uint8))
    return folder


def test_displacement_is_stored_in_a_run_of_the_same_frames_only(robustflow, runs, tmp_path):
    path = shutil.copytree(runs[1], "run")
    out = robustflow.prints("reproduce", "displacement", "demo", "--model", "dis", "--into", path)
    assert out == "run/displacement.json\n"
    assert read_displacement(rf.load_run(path)).source == "dis"
    assert not Path("displacement").exists()
    data = _stills(tmp_path / "data", 40)
    robustflow.refusal(f"reproduce displacement folder -d {data} -m dis --into run", UsageError, "run")


def test_displacement_of_different_frames_with_the_same_names_is_refused(robustflow, tmp_path):
    data, other = _stills(tmp_path / "data", 40), _stills(tmp_path / "other", 60)
    run = rf.evaluate("farneback", "folder", data, tmp_path / "run", corruptions=["contrast"], severities=[1])
    command = ("reproduce", "displacement", "folder", "--data", other, "-m", "dis", "--into", run.path)
    robustflow.refuses(*command, code=1)
    assert read_displacement(run) is None
