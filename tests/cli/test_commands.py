"""The command line as a person meets it: output, exit codes, one-line errors."""

from __future__ import annotations

import json
import math
import re
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import cv2
import numpy as np
import pytest

import robustflow as rf
from robustflow import extras, load_run
from robustflow.errors import DataError
from robustflow.models.registry import EXPORTED
from robustflow.testing import ZeroFlow

from ..video import clips


def _frames(folder: Path, sizes=((64, 96), (64, 96))) -> list[Path]:
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(0)
    paths = []
    for index, size in enumerate(sizes):
        paths.append(folder / f"{index:03d}.png")
        cv2.imwrite(str(paths[-1]), rng.integers(0, 255, (*size, 3)).astype(np.uint8))
    return paths


def test_run_then_show(robustflow):
    code, out, _ = robustflow("run", "--model", "dis", "-c", "contrast,jpeg_compression", "-s", "1,5", "-o", "run")
    assert code == 0
    assert "jpeg_compression" in out
    assert "CREr" in out
    summary = json.loads(Path("run/summary.json").read_text())
    assert summary["corruptions"]["contrast"]["severities"] == [1, 5]
    code, again, _ = robustflow("show", "run")
    assert (code, again) == (0, out)
    code, table, _ = robustflow("show", "run", "--metric", "rcre")
    assert code == 0
    assert "digital" in table


def test_run_and_show_as_json_print_the_summary_and_nothing_else(robustflow):
    code, out, _ = robustflow("run", "-m", "farneback", "-c", "contrast", "-s", "1", "-o", "run", "--json")
    assert code == 0
    (fact,) = json.loads(out)
    assert fact["benchmark"] == "demo"
    assert fact["summary"] == json.loads(Path("run/summary.json").read_text())
    assert robustflow("show", "run", "--json")[:2] == (0, out)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("class Rain(:\n    pass\n", "SyntaxError: invalid syntax (mine.py, line 1): class Rain(:"),
        ("import is_not_here\n", "No module named 'is_not_here'; install is_not_here"),
        ("1 / 0\n", "ZeroDivisionError: division by zero, while it was imported"),
    ],
)
def test_a_module_that_cannot_be_imported_says_why(robustflow, tmp_path, text, says):
    (tmp_path / "mine.py").write_text(text)
    code, _, err = robustflow("check", "mine:Rain")
    assert code == 2
    assert says in err
    assert err.count("\n") == 1


def test_a_module_that_needs_an_extra_names_it(robustflow, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "ptlflow", None)
    (tmp_path / "needs_extra.py").write_text("import ptlflow\n")
    assert "pip install 'robustflow[ptlflow]'" in robustflow("check", "needs_extra:Net")[2]


@pytest.mark.parametrize(
    ("library", "extra", "command"),
    [
        ("ray", "ray", "run -m dis --engine ray --output made"),
        ("onnxruntime", "onnx", "run -m net.onnx --output made"),
        ("ptlflow", "ptlflow", "run -m raft --checkpoint things --output made"),
        ("torch", "torch", "run -m arflow --output made"),
        ("torch", "torch", "run -m needs:Net --output made"),
        ("torch", "torch", "run -m dis -c needs:Rain --output made"),
        ("torch", "torch", "check needs:Net"),
        ("torch", "torch", "profile arflow"),
        ("torch", "torch", "train raft --recipe ood --data x --output made"),
        ("h5py", "h5", "run -m dis --benchmark spring --data . --output made"),
        ("uvicorn", "app", "app"),
    ],
)
def test_a_missing_extra_is_refused_before_anything_is_announced(
    robustflow, tmp_path, monkeypatch, library, extra, command
):
    """One line that names the extra, one exit code, and no folder."""
    monkeypatch.setattr(extras, "find_spec", lambda name: None if name == library else find_spec(name))
    monkeypatch.setitem(sys.modules, library, None)
    monkeypatch.delitem(sys.modules, "needs", raising=False)
    (tmp_path / "needs.py").write_text(f"import {library}\n")
    (tmp_path / "net.onnx").write_bytes(b"")
    (tmp_path / "train/0001/frame_left").mkdir(parents=True)
    code, out, err = robustflow(*command.split())
    assert (code, out) == (1, "")
    assert f"pip install 'robustflow[{extra}]'" in err
    assert err.count("\n") == 1
    assert not (tmp_path / "made").exists()


def test_verify_of_what_is_no_record_is_one_line(robustflow, tmp_path):
    (tmp_path / "text").write_text("not a zip")
    for name, why in (("nowhere", "No such file"), ("text", "not a record"), (".", "not a file")):
        code, out, _ = robustflow("verify", name)
        assert code == 1
        assert out.startswith("not verified: ")
        assert why in out
        assert out.count("\n") == 1


def test_check_tries_a_model_a_corruption_and_a_data_set(robustflow):
    assert "model 'ZeroFlow': every check passes" in robustflow("check", "robustflow.testing:ZeroFlow")[1]
    Path("my_rain.py").write_text(
        "import numpy as np\n\n\nclass Rain:\n    severities = (0.9, 0.8, 0.7, 0.6, 0.5)\n\n"
        "    def draw(self, rng, severity, shape):\n        return self.severities[severity - 1]\n\n"
        "    def apply(self, frame, state, index):\n        return np.rint(frame * state).astype(np.uint8)\n"
    )
    assert "every check passes" in robustflow("check", "my_rain:Rain")[1]
    pairs = robustflow("check", "robustflow.datasets.motorcycle:Motorcycle")
    assert "dataset 'motorcycle': every check passes" in pairs[1]
    code, _, err = robustflow("check", "json:loads", "--kind", "corruption")
    assert code == 2
    assert err.count("\n") == 1


README = Path(__file__).resolve().parents[2] / "README.md"


def _table_of_readme() -> list[str]:
    """The lines that the README shows of what the first command prints."""
    return re.search(r"^```text\n(.*?)^```$", README.read_text(), re.MULTILINE | re.DOTALL)[1].splitlines()


def _cells_of(table: str, first: str) -> list[str]:
    """The cells of a line of a printed table."""
    line = next(line for line in table.splitlines() if re.match(rf"[│┃] {first} ", line))
    return [cell.strip() for cell in re.split("[│┃]", line)[2:-1]]


def test_run_with_ground_truth_prints_epe_at_every_severity_as_the_readme_shows(robustflow):
    shown = _table_of_readme()
    corruptions = [line.split()[1] for line in shown if line.startswith("│ ") and "mean" not in line]
    code, out, _ = robustflow("run", "-m", "dis", "-c", ",".join(corruptions), "-o", "run", "--no-examples")
    assert code == 0
    assert _cells_of(out, "corruption") == ["EPE", "CRE", "CREr", "RCRE", "EPE 1", "2", "3", "4", "5"]
    fog = load_run("run").summary.corruptions["fog"]
    assert _cells_of(out, "fog")[4:] == [f"{value:.2f}" for value in fog.by_severity["epe"]]
    assert _cells_of(out, "fog")[3] == f"{fog.rcre:.2f}"
    lines = [line.rstrip() for line in out.splitlines()]
    assert [line for line in shown[:-3] if line not in lines] == []  # the last three are means over all 20


@pytest.mark.slow
def test_the_first_command_prints_what_the_readme_shows(robustflow):
    code, out, _ = robustflow("run", "--model", "dis", "-o", "run", "--no-examples")
    printed = iter(line.rstrip() for line in out.splitlines())
    assert code == 0
    assert [line for line in _table_of_readme() if line not in printed] == []  # in this order


class _Named(ZeroFlow):
    def identity(self):
        return {"name": "[/red][b]\u202e\x1b[3m"}


def test_several_models_one_after_the_other(robustflow):
    few = ("-c", "contrast", "-s", "1", "--no-examples")
    code, out, error = robustflow("run", "-m", "dis", "-m", "farneback", "-o", "both", *few)
    assert code == 0, error
    runs = [load_run(f"both/{name}") for name in ("dis", "farneback")]
    assert [run.name for run in runs] == ["DIS", "Farneback"]
    table = out[out.index("2 models") :]
    for run in runs:
        line = next(line for line in table.splitlines() if run.name in line and "compare" not in line)
        assert f"{run.epe_clean:.2f}" in line
        assert f"{run.cre:.2f}" in line
    assert "robustflow compare" not in table  # one pair cannot tell
    code, _, error = robustflow("run", "-m", "dis", "-m", "dis", *few)
    assert (code, error.count("\n")) == (2, 1)


def test_show_says_what_speaks_against_a_model(robustflow, tmp_path):
    rf.evaluate(_Named(), "demo", output=tmp_path / "zero", corruptions=["contrast"], severities=[1], examples=False)
    code, out, _ = robustflow("show", tmp_path / "zero")
    assert code == 0
    (line,) = (line for line in out.splitlines() if line.startswith("This says nothing about robustness: "))
    assert "is not below half of the 34.34 px of zero flow" in line
    assert "its flow hardly depends on the frames" in line


def test_show_measures_robustness_beside_accuracy(robustflow, tmp_path):
    options = {"corruptions": ["fog"], "severities": [1, 5], "examples": False}
    run = rf.evaluate("dis", "demo", output=tmp_path / "dis", **options)
    ratios = [math.log(epe / run.epe_clean) for epe in run.summary.corruptions["fog"].by_severity["epe"]]
    code, out, _ = robustflow("show", run.path, "--metric", "log_ratio")
    assert code == 0
    for value in (*ratios, sum(ratios) / 2):
        assert f"{value:.2f}" in out
    assert f"log_ratio {sum(ratios) / 2:.2f}, the mean over corruptions" in out
    assert "nothing about robustness" not in out
    assert run.uncoupled().overall.median_log_ratio == pytest.approx(sum(ratios) / 2)
    code, _, error = robustflow("show", run.path, "--metric", "log_ration")
    assert (code, error.count("\n")) == (2, 1)


@pytest.mark.parametrize("metric", ["all", "rcre"])
def test_a_name_or_folder_is_not_markup_and_steers_no_terminal(robustflow, tmp_path, metric):
    run = tmp_path / "r[/blue]"
    rf.evaluate(_Named(), "demo", output=run, corruptions=["contrast"], severities=[1], examples=False)
    code, out, err = robustflow("show", run, "--metric", metric)
    assert (code, err) == (0, "")
    assert "[/red][b]\ufffd\ufffd[3m" in out
    assert "r[/blue]" in out


def test_what_a_file_says_steers_no_terminal_from_an_error(robustflow):
    code, _, err = robustflow("run", "--model", "no\x1b[31m\u202esuch")
    assert (code, "\x1b" in err, "\u202e" in err) == (2, False, False)
    assert "unknown model 'no\ufffd[31m\ufffdsuch'" in err


def test_a_model_that_knows_nothing_is_not_praised(robustflow, tmp_path):
    source = "import numpy as np\ndef flow(a, b): return np.full((*a.shape[:2], 2), np.nan, np.float32)\n"
    (tmp_path / "not_a_number.py").write_text(source)
    with pytest.warns(UserWarning, match="no pixel to measure, so there is no worst sample"):
        code, out, _ = robustflow("run", "-m", "not_a_number:flow", "-c", "contrast", "-s", "1", "--allow-invalid")
    assert code == 0
    assert "nothing could be measured" in out
    assert "2 rows have no pixel to measure" in out


def test_own_frames_have_no_ground_truth(robustflow, tmp_path):
    _frames(tmp_path / "frames", [(64, 96)] * 3)
    code, out, _ = robustflow("run", "-m", "dis", "-b", "folder", "-d", "frames", "-c", "contrast", "-o", "run")
    assert code == 0
    assert "no ground truth" in out
    assert json.loads(Path("run/summary.json").read_text())["epe_clean"] is None


def test_models_on_an_own_clip_show_the_clean_motion_and_no_column_of_dashes(robustflow, tmp_path):
    _frames(tmp_path / "clip", [(64, 96)] * 3)
    few = ("-d", tmp_path / "clip", "-b", "folder", "-c", "contrast", "-s", "1", "--no-examples")
    code, out, error = robustflow("run", "-m", "dis", "-m", "farneback", "-o", "both", *few)
    assert code == 0, error
    alone, table = out.split("2 models")
    assert _cells_of(table, "model") == ["RCRE", "clean flow (px)"]
    lengths = [load_run(f"both/{name}").summary.clean_flow_length for name in ("dis", "farneback")]
    assert [_cells_of(table, name)[1] for name in ("DIS", "Farneback")] == [f"{length:.2f}" for length in lengths]
    assert all(f"on clean frames the flow is {length:.2f} px long on average" in alone for length in lengths)
    assert "sequence is too few to say" in table
    assert "robustflow compare" not in out


@pytest.fixture
def walk(tmp_path):
    """A video of a moving picture."""
    return clips.clip(tmp_path / "walk.mp4", 8).path


@pytest.mark.parametrize("kind", ["video", "pictures", "folders of pictures"])
def test_own_frames_need_no_benchmark(robustflow, tmp_path, walk, kind):
    if kind != "video":
        _frames(tmp_path / "data" / ("a" if "folders" in kind else ""))
    data = walk if kind == "video" else tmp_path / "data"
    code, _, error = robustflow(
        "run", "-m", "dis", "-d", data, "--limit", 1, "-c", "contrast", "-s", 1, "-o", "run", "--no-examples"
    )
    assert code == 0, error
    assert load_run("run").benchmark == "folder"


def test_a_corruption_of_clips_names_the_command_that_makes_it_for_this_video(robustflow, walk):
    code, _, error = robustflow("run", "-m", "dis", "-d", walk, "-c", "fog,h264_crf", "-s", 1, "-o", "run")
    assert code == 2
    assert f"give --benchmark gopro-fc --data {walk}" in error
    assert not Path("run").exists()


def test_gallery_shows_a_corruption_of_ones_own(robustflow, walk, tmp_path, monkeypatch):
    (tmp_path / "my_dusk.py").write_text(
        "class Dusk:\n    def draw(self, rng, severity, shape):\n        return 2 * severity\n"
        "    def apply(self, frame, state, index):\n        return frame // state\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    frames = _frames(tmp_path / "pair")
    for source in (("--frames", *frames), ("--clip", walk, "--length", 2)):
        code, _, error = robustflow("gallery", *source, "-c", "my_dusk:Dusk,contrast", "-o", "gallery")
        assert code == 0, error
        assert "Dusk" in Path("gallery/gallery.html").read_text()


def test_corrupt_writes_what_the_library_makes(robustflow, tmp_path):
    first, second = _frames(tmp_path)
    code, out, _ = robustflow("corrupt", first, second, "-c", "impulse_noise", "-s", "2,4", "--seed", 3, "-o", "out")
    assert (code, out.split()) == (0, ["out/impulse_noise_2", "out/impulse_noise_4"])
    frames = [cv2.imread(str(path))[..., ::-1].copy() for path in (first, second)]
    expected = rf.corrupt(*frames, "impulse_noise", 4, seed=3, key=first.stem)
    for path, frame in zip((first, second), expected, strict=True):
        np.testing.assert_array_equal(cv2.imread(f"out/impulse_noise_4/{path.name}")[..., ::-1], frame)


def test_seeds_of_a_still_run_are_draws_in_one_folder(robustflow, tmp_path):
    _frames(tmp_path / "frames")
    command = ("run", "-m", "farneback", "--data", "frames", "--still", "-c", "contrast,impulse_noise", "-s", "2")
    code, out, err = robustflow(*command, "--seeds", "2", "-o", "run", "--no-examples")
    assert code == 0, err
    assert Path("run/manifest.json").is_file()
    lines = {line.split()[1]: line.split() for line in out.splitlines() if line.startswith("│")}
    place = next(line for line in out.splitlines() if "spread" in line and "EPE" in line).replace("┃", "│").split("│")
    place = [word.strip() for word in place].index("spread")
    cells = {name: " ".join(line).split("│")[place].strip() for name, line in lines.items()}
    assert cells["contrast"] == "0.00", "it draws nothing"
    assert float(cells["impulse_noise"]) > 0
    assert "standard deviation over 2 draws" in out
    assert robustflow(*command, "-o", "run", "--seeds", "0")[0] != 0


def test_corrupt_check_names_what_this_machine_computes_differently_and_fails(robustflow, monkeypatch):
    from robustflow.corruptions import machine_check

    monkeypatch.setattr(machine_check, "CHECKED", ("contrast", "pixelate"))
    assert robustflow("corrupt", "--check")[:2] == (0, "2 of 2 corruptions give the package's bytes on this machine\n")
    monkeypatch.setattr(machine_check, "_SEED", machine_check._SEED + 1)  # contrast and pixelate draw nothing
    assert robustflow("corrupt", "--check")[0] == 0
    monkeypatch.setattr(machine_check, "_SHIFT", (2, 6))
    code, out, _ = robustflow("corrupt", "--check")
    assert (code, out.splitlines()[0]) == (1, "contrast: other bytes at severity 1, 3, 5")


def test_corrupt_without_frames_says_what_to_give(robustflow):
    code, _, err = robustflow("corrupt", "-c", "fog")
    assert code == 2
    assert "give two frames and --corruptions, or --check alone" in err


LISTED = {"models": "farneback", "corruptions": "glass_blur", "benchmarks": "kitti-fc", "datasets": "sintel"}


@pytest.mark.parametrize("kind", [*LISTED, "all"])
def test_list(robustflow, kind):
    code, out, _ = robustflow("list", kind)
    assert code == 0
    first_words = {line.split()[0].rstrip(":") for line in out.splitlines() if line}
    for name, listed in LISTED.items():
        assert (listed in first_words) == (kind in (name, "all"))


def test_the_list_of_models_says_what_their_checkpoints_have_seen(robustflow):
    _, out, _ = robustflow("list", "models")
    lines = {line.split()[0]: line for line in out.splitlines()}
    assert "things OOD" in lines["raft"]
    assert "kitti LEAKED" in lines["raft"]
    assert "2020" in lines["raft"]
    assert "BSD-3-Clause" in lines["raft"]
    assert "UNKNOWN" in lines["arflow"]
    assert "knowledge" in lines["farneback"]
    assert lines["dis"].endswith("learns nothing")
    assert lines["tiny"].endswith("shipped OOD")
    assert "things288960 OOD" in lines["flowformer_pp"]
    assert "splatflow (cupy, for CUDA)" in out
    for name in ("precomputed", *EXPORTED.values()):
        assert re.search(r"^\w+ +any +your files +(yes|needs \[\w+\]) +a.* UNKNOWN$", lines[name])
    assert lines["memfof"].endswith("kitti LEAKED, sintel LEAKED, spring LEAKED, tartan OOD, things OOD, tskh LEAKED")


def test_search_for_models_lists_what_each_of_their_checkpoints_saw(robustflow):
    _, out, _ = robustflow("list", "models", "sea_raft_m")
    lines = out.splitlines()
    spring = next(index for index, line in enumerate(lines) if line.startswith("sea_raft_m spring: "))
    assert lines[spring].startswith(
        "sea_raft_m spring: LEAKED on kitti-fc, LEAKED on sintel, OOD on gopro-fc; trained on"
    )
    assert lines[spring + 1].startswith("    confidence high: the name hides KITTI")
    assert robustflow("list", "models", "SEA-RAFT-m")[1] == out
    assert robustflow("list", "models", "FlowFormer++")[1].startswith("flowformer_pp chairs: ")
    assert robustflow("list", "models", "farneback")[1] == "farneback: no published checkpoints\n"
    for arguments in (("models", "sea_rafd"), ("corruptions", "fog")):
        code, _, error = robustflow("list", *arguments)
        assert code != 0
        assert len(error.splitlines()) == 1


def test_the_setting_stands_beside_the_name(robustflow, real_pictures):
    command = ("run", "-m", "dis", "-O", "preset=ultrafast", "-c", "contrast", "-s", "1", "-o", "run")
    with real_pictures():
        assert "DIS (knowledge), 1 pair" in robustflow(*command)[1]
    page = Path("run/report.html").read_text()
    assert "nothing: it learns nothing" in page
    assert "not declared" not in page


def _truncated_png(folder: Path) -> None:
    first, _ = _frames(folder)
    first.write_bytes(first.read_bytes()[:-2000])


def _kitti_with_8_bit_flow(folder: Path) -> None:
    _frames(folder / "training" / "image_2")
    for index, number in (("000", "10"), ("001", "11")):
        path = folder / "training" / "image_2" / f"{index}.png"
        path.rename(path.with_name(f"000000_{number}.png"))
    (folder / "training" / "flow_occ").mkdir()
    cv2.imwrite(str(folder / "training" / "flow_occ" / "000000_10.png"), np.zeros((64, 96, 3), np.uint8))


@pytest.mark.parametrize(
    ("make", "arguments", "code", "says"),
    [
        (None, "run -m dis -b kitti-fc -d nowhere", 1, "nowhere"),
        (lambda f: f.mkdir(), "run -m dis -b kitti-fc -d data", 1, "data"),
        (lambda f: f.mkdir(), "run -m dis -b folder -d data", 1, "data"),
        (_truncated_png, "run -m dis -b folder -d data -c contrast", 1, "truncated"),
        (lambda f: _frames(f, [(64, 96), (64, 98)]), "run -m dis -b folder -d data -c contrast", 1, "size"),
        (_kitti_with_8_bit_flow, "run -m dis -b kitti-fc -d data -c contrast", 1, "16"),
        (None, "run -m diss", 2, "did you mean 'dis'"),
        (None, "run -m dis -b kiti-fc", 2, "did you mean 'kitti-fc'"),
        (None, "run -m dis -c frosst", 2, "did you mean 'frost'"),
        (None, "run -m dis -d /nowhere.mp4", 1, "/nowhere.mp4: no such file or folder; check the path"),
        (None, "run -m dis -d /nowhere -D start=3", 1, "/nowhere: no such file or folder"),
        (lambda f: (f / "training/image_2").mkdir(parents=True), "run -m dis -d data", 2, "give --benchmark kitti-fc"),
        (lambda f: f.mkdir(), "run -m dis -d data", 1, "no pictures in it"),
        (None, "run -m dis -c h264_crf -s 1", 2, "needs the clip that its frames come from: give --benchmark gopro-fc"),
        (_frames, "run -m dis -d data -c fog+h264_crf -s 1", 2, "fog+h264_crf cannot be made"),
        (_frames, "corrupt data/000.png data/001.png -c h264_crf", 2, "gallery --clip CLIP shows it"),
        (None, "run -m dis -s 0", 2, "severity 0"),
        (None, "run -m dis -s 1,6", 2, "severity 6"),
        (None, "run -m dis -s high", 2, "whole numbers"),
        (None, "run -m dis --variant other", 2, "default, reference, paper"),
        (None, "run -m dis -O presetfast", 2, "KEY=VALUE"),
        (None, "run -m dis --device cpu", 2, "runs on the CPU only; leave out --device"),
        (None, "run -m dis --checkpoint things", 2, "has no weights to load; leave out --checkpoint"),
        (None, "run -m dis --batch-size 4", 2, "one pair at a time"),
        (None, "run -m arflow -O checkpoint=a.pth --checkpoint b.pth", 2, "checkpoint is given twice"),
        (None, "run -m dis --engine cluster", 2, "engine"),
        (_frames, "displacement folder -d data", 1, "name the model"),
        (None, "show nowhere", 1, "manifest.json"),
        (None, "list weather", 2, "models"),
        (None, "profile dis", (1, 2), "PyTorch"),
        (_frames, "corrupt data/000.png data/001.png -c fog -s 9", 2, "severity 9"),
        (_frames, "corrupt data/000.png data/none.png -c contrast", 1, "none.png"),
        (_truncated_png, "corrupt data/000.png data/001.png -c contrast", 1, "cut short"),
        (lambda f: _frames(f, [(64, 96), (64, 98)]), "corrupt data/000.png data/001.png -c contrast", 1, "same size"),
        (None, "export demo -d x", 1, "x: no such file or folder"),
    ],
)
def test_bad_input_is_one_line_that_says_what_to_do(robustflow, tmp_path, make, arguments, code, says):
    if make:
        make(tmp_path / "data")
    got, out, err = robustflow(*arguments.split(), *(["-o", "run"] if arguments.startswith("run") else []))
    lines = [line for line in err.splitlines() if line.startswith("robustflow:")]
    assert got in (code if isinstance(code, tuple) else (code,))
    assert len(lines) == 1
    assert says in lines[0]
    assert "Traceback" not in err + out
    assert not list(Path().rglob("*.parquet"))
    assert not list(Path().rglob(".partial-*"))


def test_usage_errors_of_the_command_line_itself(robustflow):
    assert robustflow("run")[0] == 2
    assert robustflow("run", "--no-such-option")[0] == 2
    assert robustflow("nonsense")[0] == 2


def test_a_folder_that_cannot_be_written(robustflow, tmp_path):
    (tmp_path / "file").write_text("in the way")
    code, _, err = robustflow("run", "-m", "dis", "-c", "contrast", "-o", "file/run")
    assert code == 1
    assert err.count("\n") == 1
    assert "file/run" in err


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a device that is always full")
def test_a_read_only_file_system(robustflow, tmp_path):
    code, _, _ = robustflow("run", "-m", "dis", "-c", "contrast", "-s", "1", "-o", "run", "--no-examples")
    assert code == 0
    place = tmp_path / "read-only"
    place.mkdir()
    if subprocess.run(["mount", "-t", "tmpfs", "-o", "ro", "tmpfs", str(place)], capture_output=True).returncode:
        pytest.skip("needs the right to mount a file system")
    try:
        for arguments in (
            ("pack", "run", "-o", place / "x.robustflow"),
            ("leaderboard", "run", "--no-published", "-o", place),
        ):
            code, _, error = robustflow(*arguments)
            assert (code, error.count("\n")) == (1, 1)
            assert "Read-only file system" in error
    finally:
        subprocess.run(["umount", str(place)], check=True)


def test_a_full_disk(robustflow, monkeypatch):
    """The real error of a real full device, met where a shard is renamed into place."""
    import robustflow.atomic as atomic

    real = open

    def full(path, *mode):
        if str(path).endswith(".parquet") and ".partial-" in str(path):
            Path(path).symlink_to("/dev/full")
            return real(path, "wb", buffering=0)
        return real(path, *mode)

    monkeypatch.setattr(atomic, "open", full, raising=False)
    code, _, err = robustflow("run", "-m", "dis", "-c", "contrast", "-o", "run")
    assert code == 1
    assert "No space left on device" in err
    assert not list(Path("run").rglob("*.parquet"))
    assert not list(Path("run").rglob(".partial-*"))


def test_version_and_help_do_not_import_the_heavy_parts():
    script = (
        "import sys; sys.argv = ['robustflow', '--help']\n"
        "from robustflow.cli.main import main\n"
        "try: main()\n"
        "except SystemExit: pass\n"
        "heavy = {'numpy', 'cv2', 'polars', 'numba', 'scipy', 'torch', 'matplotlib'} & set(sys.modules)\n"
        "assert not heavy, heavy\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "robustflow run --model dis" in done.stdout


def test_a_run_that_cannot_be_written_is_shown_with_a_warning(robustflow, monkeypatch):
    robustflow("run", "-m", "dis", "-O", "preset=ultrafast", "-c", "contrast", "-s", "1", "-o", "run", "--no-examples")
    Path("run/summary.json").unlink()

    def refuse(path, value):
        raise DataError(f"cannot write {path}: Read-only file system; choose a folder that exists and has room")

    monkeypatch.setattr("robustflow.runs.run.write_json", refuse)
    with pytest.warns(UserWarning, match="are left as they are: cannot write run/summary.json: Read-only file system"):
        code, out, _ = robustflow("show", "run")
    assert code == 0
    assert "clean EPE" in out
    assert "report:" not in out


def test_corrupt_and_gallery_take_the_users_depth_maps(robustflow, tmp_path):
    first, second = _frames(tmp_path / "in")
    code, _, err = robustflow("corrupt", first, second, "-c", "fog_3d", "-s", "5")
    assert code != 0
    assert err.count("\n") == 1
    assert "--depth DIR" in err
    near, far = np.full((64, 96), 1, np.float32), np.full((64, 96), 5000, np.float32)
    (tmp_path / "maps").mkdir()
    np.save(tmp_path / "maps" / "000.npy", near)
    np.save(tmp_path / "maps" / "001.npy", far)
    assert robustflow("corrupt", first, second, "-c", "fog_3d", "-s", "5", "--depth", "maps", "-o", "out")[0] == 0
    fogged = [cv2.imread(str(tmp_path / "out" / "fog_3d_5" / f"{name}.png")) for name in ("000", "001")]
    assert fogged[0].std() > 60
    assert len(np.unique(fogged[1].reshape(-1, 3), axis=0)) == 1

    shown = ["gallery", "--frames", first, second, "-c", "fog_3d"]
    assert "--depth DIR" in robustflow(*shown)[2]
    assert robustflow(*shown, "--depth", "maps", "--focal", "90", "-o", "shown")[0] == 0
    page = (tmp_path / "shown" / "gallery.html").read_text()
    assert "1 m (white) to 1 m" in page
    assert "no corruption" not in page
