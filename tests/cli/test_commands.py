"""Test the command line as a user sees it: output, exit codes, and one-line errors."""

from __future__ import annotations

import json
import math
import re
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
import skimage

import robustflow as rf
from robustflow import load_run
from robustflow.core.errors import DataError
from robustflow.testing import ZeroFlow
from tests.data.video import clips

from .conftest import WHOLE_DEMO, write_frames


def test_report_prints_what_the_run_printed_as_a_table_and_as_json(robustflow):
    few = ("run", "--model", "dis", "-c", "contrast,jpeg_compression", "-s", "1,5", "-o", "run")
    out = robustflow.prints(*few)
    assert {"jpeg_compression", "CREr"} <= set(out.split())
    assert robustflow.prints("report", "run") == out
    (fact,) = json.loads(robustflow.prints(*few, "--json"))
    assert fact["summary"] == json.loads(Path("run/summary.json").read_text())
    assert fact["summary"]["corruptions"]["contrast"]["severities"] == [1, 5]
    assert json.loads(robustflow.prints("report", "run", "--json")) == [fact]
    ratios = [
        math.log(load_run("run").mean("epe", "contrast", level) / fact["summary"]["epe_clean"]) for level in (1, 5)
    ]
    assert {f"{ratio:.2f}" for ratio in ratios} <= set(
        robustflow.prints("report", "run", "--metric", "log_ratio").split()
    )


def test_several_models_run_one_after_the_other(robustflow):
    out = robustflow.prints(
        "run", "dis", "-m", "farneback", "-o", "both", "-c", "contrast", "-s", "1-2", "--no-examples"
    )
    runs = [load_run(f"both/{name}") for name in ("dis", "farneback")]
    assert [run.name for run in runs] == ["DIS", "Farneback"]
    table = out[out.index("\nMeans\n") :]
    for run in runs:
        assert run.manifest.severities == (1, 2)
        assert {f"{run.epe_clean:.2f}", f"{run.cre:.2f}"} <= set(_cells_of(table, run.name))
    assert "robustflow compare" not in table  # a single pair is no evidence


def test_check_tries_a_model_a_corruption_and_a_data_set(robustflow):
    assert robustflow.prints("check", "robustflow.testing:ZeroFlow").startswith("model 'ZeroFlow'")
    Path("my_rain.py").write_text(
        "import numpy as np\n\n\nclass Rain:\n    severities = (0.9, 0.8, 0.7, 0.6, 0.5)\n\n"
        "    def draw(self, rng, severity, shape):\n        return self.severities[severity - 1]\n\n"
        "    def apply(self, frame, state, index):\n        return np.rint(frame * state).astype(np.uint8)\n"
    )
    robustflow.prints("check", "my_rain:Rain")
    pairs = robustflow.prints("check", "robustflow.data.datasets.motorcycle:Motorcycle")
    assert pairs.startswith("dataset 'motorcycle'")
    robustflow.refuses("check", "json:loads", "--kind", "corruption")
    Path("built.py").write_text("from robustflow.testing import ZeroFlow\n\n\ndef build(u=0):\n    return ZeroFlow()\n")
    assert robustflow.prints("check", "built:build").startswith("model 'ZeroFlow'")
    assert "pass built:build" in robustflow.refuses("check", "./built.py:build")
    Path("titled.py").write_text(
        "from robustflow.testing import ZeroFlow\n\n\nclass Titled(ZeroFlow):\n    name = 'a\\x1b]0;title\\x07'\n"
    )
    assert "\x1b" not in robustflow.refuses("check", "titled:Titled")  # a run refuses this name, too


README = Path(__file__).resolve().parents[2] / "README.md"


def _table_of_readme() -> list[str]:
    """The lines of the first command's output that are shown in the README."""
    return re.search(r"^```text\n(.*?)^```$", README.read_text(), re.MULTILINE | re.DOTALL)[1].splitlines()


def _cells_of(table: str, first: str) -> list[str]:
    """The cells in a line of a printed table."""
    line = next(line for line in table.splitlines() if re.match(rf"{first}( \[\d\])? +[│┃]", line))
    return [cell.strip() for cell in re.split("[│┃]", line)[1:]]


def test_run_with_ground_truth_prints_epe_at_every_severity_as_the_readme_shows(robustflow, monkeypatch):
    monkeypatch.setattr(skimage, "__file__", WHOLE_DEMO)
    shown = _table_of_readme()
    corruptions = [line.split()[0] for line in shown if re.match("[a-z_]+ +│", line) and "mean" not in line]
    out = robustflow.prints("run", "-m", "dis", "-c", ",".join(corruptions), "-o", "run", "--no-examples")
    assert _cells_of(out, "Corruption") == ["EPE", "CRE", "CREr", "RCRE", "EPE 1", "2", "3", "4", "5"]
    run = load_run("run")
    assert _cells_of(out, "fog")[4:] == [f"{run.mean('epe', 'fog', level):.2f}" for level in range(1, 6)]
    assert _cells_of(out, "fog")[3] == f"{run.mean('rcre', 'fog'):.2f}"
    lines = [line.rstrip() for line in out.splitlines()]
    assert [line for line in shown[:-2] if line not in lines] == []  # the last two are means over all 20


@pytest.mark.slow
def test_the_first_command_prints_what_the_readme_shows(robustflow, monkeypatch):
    monkeypatch.setattr(skimage, "__file__", WHOLE_DEMO)
    out = robustflow.prints("run", "--model", "dis", "-o", "run", "--no-examples")
    printed = iter(line.rstrip() for line in out.splitlines())
    assert [line for line in _table_of_readme() if line not in printed] == []  # in this order


class _Named(ZeroFlow):
    def identity(self):
        return {"name": "[/red][b]\u202e\x1b[3m"}


def test_names_with_markup_or_control_characters_are_shown_as_text(robustflow):
    run = rf.evaluate(_Named(), "demo", output="r[/blue]", corruptions=["contrast"], severities=[1], examples=False)
    code, out, err = robustflow("report", run.path)
    assert (code, err) == (0, "")
    assert "[/red][b]\ufffd\ufffd[3m" in out
    assert "r[/blue]" in out
    error = robustflow.refuses("run", "--model", "no\x1b[31m\u202esuch")
    assert not {"\x1b", "\u202e"} & set(error)


def test_progress_shows_control_characters_of_names_as_text(robustflow):
    for path in write_frames(Path("frames")):
        path.rename(path.with_stem(f"{path.stem}\x1b[31m"))
    command = "run -m dis -d frames -c contrast -s 1 --no-examples"
    code, out, error = robustflow(*command.split(), "-o", "made\x1b[31m")
    assert code == 0
    assert "last 000\ufffd[31m " in error
    assert "report: made\ufffd[31m/report.html" in out
    assert "\x1b" not in out + error


def test_model_that_returns_only_nan_has_no_result(robustflow, tmp_path):
    source = "import numpy as np\ndef flow(a, b): return np.full((*a.shape[:2], 2), np.nan, np.float32)\n"
    (tmp_path / "not_a_number.py").write_text(source)
    with pytest.warns(UserWarning, match="runs/demo_not_a_number"):
        out = robustflow.prints("run", "-m", "not_a_number:flow", "-c", "contrast", "-s", "1", "--allow-invalid")
    assert ": 2\n" in out, "the rows without a valid pixel"


def test_models_on_an_own_clip_show_the_clean_motion_and_no_column_of_dashes(robustflow, tmp_path):
    write_frames(tmp_path / "clip", [(64, 96)] * 3)
    few = ("-d", tmp_path / "clip", "-b", "folder", "-c", "contrast", "-s", "1", "--no-examples")
    out = robustflow.prints("run", "-m", "dis", "-m", "farneback", "-o", "both", *few)
    alone, table = out.split("\nMeans\n")
    photometric = ["clean photometric error (grey levels)", "of zero flow"]
    assert json.loads(Path("both/dis/summary.json").read_text())["epe_clean"] is None
    assert _cells_of(table, "Model") == ["RCRE (px)", "clean flow (px)", *photometric]
    runs = {name: load_run(f"both/{name.lower()}") for name in ("DIS", "Farneback")}
    lengths = [run.mean("flow_length", "clean") for run in runs.values()]
    for name, run in runs.items():
        clean = [run.mean(measure, "clean") for measure in ("flow_length", "photometric", "photometric_still")]
        assert _cells_of(table, name)[1:] == [f"{value:.2f}" for value in clean]
    assert all(f"clean flow {length:.2f} px" in alone for length in lengths)
    assert "robustflow compare" not in out


@pytest.fixture
def walk(tmp_path):
    """A video of an image that shifts from frame to frame."""
    return clips.clip(tmp_path / "walk.mp4", 8).path


def test_a_corruption_of_clips_names_the_command_that_makes_it_for_this_video(robustflow, walk):
    error = robustflow.refuses("run", "-m", "dis", "-d", walk, "-c", "fog,h264_crf", "-s", 1, "-o", "run")
    assert error.startswith("robustflow: h264_crf: ")
    assert str(walk) in error
    assert not Path("run").exists()


def test_gallery_shows_an_own_corruption(robustflow, walk, tmp_path, monkeypatch):
    (tmp_path / "my_dusk.py").write_text(
        "class Dusk:\n    def draw(self, rng, severity, shape):\n        return 2 * severity\n"
        "    def apply(self, frame, state, index):\n        return frame // state\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    frames = write_frames(tmp_path / "pair")
    for source in (("--frames", *frames), ("--clip", walk, "--length", 2)):
        robustflow.prints("gallery", *source, "-c", "my_dusk:Dusk,contrast", "-o", "gallery")
        assert "Dusk" in Path("gallery/gallery.html").read_text()


def test_corrupt_writes_the_frames_of_the_library(robustflow, tmp_path):
    first, second = write_frames(tmp_path)
    out = robustflow.prints("corrupt", first, second, "-c", "impulse_noise", "-s", "2,4", "--seed", 3, "-o", "out")
    assert out.split() == ["out/impulse_noise_2", "out/impulse_noise_4"]
    frames = [cv2.imread(str(path))[..., ::-1].copy() for path in (first, second)]
    expected = rf.corrupt(*frames, "impulse_noise", 4, seed=3, key=first.stem)
    for path, frame in zip((first, second), expected, strict=True):
        np.testing.assert_array_equal(cv2.imread(f"out/impulse_noise_4/{path.name}")[..., ::-1], frame)


def test_seeds_of_a_still_run_are_draws_in_one_folder(robustflow, tmp_path):
    write_frames(tmp_path / "frames")
    command = ("run", "-m", "farneback", "--data", "frames", "--still", "-c", "contrast,impulse_noise", "-s", "2")
    out = robustflow.prints(*command, "--seeds", "2", "-o", "run", "--no-examples")
    assert Path("run/manifest.json").is_file()
    place = _cells_of(out, "Corruption").index("spread")
    cells = {name: _cells_of(out, name)[place] for name in ("contrast", "impulse_noise")}
    assert cells["contrast"] == "0.00", "it draws nothing"
    assert float(cells["impulse_noise"]) > 0


def test_corrupt_check_names_what_this_machine_computes_differently_and_fails(robustflow, monkeypatch):
    from robustflow.corruptions import machine_check
    from robustflow.data.video import machine_check as clips

    monkeypatch.setattr(machine_check, "CHECKED", ("contrast", "pixelate"))
    monkeypatch.setattr(clips, "compare_with_package", lambda: [("bit_error", "")])
    assert robustflow.prints("corrupt", "--check") == "3 of 3 corruptions match the reference bytes on this machine\n"
    monkeypatch.setattr(clips, "compare_with_package", lambda: [("bit_error", "different bytes at severity 5")])
    code, out, _ = robustflow("corrupt", "--check")
    assert (code, out.splitlines()[0]) == (1, "bit_error: different bytes at severity 5")
    monkeypatch.setattr(clips, "compare_with_package", list)
    # contrast and pixelate have no random parameter
    monkeypatch.setattr(machine_check, "_SEED", machine_check._SEED + 1)
    robustflow.prints("corrupt", "--check")
    monkeypatch.setattr(machine_check, "_SHIFT", (2, 6))
    code, out, _ = robustflow("corrupt", "--check")
    assert (code, out.splitlines()[0]) == (1, "contrast: different bytes at severity 1, 3, 5")


def test_corrupt_check_of_a_new_corruption_says_that_no_bytes_are_stored_and_fails(robustflow, monkeypatch):
    from robustflow.corruptions import machine_check
    from robustflow.data.video import machine_check as clips

    Path("digests.json").write_text("{}")
    monkeypatch.setattr(machine_check, "DIGESTS", Path("digests.json"))
    monkeypatch.setattr(machine_check, "CHECKED", ("contrast",))
    monkeypatch.setattr(clips, "compare_with_package", list)
    code, out, _ = robustflow("corrupt", "--check")
    assert code == 1
    assert re.match("contrast: .*tests.rewrite.*\n0 of 1 ", out)


def test_a_run_that_cannot_be_written_is_shown_with_a_warning(robustflow, runs, monkeypatch):
    shutil.copytree(runs[0], "run")
    Path("run/summary.json").unlink()

    def refuse(path, data):
        raise DataError(path, "cannot be written")

    monkeypatch.setattr("robustflow.run.trust.write_bytes", refuse)
    with pytest.warns(UserWarning, match="run/summary.json"):
        out = robustflow.prints("report", "run")
    assert "clean EPE" in out
    assert "report:" not in out


def test_corrupt_and_gallery_take_the_users_depth_maps(robustflow, tmp_path):
    first, second = write_frames(tmp_path / "in")
    corrupt = ("corrupt", first, second, "-c", "fog_3d", "-s", "5")
    robustflow.refuses(*corrupt)
    (tmp_path / "maps").mkdir()
    for name, metres in (("000", 1), ("001", 5000)):
        np.save(tmp_path / "maps" / f"{name}.npy", np.full((64, 96), metres, np.float32))
    robustflow.prints(*corrupt, "--depth", "maps", "-o", "out")
    fogged = [cv2.imread(str(tmp_path / "out" / "fog_3d_5" / f"{name}.png")) for name in ("000", "001")]
    assert fogged[0].std() > 60
    assert len(np.unique(fogged[1].reshape(-1, 3), axis=0)) == 1

    shown = ["gallery", "--frames", first, second, "-c", "fog_3d"]
    robustflow.refuses(*shown)
    robustflow.prints(*shown, "--depth", "maps", "--focal", "90", "-o", "shown")
    page = (tmp_path / "shown" / "gallery.html").read_text()
    assert "1 m (white) to 1 m" in page
    assert "no corruption" not in page
