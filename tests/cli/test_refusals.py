"""Bad input, missing extras and full disks are reported in one line that says what to do."""

from __future__ import annotations

import errno
import io
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import cv2
import numpy as np
import pytest

from robustflow.core import plugins as extras

from .conftest import write_frames

NEEDS_TORCH = [pytest.mark.torch, pytest.mark.skipif(not find_spec("torch"), reason="needs the torch extra")]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("class Rain(:\n    pass\n", "SyntaxError: invalid syntax (mine.py, line 1): class Rain(:"),
        ("import is_not_here\n", "No module named 'is_not_here'; install is_not_here"),
        ("1 / 0\n", "ZeroDivisionError: division by zero (raised during the import)"),
    ],
)
def test_failed_import_of_a_module_is_reported_with_its_reason(robustflow, tmp_path, text, says):
    (tmp_path / "mine.py").write_text(text)
    assert says in robustflow.refuses("check", "mine:Rain")


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
    """One line names the extra; the exit code is always the same, and no folder is made."""
    monkeypatch.setattr(extras, "find_spec", lambda name: None if name == library else find_spec(name))
    monkeypatch.setitem(sys.modules, library, None)
    monkeypatch.delitem(sys.modules, "needs", raising=False)
    (tmp_path / "needs.py").write_text(f"import {library}\n")
    (tmp_path / "net.onnx").write_bytes(b"")
    (tmp_path / "train/0001/frame_left").mkdir(parents=True)
    code, out, error = robustflow(*command.split())
    assert (code, out, error.count("\n")) == (1, "", 1)
    assert f"pip install 'robustflow[{extra}]'" in error
    assert not (tmp_path / "made").exists()


def test_verify_of_an_invalid_record_is_refused_in_one_line(robustflow, tmp_path):
    (tmp_path / "text").write_text("not a zip")
    for name, why in (("nowhere", "No such file"), ("text", "not a record"), (".", "not a file")):
        code, out, _ = robustflow("record", "verify", name)
        assert code == 1
        assert out.startswith("not verified: ")
        assert why in out
        assert out.count("\n") == 1


def _truncated_png(folder: Path) -> None:
    first, _ = write_frames(folder)
    first.write_bytes(first.read_bytes()[:-2000])


def _frames_of_two_sizes(folder: Path) -> None:
    write_frames(folder, [(64, 96), (64, 98)])


def _kitti_with_8_bit_flow(folder: Path) -> None:
    write_frames(folder / "training" / "image_2")
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
        (_frames_of_two_sizes, "run -m dis -b folder -d data -c contrast", 1, "size"),
        (_kitti_with_8_bit_flow, "run -m dis -b kitti-fc -d data -c contrast", 1, "16"),
        (None, "run -m diss", 2, "did you mean 'dis'"),
        (None, "run -m dis -b kiti-fc", 2, "did you mean 'kitti-fc'"),
        (None, "run -m dis -c frosst", 2, "did you mean 'frost'"),
        (None, "run -m dis -d /nowhere.mp4", 1, "/nowhere.mp4: no such file or folder; check the path"),
        (None, "run -m dis -d /nowhere -D start=3", 1, "/nowhere: no such file or folder"),
        (lambda f: (f / "training/image_2").mkdir(parents=True), "run -m dis -d data", 2, "give --benchmark kitti-fc"),
        (lambda f: f.mkdir(), "run -m dis -d data", 1, "contains no images"),
        (
            None,
            "run -m dis -c h264_crf -s 1",
            2,
            "needs the clip from which the frames were taken: give --benchmark gopro-fc",
        ),
        (
            None,
            "run -m dis -b shapes -c rolling_shutter",
            2,
            "give --benchmark gopro-fc, which also accepts a video file; for pairs with exact ground truth, use "
            "--benchmark shapes --data-option readout=0.6 instead of the corruption",
        ),
        (write_frames, "run -m dis -d data -c fog+h264_crf -s 1", 2, "fog+h264_crf cannot be created"),
        (write_frames, "corrupt data/000.png data/001.png -c h264_crf", 2, "gallery --clip CLIP shows it"),
        (None, "run -m dis -s 0", 2, "severity 0"),
        (None, "run -m dis -s 1,6", 2, "severity 6"),
        (None, "run -m dis -s high", 2, "'high'"),
        pytest.param(None, "reproduce experiment --severities 9", 2, "severity 9", marks=NEEDS_TORCH),
        pytest.param(None, "reproduce experiment --size 7x", 2, "a size", marks=NEEDS_TORCH),
        (None, "run -m dis --variant other", 2, "default, reference, paper"),
        (None, "run -m dis -O presetfast", 2, "KEY=VALUE"),
        (None, "run -m dis --device cpu", 2, "runs on the CPU only; omit --device"),
        (None, "run -m dis --checkpoint things", 2, "has no weights to load; omit --checkpoint"),
        (None, "run -m dis --batch-size 4", 2, "one pair at a time"),
        (None, "run -m arflow -O checkpoint=a.pth --checkpoint b.pth", 2, "checkpoint is given twice"),
        (None, "run -m dis --engine cluster", 2, "engine"),
        (write_frames, "reproduce displacement folder -d data", 1, "name the model"),
        (None, "report nowhere", 1, "manifest.json"),
        (None, "list weather", 2, "models"),
        (None, "profile dis", 2 if find_spec("torch") else 1, "PyTorch"),
        (None, "corrupt -c fog", 2, "give two frames and --corruptions, or --check alone"),
        (write_frames, "corrupt data/000.png data/001.png -c fog -s 9", 2, "severity 9"),
        (write_frames, "corrupt data/000.png data/none.png -c contrast", 1, "none.png"),
        (_truncated_png, "corrupt data/000.png data/001.png -c contrast", 1, "truncated"),
        (_frames_of_two_sizes, "corrupt data/000.png data/001.png -c contrast", 1, "same size"),
        (write_frames, "corrupt data/000.png data/001.png -c fog --focal 700", 2, "--focal only applies to your own"),
        (None, "gallery -c contrast --focal 700 -o made", 2, "--focal only applies to your own depth maps"),
        (write_frames, "gallery --clip data --focal 700 -o made", 2, "apply to the depth of two frames; omit --clip"),
        (write_frames, "prepare gopro-fc -d data -o made --fps 1e12", 2, "--fps 1e12 is not a valid frame rate"),
        (write_frames, "prepare gopro-fc -d data -o made --fps 1/0", 2, "--fps 1/0 is not a valid frame rate"),
        (write_frames, "prepare gopro-fc -d data -o made --fps 240 --cache-gb nan", 2, "limited to nan GB: give 0"),
        (write_frames, "prepare gopro-fc -d data -o made --fps 240 --factor 101", 2, "must be from 1 (no"),
        (write_frames, "prepare gopro-fc -d data -o made --fps 240 --factor 0", 2, "must be from 1 (no interpolation)"),
        (write_frames, "predict data -o made --video v.mp4 --fps 0.0004", 2, "give a number from 0.01 to 1000"),
        (None, "export demo -d x", 1, "x: no such file or folder"),
        (write_frames, "export data -o made", 2, "--format"),
        (None, "run -b demo", 2, "--model"),
        (None, "run dis -m dis", 2, "twice"),
        (None, "run dis -s 5-1", 2, "5-1"),
        (None, "run dis -c motion_blur", 2, "'camera_motion_blur' or 'object_motion_blur'"),
    ],
)
def test_bad_input_is_refused_in_one_line_with_a_remedy(robustflow, tmp_path, make, arguments, code, says):
    if make:
        make(tmp_path / "data")
    output = ["-o", "run"] if arguments.startswith("run") else []
    got, _, error = robustflow(*arguments.split(), *output)
    *started, message = error.splitlines()
    assert got == code
    assert message.startswith("robustflow: ")
    assert says in message
    assert all(line.startswith("run: ") for line in started)
    assert _written() == []


def _written() -> list[Path]:
    """The files of rows, and unfinished files, in the working folder."""
    return [*Path().rglob("*.parquet"), *Path().rglob(".partial-*")]


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ("export RUN --format csv -c fog", "--corruptions has no effect with --format csv"),
        ("export RUN --format croissant --limit 3", "--limit has no effect with --format croissant"),
        ("export RUN --format croissant --hub-dataset a/b", "--hub-dataset has no effect with --format croissant"),
        ("export RUN --format robustspring -d . --seed 3", "--seed has no effect with --format robustspring"),
        ("gallery -m dis --attacks square --depth .", "--depth has no effect with --attacks alone"),
        (
            "gallery -m dis --attacks square --severity-scale calibrated",
            "--severity-scale has no effect with --attacks",
        ),
        ("export kitti-fc -d . -m dis", "--model has no effect without --format"),
        ("reproduce displacement demo -O preset=fast", "--option has no effect without --model"),
        ("record verify RUN --seed 3", "--seed has no effect without --data, --model or --check-frames"),
        ("report RUN --format page --seed 3", "--seed has no effect with --format page"),
        ("corrupt --check -c fog", "--corruptions has no effect with --check"),
        ("predict RUN --fps 3", "--fps has no effect without --video"),
        ("predict RUN --no-pictures --max-flow 3", "--max-flow has no effect without --video"),
        ("optics show --lens lens.json -s 3", "--severity has no effect with --lens"),
        ("optics render --lens lens.json -o psf.npy -s 3", "--severity has no effect with --lens"),
        ("prepare gopro-fc -d . -o made --interpolator flow --checkpoint a.pth", "--checkpoint has no effect with"),
        pytest.param("profile --paper --size 8x8", "--size has no effect with --paper", marks=pytest.mark.torch),
        pytest.param(
            "train raft --recipe ood --corrupt-probability 0.1",
            "--corrupt-probability has no effect without --corrupt",
            marks=pytest.mark.torch,
        ),
    ],
)
def test_an_option_without_effect_is_refused(robustflow, runs, arguments, says):
    error = robustflow.refuses(*arguments.replace("RUN", str(runs[0])).split())
    assert says in error
    assert error.endswith("; leave it out")
    assert _written() == []


@pytest.mark.parametrize("arguments", ["run", "run --no-such-option", "nonsense"])
def test_usage_errors_exit_with_status_2(robustflow, arguments):
    assert robustflow(*arguments.split())[0] == 2


def test_output_folder_below_a_file_is_refused(robustflow, tmp_path):
    (tmp_path / "file").write_text("in the way")
    assert "file/run" in robustflow.refuses("run", "-m", "dis", "-c", "contrast", "-o", "file/run", code=1)


def test_read_only_file_system_is_refused_in_one_line(robustflow, runs, tmp_path):
    place = tmp_path / "read-only"
    place.mkdir()
    if subprocess.run(["mount", "-t", "tmpfs", "-o", "ro", "tmpfs", str(place)], capture_output=True).returncode:
        pytest.skip("needs the right to mount a file system")
    try:
        for command in (
            ("record", "pack", "-o", place / "x.robustflow"),
            ("leaderboard", "--no-published", "-o", place),
        ):
            assert "Read-only file system" in robustflow.refuses(*command, runs[0], code=1)
    finally:
        subprocess.run(["umount", str(place)], check=True)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a device that is always full")
def test_full_disk_ends_a_run_in_one_line(robustflow, monkeypatch):
    """A genuinely full device raises its error when a shard is renamed into place."""
    import robustflow.core.files as atomic

    real = open

    def full(path, *mode):
        if str(path).endswith(".parquet") and ".partial-" in str(path):
            Path(path).symlink_to("/dev/full")
            return real(path, "wb", buffering=0)
        return real(path, *mode)

    monkeypatch.setattr(atomic, "open", full, raising=False)
    code, _, error = robustflow("run", "-m", "dis", "-c", "contrast", "-s", "1", "-o", "run")
    assert code == 1
    assert "No space left on device" in error.splitlines()[-1]
    assert _written() == []


@pytest.mark.parametrize(
    "command",
    ["run -m dis -c fog -c snow", "run -m dis --severities 1 -s 2", "optics design --severity 1 --severity 2"],
)
def test_option_given_twice_is_refused(robustflow, command):
    assert "is given 2 times" in robustflow.refuses(*command.split())


@pytest.mark.parametrize(
    ("command", "empty"),
    [
        (("run", "-m", "dis", "--data", ""), "--data"),
        (("run", "-m", "dis", "-m", "", "--output", "made"), "--model"),
        (("corrupt", "", "b.png", "-c", "fog"), "frame1"),
        (("report", ""), "runs"),
        (("gallery", "-c", ","), "--corruptions"),
        (("run", "-m", "dis", "--attacks", ", "), "--attacks"),
        (("optics", "calibrate", "-c", " "), "--corruptions"),
        (("report", "--published", "-t", ","), "--table"),
        (("reproduce", "experiment", "--severities", ","), "--severities"),
    ],
)
def test_empty_path_is_refused(robustflow, tmp_path, command, empty):
    write_frames(tmp_path)
    assert f"{empty} is empty: give a value" in robustflow.refuses(*command)
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize(
    "command",
    [
        "report X",
        "run -m dis -o X",
        "run -m dis -b folder -d X",
        "leaderboard X.csv",
        "reproduce audit X.csv",
        "corrupt a.png b.png -c fog -o X",
        "optics show -o X",
    ],
)
def test_a_home_of_an_unknown_user_is_refused(robustflow, command):
    arguments = command.replace("X", "~no-such-user/x").split()
    assert "~no-such-user/x" in (error := robustflow.refuses(*arguments, code=1))
    assert "there is no such user" in error


def test_the_home_folder_of_an_output_is_expanded(robustflow, tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    for name in ("a.png", "b.png"):
        cv2.imwrite(name, np.full((8, 8, 3), 90, np.uint8))
    robustflow.prints("corrupt", "a.png", "b.png", "-c", "contrast", "--output=~/corrupted")
    assert (tmp_path / "home" / "corrupted" / "contrast_3" / "a.png").is_file()


def test_a_name_that_is_not_utf_8_is_refused(robustflow):
    """Python reads the Latin-1 byte of an accented e as a lone surrogate, which no JSON file can contain."""
    assert "caf\ufffd is not valid UTF-8: rename" in robustflow.refuses("predict", "caf\udce9")


def test_a_terminal_with_a_small_character_set_shows_question_marks(robustflow, runs, monkeypatch):
    out = io.TextIOWrapper(io.BytesIO(), "ascii")
    monkeypatch.setattr(sys, "stdout", out)
    assert robustflow("report", runs[0])[0] == 0
    out.flush()
    assert b"contrast   ? " in out.buffer.getvalue()


class _Full(io.StringIO):
    def write(self, text):
        raise OSError(errno.ENOSPC, "No space left on device")


def test_unwritable_output_is_refused_in_one_line(robustflow, runs, monkeypatch):
    monkeypatch.setattr(sys, "stdout", _Full())
    assert "No space left on device; check" in robustflow.refuses("report", runs[0], code=1)


def test_an_option_that_is_repeatable_and_a_flag_may_be_given_twice(robustflow, tmp_path):
    robustflow(
        "run", "-m", "dis", "-m", "tiny", "-c", "contrast", "-s", "1", "--json", "--json", "-o", tmp_path / "runs"
    )
    assert len(list((tmp_path / "runs").iterdir())) == 2


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("Broken", "mine:Broken failed in its construction: OSError: no card"),
        ("Rooted", "mine:Rooted needs the option root, which check cannot pass: give it a default value"),
    ],
)
@pytest.mark.parametrize("kind", ["model", "dataset"])
def test_check_of_a_class_that_cannot_be_constructed_is_refused(robustflow, tmp_path, monkeypatch, kind, name, says):
    monkeypatch.delitem(sys.modules, "mine", raising=False)
    (tmp_path / "mine.py").write_text(
        "class Broken:\n    def __init__(self):\n        raise OSError('no card')\n\n\n"
        "class Rooted:\n    def __init__(self, root): ...\n"
    )
    assert says in robustflow.refuses("check", f"mine:{name}", "--kind", kind)
