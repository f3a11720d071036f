"""Bad input, missing extras and full disks are reported in one line: the error's class and what is at fault."""

from __future__ import annotations

import errno
import io
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import cv2
import numpy as np
import pytest

from robustflow.core import plugins as extras
from robustflow.core.errors import DataError, UsageError

from .conftest import write_frames

CASES = [
    ("run", UsageError, "--model"),
    ("run -m diss", UsageError, "diss"),
    ("run -m dis -b kiti-fc", UsageError, "kiti-fc"),
    ("run -m dis -c frosst", UsageError, "frosst"),
    ("run -m dis -s 0", UsageError, "0"),
    ("run -m dis -s high", UsageError, "high"),
    ("run dis -s 5-1", UsageError, "5-1"),
    ("run -m dis -O presetfast", UsageError, "presetfast"),
    ("run -m arflow -O checkpoint=a.pth --checkpoint b.pth", UsageError, "--checkpoint"),
    ("run -m dis --engine cluster", UsageError, "cluster"),
    ("run dis -m dis", UsageError, "--model"),
    ("run dis farneback --name x", UsageError, "--name"),
    ("run -m dis --seeds 0", UsageError, "--seeds"),
    ("run -m dis --limit 0", UsageError, "--limit"),
    ("run -m dis --severity-scale other", UsageError, "other"),
    ("run -m dis --timeout 0", UsageError, "--timeout"),
    ("run -m dis --workers 0", UsageError, "--workers"),
    ("run -m dis -d nowhere", DataError, "nowhere"),
    ("run -m dis -b kitti-fc -d nowhere", DataError, "nowhere"),
    ("run -m dis -b folder -d empty", DataError, "empty"),
    ("run -m dis -c contrast -o file/run", DataError, "file/run"),
    ("run -m dis --psf-dir nowhere", UsageError, "--psf-dir"),
    ("run -m dis -c fog -c snow", UsageError, "--corruptions"),
    ("run -m dis --data=", UsageError, "--data"),
    ("run -m dis --attacks ,", UsageError, "--attacks"),
    ("run -m dis -o ~no-such-user/x", DataError, "~no-such-user/x"),
    ("corrupt a.png b.png", UsageError, "--corruptions"),
    ("corrupt frames/000.png frames/none.png -c contrast", DataError, "frames/none.png"),
    ("corrupt odd/000.png odd/001.png -c contrast", DataError, "odd/001.png"),
    ("corrupt --check -c fog", UsageError, "--corruptions"),
    ("gallery --clip frames --focal 700", UsageError, "--focal"),
    ("corrupt frames/000.png frames/001.png -c fog_3d --depth-unit mm", UsageError, "--depth-unit"),
    ("corrupt frames/000.png frames/001.png -c fog_3d --depth frames --depth-unit feet", UsageError, "--depth-unit"),
    ("gallery --clip frames -m dis", UsageError, "--model"),
    ("gallery --start 3", UsageError, "--start"),
    ("gallery --clip frames --frames a b", UsageError, "--frames"),
    ("gallery --clip none.mp4", DataError, "none.mp4"),
    ("gallery --attacks square", UsageError, "--attacks"),
    ("gallery --still", UsageError, "--still"),
    ("gallery -m dis --still --attacks square", UsageError, "--still"),
    ("gallery -m dis --attacks square --depth .", UsageError, "--depth"),
    ("gallery -c ,", UsageError, "--corruptions"),
    ("predict frames --max-flow 0", UsageError, "--max-flow"),
    ("predict frames --video x.avi", UsageError, "--video"),
    ("predict frames --video v.mp4 --fps 0.0004", UsageError, "--fps"),
    ("predict frames --fps 3", UsageError, "--fps"),
    ("predict frames --no-pictures --max-flow 3", UsageError, "--max-flow"),
    ("export empty", UsageError, "empty"),
    ("export RUN --format xlsx", UsageError, "xlsx"),
    ("export RUN --format csv -c fog", UsageError, "--corruptions"),
    ("export RUN --format csv --hub-dataset a/b", UsageError, "--hub-dataset"),
    ("export RUN --format robustspring -d . --seed 3", UsageError, "--seed"),
    ("export RUN --format robustspring", UsageError, "--data"),
    ("export kitti-fc -d . -m dis", UsageError, "--model"),
    ("record pack RUN -o a.zip", UsageError, "a.zip"),
    ("record verify x -O preset=fast", UsageError, "preset"),
    ("record verify x --seed 3", UsageError, "--seed"),
    ("report", UsageError, "RUN"),
    ("report --published --format pdf", UsageError, "pdf"),
    ("report --published --table epes", UsageError, "epes"),
    ("report --published --table row,epe", UsageError, "--table"),
    ("report RUN --format page -t epe", UsageError, "--table"),
    ("report RUN --table epe --metric rcre", UsageError, "--metric"),
    ("report RUN --metric speed", UsageError, "speed"),
    ("report RUN -m dis", UsageError, "--model"),
    ("report RUN --examples -t epe", UsageError, "--table"),
    ("report RUN --examples -o x.png", UsageError, "--output"),
    ("report RUN --sample a", UsageError, "--sample"),
    ("report RUN file --examples", UsageError, "RUN"),
    ("report --published -t ,", UsageError, "--table"),
    ("compare RUN", UsageError, "RUN"),
    ("compare a b --metric speed", UsageError, "speed"),
    ("compare a b --format pdf", UsageError, "pdf"),
    ("compare a b --format csv --json", UsageError, "--json"),
    ("compare a b --power 0.9", UsageError, "--power"),
    ("leaderboard --no-published", UsageError, "--no-published"),
    ("leaderboard absent.csv", DataError, "absent.csv"),
    ("leaderboard a --supersede", UsageError, "--supersede"),
    ("leaderboard --add RUN", UsageError, "--add"),
    ("list weather", UsageError, "weather"),
    ("list corruptions fog", UsageError, "fog"),
    ("list models no_such", UsageError, "no_such"),
    ("check json:loads --kind thing", UsageError, "thing"),
    ("optics render --lens lens.json", UsageError, "--output"),
    ("optics render --severity 7", UsageError, "7"),
    ("optics show --severity x", UsageError, "x"),
    ("optics show --lens lens.json -s 3", UsageError, "--severity"),
    ("optics design --severity 0", UsageError, "0"),
    ("optics design --severity 1 --severity 2", UsageError, "--severity"),
    ("prepare gopro-fc -d frames -o made --fps 1e12", UsageError, "--fps"),
    ("prepare gopro-fc -d frames -o made --fps 240 --cache-gb nan", UsageError, "--cache-gb"),
    ("prepare gopro-fc -d frames -o made --interpolator flow --checkpoint a.pth", UsageError, "--checkpoint"),
    ("prepare gopro-fc -d frames -o made --fps 240 --address auto", UsageError, "--address"),
    ("prepare gopro-fc -d frames -o made --fps 240 --engine cluster", UsageError, "cluster"),
    ("prepare digests -d nowhere", DataError, "nowhere"),
    ("prepare digests -d empty", DataError, "empty"),
    ("reproduce tab99", UsageError, "tab99"),
    ("reproduce tab2 --data nowhere", UsageError, "--data"),
    ("reproduce tab2 --data empty", DataError, "empty"),
    ("reproduce displacement demo -O preset=fast", UsageError, "--option"),
    ("reproduce displacement demo --into file", UsageError, "file"),
    ("reproduce audit nowhere.csv", DataError, "nowhere.csv"),
    ("app -O preset=fast", UsageError, "preset"),
    ("app --port 70000", UsageError, "--port"),
    ("app --host 203.0.113.1", UsageError, "--host"),
    ("app --host é..b", UsageError, "--host"),
]
"""A command, its error and what is at fault. `RUN` is a run, `frames` has two images, `odd` two of unlike sizes, `file`
is a file, and `empty` an empty folder."""

TRAINING = [
    ("profile", UsageError, "--paper"),
    ("profile --paper --size 8x8", UsageError, "--size"),
    ("profile raft --repeat -1", UsageError, "--repeat"),
    ("profile raft arflow --into RUN", UsageError, "--into"),
    ("train raft --recipe ood", UsageError, "--data"),
    ("train raft --recipe odd --data .", UsageError, "odd"),
    ("train raft --recipe ood --corrupt-probability 0.1", UsageError, "--corrupt-probability"),
    ("train raft --recipe ood --data x --validate-data x", UsageError, "--validate-data"),
    ("train a:Net --like raft --recipe ood --iterations 6", UsageError, "--iterations"),
    ("train raft --recipe ood --data x --loaders -1", UsageError, "--loaders"),
]


@pytest.fixture
def places(robustflow, runs):
    """The folders and files that the cases name."""
    shutil.copytree(runs[0], "RUN")
    write_frames(Path("frames"))
    write_frames(Path("odd"), [(64, 96), (64, 98)])
    Path("file").write_text("x")
    Path("empty").mkdir()
    return robustflow


def _written() -> list[Path]:
    """The files of rows outside the run, and unfinished files, in the working folder."""
    rows = [path for path in Path().rglob("*.parquet") if path.parts[0] != "RUN"]
    return [*rows, *Path().rglob(".partial-*"), *Path().glob("runs")]


@pytest.mark.parametrize(("arguments", "error", "culprit"), CASES, ids=[case[0] for case in CASES])
def test_bad_input_is_refused_with_what_is_at_fault(places, arguments, error, culprit):
    places.refusal(arguments, error, culprit)
    assert _written() == []


@pytest.mark.torch
@pytest.mark.parametrize(("arguments", "error", "culprit"), TRAINING, ids=[case[0] for case in TRAINING])
def test_bad_input_of_training_and_profiling_is_refused(places, arguments, error, culprit):
    pytest.importorskip("torch", reason="needs the torch extra")
    places.refusal(arguments, error, culprit)


@pytest.mark.parametrize(
    ("arguments", "code"), [("report", 2), ("report nowhere", 1), ("run --none", 2), ("nonsense", 2)]
)
def test_errors_exit_with_2_for_usage_and_1_otherwise(robustflow, arguments, code):
    assert robustflow(*arguments.split())[0] == code


@pytest.mark.parametrize(
    ("library", "extra", "command"),
    [
        ("ray", "ray", "run -m dis --engine ray --output made"),
        ("onnxruntime", "onnx", "run -m net.onnx --output made"),
        ("ptlflow", "ptlflow", "run -m raft --checkpoint things --output made"),
        ("ptlflow", "ptlflow", "check needs:Net"),
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


def test_a_read_only_file_system_is_refused_in_one_line(robustflow, runs, tmp_path):
    place = tmp_path / "read-only"
    place.mkdir()
    if subprocess.run(["mount", "-t", "tmpfs", "-o", "ro", "tmpfs", str(place)], capture_output=True).returncode:
        pytest.skip("needs the right to mount a file system")
    try:
        robustflow.refuses("record", "pack", "-o", place / "x.robustflow", runs[0], code=1)
        robustflow.refuses("leaderboard", "--no-published", "-o", place, runs[0], code=1)
    finally:
        subprocess.run(["umount", str(place)], check=True)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a device that is always full")
def test_a_full_disk_ends_a_run_in_one_line(robustflow, monkeypatch):
    """A genuinely full device raises its error when a shard is renamed into place."""
    import robustflow.core.files as files

    real = open

    def full(path, *mode):
        if str(path).endswith(".parquet") and ".partial-" in str(path):
            Path(path).symlink_to("/dev/full")
            return real(path, "wb", buffering=0)
        return real(path, *mode)

    monkeypatch.setattr(files, "open", full, raising=False)
    code, _, error = robustflow("run", "-m", "dis", "-c", "contrast", "-s", "1", "-o", "run")
    assert code == 1
    assert "No space left on device" in error.splitlines()[-1]
    assert _written() == []


def test_a_home_folder_is_expanded_in_an_option(robustflow, tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    for name in ("a.png", "b.png"):
        cv2.imwrite(name, np.full((8, 8, 3), 90, np.uint8))
    robustflow.prints("corrupt", "a.png", "b.png", "-c", "contrast", "--output=~/corrupted")
    assert (tmp_path / "home" / "corrupted" / "contrast_3" / "a.png").is_file()


def test_a_name_that_is_not_utf_8_is_refused(robustflow):
    """Python reads the Latin-1 byte of an accented e as a lone surrogate, which no JSON file can contain."""
    assert "caf\ufffd" in robustflow.refuses("predict", "caf\udce9")


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
    assert "No space left on device" in robustflow.refuses("report", runs[0], code=1)


def test_a_repeatable_option_and_a_flag_may_be_given_twice(robustflow, tmp_path):
    robustflow(
        "run", "-m", "dis", "-m", "tiny", "-c", "contrast", "-s", "1", "--json", "--json", "-o", tmp_path / "runs"
    )
    assert len(list((tmp_path / "runs").iterdir())) == 2


@pytest.mark.parametrize("name", ["Broken", "Exits", "Rooted"])
@pytest.mark.parametrize("kind", ["model", "dataset"])
def test_check_of_a_class_that_cannot_be_constructed_is_refused(robustflow, tmp_path, monkeypatch, kind, name):
    monkeypatch.delitem(sys.modules, "mine", raising=False)
    (tmp_path / "mine.py").write_text(
        "class Broken:\n    def __init__(self):\n        raise OSError('no card')\n\n\n"
        "class Exits:\n    def __init__(self):\n        raise SystemExit(0)\n\n\n"
        "class Rooted:\n    def __init__(self, root): ...\n"
    )
    assert f"mine:{name}" in robustflow.refuses("check", f"mine:{name}", "--kind", kind)
