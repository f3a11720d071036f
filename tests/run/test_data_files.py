"""Every changed byte is detected, even if the file format cannot detect it, and regardless of whether the file changed
between two calls, during a call, or after the list of digests was written. Only regular files are opened.
"""

import os
import shutil
import subprocess
import threading
from functools import partial

import pytest
from PIL import Image
from skimage import data
from typer.testing import CliRunner

import robustflow as rf
from robustflow.cli.main import app
from robustflow.core.errors import DataError, RobustFlowError, RunError
from robustflow.data.benchmarks import load_benchmark
from robustflow.data.benchmarks.export import export
from robustflow.media.images import image_size, read_image, stored_size
from robustflow.run.data_files import DIGEST_LIST, file_digests
from robustflow.testing import ZeroFlow

from ..refusals import refusal

CHOSEN = {"corruptions": ["contrast"], "severities": [1]}


def _clip(folder, count, offset=0):
    folder.mkdir(parents=True)
    for index in range(count):
        Image.fromarray(data.astronaut()[offset + index : offset + index + 64, :96]).save(folder / f"{index}.bmp")
    return folder


@pytest.fixture
def frames(tmp_path):
    return _clip(tmp_path / "frames", 2)


@pytest.fixture
def three(tmp_path):
    """Three frames form two pairs, 0 and 1."""
    return _clip(tmp_path / "frames", 3)


def flip(path):
    content = bytearray(path.read_bytes())
    content[-5] ^= 1
    path.write_bytes(bytes(content))


def _run(model, frames, output):
    return rf.evaluate(model, "folder", frames, output, **CHOSEN)


def test_runs_over_two_own_clips_are_two_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    short, long = _clip(tmp_path / "short", 3), _clip(tmp_path / "long", 9, 200)
    first, second = (rf.evaluate("dis", "folder", clip, limit=1, **CHOSEN) for clip in (short, long))
    assert list(first.manifest.samples) == ["1"]
    assert list(second.manifest.samples) == ["4"]  # without a common sample, the data do not conflict
    assert (first.path.name.split("_")[0], second.path.name.split("_")[0]) == ("folder-short", "folder-long")
    for clip, path in ((long, first.path), (short, second.path)):
        refusal(partial(rf.evaluate, "dis", "folder", clip, path, limit=1, **CHOSEN), RunError, path)
    assert list(rf.evaluate("dis", "folder", short, limit=2, **CHOSEN).manifest.samples) == ["0", "1"]


class _Changes(ZeroFlow):
    """A model that changes a file during the first prediction of its second sample."""

    def __init__(self, path, change):
        super().__init__()
        self.calls, self.path, self.change = 0, path, change

    def predict(self, frame1, frame2):
        self.calls += 1
        if self.calls == 4:
            self.change(self.path)
        return super().predict(frame1, frame2)

    def identity(self):
        return {"name": "still"}


def test_a_file_that_changes_during_a_run_is_detected_at_its_end(three, tmp_path):
    before = (three / "2.bmp").read_bytes()
    changing = partial(_run, _Changes(three / "2.bmp", flip), three, tmp_path / "run")
    refusal(changing, DataError, three / "2.bmp")
    left = rf.load_run(tmp_path / "run")
    assert set(left.rows["sample"]) == set(left.manifest.samples) == {"0"}
    assert left.manifest.finished is None
    (three / "2.bmp").write_bytes(before)
    again = _run(_Changes(three, print), three, tmp_path / "run")
    fresh = _run(_Changes(three, print), three, tmp_path / "fresh")
    assert again.rows.equals(fresh.rows)
    assert again.manifest.samples == fresh.manifest.samples


def test_a_file_that_is_written_again_with_the_same_bytes_is_no_change(three, tmp_path):
    written = []
    model = _Changes(three / "2.bmp", lambda path: written.append(path.write_bytes(path.read_bytes())))
    during = _run(model, three, tmp_path / "run")
    fresh = _run(_Changes(three, print), three, tmp_path / "fresh")
    assert written == [(three / "2.bmp").stat().st_size]
    assert during.manifest.finished is not None
    assert during.rows.equals(fresh.rows)
    assert during.manifest.samples == fresh.manifest.samples


def _digests(*arguments):
    return CliRunner().invoke(app, ["prepare", "digests", *map(str, arguments)])


def test_a_run_compares_its_files_with_the_list_beside_the_data(frames, tmp_path):
    shutil.copy(frames / "0.bmp", frames / "with blank \u00fc.bmp.txt")
    assert _digests("--data", frames).exit_code == 0
    if b2sum := shutil.which("b2sum"):
        subprocess.run([b2sum, "--check", "--quiet", DIGEST_LIST], cwd=frames, check=True)
    _run(ZeroFlow(), frames, tmp_path / "run")
    flip(frames / "1.bmp")
    refusal(partial(_run, ZeroFlow(), frames, tmp_path / "elsewhere"), DataError, frames / "1.bmp")
    checked = _digests("--data", frames)
    assert isinstance(checked.exception, DataError)
    assert "1.bmp" in str(checked.exception)
    assert _digests("--data", frames, "--overwrite").exit_code == 0
    _run(ZeroFlow(), frames, tmp_path / "elsewhere")


def test_a_second_call_checks_the_whole_data_set(frames):
    (frames / "loop").symlink_to(frames)  # a folder reached twice is listed once
    assert " 2 files" in _digests("--data", frames).output
    before = (frames / DIGEST_LIST).read_bytes()
    assert "\n2 files: no differences from" in _digests("--data", frames).output
    (frames / "0.bmp").unlink()
    checked = _digests("--data", frames)
    assert isinstance(checked.exception, DataError)
    assert "0.bmp" in str(checked.exception)
    assert (frames / DIGEST_LIST).read_bytes() == before


def test_files_that_no_list_names_are_reported_and_a_damaged_list_is_refused(three, tmp_path):
    assert _digests("--data", three).exit_code == 0
    (three / DIGEST_LIST).write_text("".join((three / DIGEST_LIST).read_text().splitlines(keepends=True)[:-1]))
    with pytest.warns(UserWarning, match=r"2\.bmp"):
        _run(ZeroFlow(), three, tmp_path / "run")
    with open(three / DIGEST_LIST, "a") as file:
        file.write("nonsense\n")
    refusal(partial(_run, ZeroFlow(), three, tmp_path / "run"), DataError, three / DIGEST_LIST)


def test_corrupted_frames_that_come_with_the_data_are_compared_too(shared, tmp_path):
    benchmark = load_benchmark("kitti-fc", shared("data/kitti2015")).narrowed(["contrast"], [1], 1)
    list(export(benchmark, tmp_path / "fc"))
    assert _digests("--data", tmp_path / "fc").exit_code == 0
    (frame, _) = sorted((tmp_path / "fc" / "contrast_1").rglob("*.png"))
    flip(frame)
    refusal(lambda: rf.evaluate(ZeroFlow(), "kitti-fc", tmp_path / "fc", tmp_path / "run"), DataError, frame)


@pytest.fixture
def pipe(tmp_path):
    """A named pipe that looks like a frame; a writer fills and closes it, so that reading it terminates."""
    path = tmp_path / "frame_0002.png"
    os.mkfifo(path)
    threading.Thread(target=path.write_bytes, args=(b"",), daemon=True).start()
    return path


@pytest.mark.parametrize("read", [lambda path: file_digests({"a": [path]}), image_size, stored_size, read_image])
def test_a_pipe_among_the_data_is_refused_unopened(pipe, read):
    with pytest.raises(RobustFlowError) as error:
        read(pipe)
    assert error.value.culprit == str(pipe)
