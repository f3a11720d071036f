"""Preparing clips produces reproducible files and rejects invalid input."""

import hashlib
import json
import re
import shutil
from copy import copy
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from threading import Event, Thread

import pytest

from robustflow.core.errors import DataError, UsageError
from robustflow.core.files import sealed
from robustflow.corruptions.registry import CLIP
from robustflow.data.video import prepare as prepare_module
from robustflow.data.video import prepare_folder as prepare_folder_module
from robustflow.data.video import prepared as prepared_module
from robustflow.data.video.clip import read_pictures
from robustflow.data.video.codec import i420_to_rgb, rgb_to_i420
from robustflow.data.video.interpolation import FlowInterpolator, interpolate
from robustflow.data.video.open_clip import OpenClip
from robustflow.data.video.prepare import Preparation, clip_timing, prepare_clip
from robustflow.data.video.prepare_folder import (
    SEQUENCES,
    check_room,
    estimate_disk,
    find_sources,
    prepare_folder,
    prepare_video,
)
from robustflow.data.video.prepared import VERSION, FolderCache, PreparedClip, choose_key_frames, read_folder
from robustflow.data.video.source import PictureFolder
from robustflow.media.images import read_image
from tests.refusals import refusal

from . import clips

FLOW = Preparation(fps=Fraction(240), interpolator="flow", preset="ultrafast")
PLAIN = Preparation(fps=Fraction(240), factor=1, step=16, preset="ultrafast")


def contents(folder: Path) -> dict[str, str]:
    files = (path for path in sorted(folder.rglob("*")) if path.is_file())
    return {str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


@pytest.fixture(scope="module")
def source(tmp_path_factory) -> PictureFolder:
    return PictureFolder(clips.folder(tmp_path_factory.mktemp("source") / "seq", 36))


@pytest.fixture(scope="module")
def long_source(tmp_path_factory) -> PictureFolder:
    return PictureFolder(clips.folder(tmp_path_factory.mktemp("source") / "seq", 70))


@pytest.fixture(scope="module")
def uninterrupted(source, tmp_path_factory) -> PreparedClip:
    return prepare_clip(source, tmp_path_factory.mktemp("uninterrupted") / "out", FLOW)


def test_the_master_holds_the_interpolated_frames_and_the_key_frames_are_its(source, uninterrupted):
    clip = uninterrupted
    assert (clip.manifest.fps, clip.manifest.step, clip.manifest.count) == ("960", 32, 133)
    assert clip.manifest.key_frames == [32, 64, 96]
    assert clip.pairs == [(32, 64), (64, 96)]
    expected = [rgb_to_i420(frame) for frame in interpolate(source.frames(), FlowInterpolator(), 4)]
    master = [picture for _, picture in read_pictures(clip.master)]
    assert len(master) == len(expected) == 133
    assert all((a == b).all() for a, b in zip(master, expected, strict=True))
    for index in clip.manifest.key_frames:
        assert (read_image(clip.key_frame_path(index)) == i420_to_rgb(master[index], 48, 64)).all()
    assert {path.name for path in clip.folder.iterdir()} == {"clip.json", "master.mp4", "keyframes"}


def test_odd_sizes_are_padded_and_cropped_back(tmp_path):
    clip = prepare_clip(PictureFolder(clips.folder(tmp_path / "seq", 70, 37, 51)), tmp_path / "out", PLAIN)
    assert clip.manifest.padded_to_even
    assert read_image(clip.key_frame_path(16)).shape == (37, 51, 3)


def test_a_stopped_run_continues_in_segments_of_any_length_and_ends_in_the_same_files(
    source, uninterrupted, tmp_path, monkeypatch
):
    monkeypatch.setattr(prepare_module, "SEGMENT", 8)
    made: list[int] = []
    between = FlowInterpolator.between

    def counting(self, window, factor):
        made.append(1)
        return between(self, window, factor)

    monkeypatch.setattr(FlowInterpolator, "between", counting)

    def stop(clip, what, done, total):
        if (what, done) in (("interpolate", 16), ("encode", 50)):
            stops.append(done)
            if len(stops) in (1, 2):
                raise KeyboardInterrupt

    stops: list[int] = []
    for _ in range(2):
        with pytest.raises(KeyboardInterrupt):
            prepare_clip(source, tmp_path / "stopped", FLOW, stop)
        assert not (tmp_path / "stopped" / "clip.json").exists()
    prepare_clip(source, tmp_path / "stopped", FLOW)
    assert len(made) == 33  # over all three calls, every gap is interpolated once
    assert contents(tmp_path / "stopped") == contents(uninterrupted.folder)
    made.clear()
    prepare_clip(source, tmp_path / "stopped", FLOW)
    assert made == []


def test_a_segment_damaged_between_stop_and_continuation_is_made_again(source, uninterrupted, tmp_path, monkeypatch):
    monkeypatch.setattr(prepare_module, "SEGMENT", 8)

    def stop(clip, what, done, total):
        if what == "encode":
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        prepare_clip(source, tmp_path / "stopped", FLOW, stop)
    for segment in (tmp_path / "stopped").glob(".segments-*/*.mp4"):
        data = bytearray(segment.read_bytes())
        data[len(data) // 2] ^= 4
        segment.write_bytes(data)
    prepare_clip(source, tmp_path / "stopped", FLOW)
    assert contents(tmp_path / "stopped") == contents(uninterrupted.folder)


def test_a_clip_prepared_twice_at_the_same_time_is_made_once(long_source, tmp_path):
    began, second, finished = Event(), Event(), []

    def first_frame(clip: str, what: str, done: int, total: int) -> None:
        if not began.is_set():
            began.set()
            second.wait(0.3)  # without a lock, the second call replaces the file under the first

    def first() -> None:
        finished.append(prepare_clip(long_source, tmp_path / "out", PLAIN, first_frame).manifest)

    thread = Thread(target=first)
    thread.start()
    assert began.wait(30)
    later = prepare_clip(long_source, tmp_path / "out", PLAIN, lambda clip, what, done, total: finished.append("again"))
    second.set()
    thread.join()
    assert finished == [later.manifest]


def test_prepared_files_do_not_depend_on_the_number_of_workers(tmp_path):
    clips.folder(tmp_path / "data" / "one", 70)
    clips.folder(tmp_path / "data" / "two", 70, 32, 48)
    sources = find_sources(tmp_path / "data")
    for workers in (1, 2):
        prepared = prepare_folder(sources, tmp_path / f"out{workers}", PLAIN, workers)
        assert [clip.name for clip in prepared] == ["one", "two"]
    assert contents(tmp_path / "out1") == contents(tmp_path / "out2")


def test_a_video_prepared_by_a_different_version_is_prepared_beside_it(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("ROBUSTFLOW_CACHE", str(tmp_path / "cache"))
    video = clips.clip(tmp_path / "walk.mp4", 40, fps=30).path
    first = prepare_video(video)
    assert capsys.readouterr().err == "walk: encode 40/40 (100 %), 0 s left\n"
    assert prepare_video(video) == first
    assert not capsys.readouterr().err
    for module in (prepare_module, prepare_folder_module, prepared_module):
        monkeypatch.setattr(module, "VERSION", VERSION + 1)
    assert len(read_folder(prepare_video(video))[1]) == 1


@pytest.mark.parametrize("stem", ["a\\b", "é" * 120, "..."])
def test_a_video_may_have_any_name(tmp_path, monkeypatch, stem):
    monkeypatch.setenv("ROBUSTFLOW_CACHE", str(tmp_path / "cache"))
    clips.clip(tmp_path / "walk.mp4", 40, fps=30).path.rename(tmp_path / f"{stem}.mp4")
    (clip,) = read_folder(prepare_video(tmp_path / f"{stem}.mp4"))[1]
    assert clip.name == {"a\\b": "a_b", "...": "clip"}.get(stem, "é" * 80)
    opened = OpenClip(clip, FolderCache(tmp_path / "variants", 10**9), dict.fromkeys(CLIP, (23,)))
    assert opened.corrupted(clip.manifest.key_frames[0], "h264_crf", 23).shape == (48, 64, 3)


def test_other_settings_other_clips_and_a_damaged_list_of_them_are_refused(long_source, tmp_path):
    prepare_folder([long_source], tmp_path, PLAIN)
    refusal(lambda: prepare_clip(long_source, tmp_path / "seq", replace(PLAIN, step=17)), DataError, tmp_path / "seq")
    other = PictureFolder(clips.folder(tmp_path / "other", 70))
    refusal(lambda: prepare_folder([other], tmp_path, PLAIN), DataError, tmp_path)
    (tmp_path / "gopro_fc.json").write_text("{}")
    refusal(lambda: prepare_folder([long_source], tmp_path, PLAIN), DataError, tmp_path / "gopro_fc.json")


@pytest.mark.parametrize(("step", "count"), [(32, 161), (96, 500), (16, 100), (5, 60)])
def test_key_frames_equal_the_description_in_the_paper(step, count):
    """Every `step`-th frame is used, except for the first and the last; the longest blur's window fits."""
    keys = choose_key_frames(count, step)
    every = list(range(0, count, step))
    assert keys == [k for k in every[1:-1] if 15 <= k <= count - 16]
    if step >= 16:
        assert keys == every[1:-1]


@pytest.mark.parametrize("factor", [1, 4])
@pytest.mark.parametrize("step", [1, 7, 15, 16, 100_000])
def test_the_shortest_clip_for_a_step_is_named_exactly(source, step, factor):
    def timing(count):
        clip = copy(source)
        clip.count = count
        return clip_timing(clip, Preparation(fps=Fraction(30), factor=factor, step=step))

    sentence = str(refusal(lambda: timing(5), DataError, source.name)).removeprefix(source.name)
    needed = int(re.findall(r"\d+", sentence)[-1])
    assert len(timing(needed).key_frames) >= 2
    refusal(lambda: timing(needed - 1), DataError, source.name)


def resized(source):
    wide = copy(source)
    wide.size = (2, 40_000)
    return wide


IMPOSSIBLE = [
    (lambda source: clip_timing(resized(source), FLOW), DataError, "frames of 40000x2"),
    (lambda source: clip_timing(source, Preparation(interpolator="flow")), UsageError, "--fps"),
    (lambda source: clip_timing(source, replace(FLOW, factor=101)), UsageError, "--factor"),
    (lambda source: clip_timing(source, replace(FLOW, step=0)), UsageError, "--step"),
]


@pytest.mark.parametrize(("call", "error", "culprit"), IMPOSSIBLE)
def test_impossible_settings_are_refused(source, call, error, culprit):
    refusal(lambda: call(source), error, culprit)


def test_five_gopro_sequences_are_found_in_the_release(tmp_path):
    for position, name in enumerate(SEQUENCES):
        clips.folder(tmp_path / ("train", "test", "")[position % 3] / name, 2)
    sources = find_sources(tmp_path)
    assert [(source.name, source.fps) for source in sources] == [(name, 240) for name in SEQUENCES]
    shutil.rmtree(tmp_path / "train" / SEQUENCES[0])
    refusal(lambda: find_sources(tmp_path), DataError, tmp_path)


def test_folders_without_the_frames_of_clips_are_refused(tmp_path):
    for name in SEQUENCES:
        clips.folder(tmp_path / "deblurring" / name / "sharp", 2)
    (tmp_path / "empty").mkdir()
    for folder, culprit in (("deblurring", f"deblurring/{SEQUENCES[0]}"), ("empty", "empty"), ("missing", "missing")):
        refusal(lambda folder=folder: find_sources(tmp_path / folder), DataError, tmp_path / culprit)


def test_disk_estimate_is_slightly_above_the_size_of_the_files(source, uninterrupted, tmp_path):
    estimate = estimate_disk([source], tmp_path / "not" / "yet", FLOW, 10**9)
    used = sum(path.stat().st_size for path in uninterrupted.folder.rglob("*") if path.is_file())
    assert 0.9 * used < estimate.kept < 2 * used
    check_room(estimate, tmp_path)
    refusal(lambda: check_room(replace(estimate, kept=10**15), tmp_path), DataError, tmp_path)


def test_unfinished_or_foreign_output_folder_is_refused(long_source, tmp_path):
    folder = tmp_path / "gopro_fc.json"
    refusal(lambda: read_folder(tmp_path), DataError, folder)
    folder.write_text(json.dumps(sealed({"version": VERSION, "clips": ["../elsewhere"]})))
    refusal(lambda: read_folder(tmp_path), DataError, folder)
    prepare_folder([long_source], tmp_path / "out", PLAIN)
    record = tmp_path / "out" / "seq" / "clip.json"
    text = record.read_text()
    record.unlink()
    refusal(lambda: read_folder(tmp_path / "out"), DataError, tmp_path / "out" / "seq")
    changes = (
        {"key_frames": "all"},
        {"fps": "1/0"},
        {"fps": "many"},
        {"width": 0},
        {"name": "../seq"},
        {"version": 99},
    )
    for broken in (text[:100], *(json.dumps(sealed(json.loads(text) | change)) for change in changes)):
        record.write_text(broken)
        refusal(lambda: read_folder(tmp_path / "out"), DataError, record)


def test_prepare_with_impossible_options_writes_nothing(long_source, tmp_path):
    short = PictureFolder(clips.folder(tmp_path / "short", 20))
    for settings, error in ((FLOW, DataError), (Preparation(fps=Fraction(240)), UsageError)):
        with pytest.raises(error):
            prepare_folder([short], tmp_path / "out", settings)
    with pytest.raises(UsageError):
        prepare_clip(long_source, tmp_path / "out" / "x", replace(PLAIN, preset="veryfst"))
    assert not (tmp_path / "out" / "gopro_fc.json").exists()
