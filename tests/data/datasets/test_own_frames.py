"""Test which pairs are read from a user's own frames: films and independent pairs, gaps, cuts and repeated frames."""

import warnings
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pytest

import robustflow as rf
from robustflow.core.errors import DataError, UsageError
from robustflow.data.benchmarks import load_benchmark
from robustflow.data.datasets import load_dataset
from robustflow.data.datasets.continuity import MATCH, NO_MATCH, match, sketch_of
from robustflow.data.datasets.frame_names import films_of, without_maps
from robustflow.data.video.reader import VideoReader
from robustflow.media.images import images_in, read_image
from robustflow.report.gallery.cells import ClipPart
from robustflow.run.setup import open_benchmark
from tests.command_line import CommandLine
from tests.data.video.videos import video
from tests.refusals import refusal

SIZE, SPEED = (48, 96), 3


def view(scene: int, time: float = 0) -> np.ndarray:
    """Return a frame of a scene that moves by `SPEED` pixels per unit of time."""
    noise = np.random.default_rng(scene).integers(0, 256, (SIZE[0], 4 * SIZE[1], 3), dtype=np.uint8)
    smooth = cv2.normalize(cv2.GaussianBlur(noise, (0, 0), 2), None, 0, 255, cv2.NORM_MINMAX)
    left = round(SPEED * time)
    return np.ascontiguousarray(smooth[:, left : left + SIZE[1]])


def frames(folder: Path, names: dict[str, tuple[int, float]]) -> Path:
    """Write frames by name, each of a scene at a time."""
    for name, (scene, time) in names.items():
        path = folder / f"{name}.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        assert cv2.imwrite(str(path), view(scene, time)[..., ::-1])
    return folder


def read(folder: Path, **options: object) -> tuple[list[tuple[str, str]], list[str]]:
    """Return the names of the frames of each pair in a folder, and the warnings."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        dataset = load_dataset("folder", folder, **options)
    pairs = [dataset.pair(sample.key).frames for sample in dataset]
    names = [tuple(path.relative_to(folder).with_suffix("").as_posix() for path in pair) for pair in pairs]
    return names, [str(each.message) for each in caught]


def couples(*patterns: str, scenes: range = range(1, 4)) -> dict[str, tuple[int, float]]:
    return {pattern.format(s=s): (s, time) for s in scenes for time, pattern in enumerate(patterns)}


INDEPENDENT = {
    "KITTI": ("{s:06}_10", "{s:06}_11"),
    "FlyingChairs": ("{s:05}_img1", "{s:05}_img2"),
    "Middlebury in one folder": ("scene{s}_frame10", "scene{s}_frame11"),
    "left and right": ("{s:04}_left", "{s:04}_right"),
    "L and R": ("{s:04}L", "{s:04}R"),
    "a and b": ("{s}_a", "{s}_b"),
    "even and odd": ("x{s}_even", "x{s}_odd"),
    "words before numbers": ("left_{s:02}", "right_{s:02}"),
    "folders left and right": ("left/{s:02}", "right/{s:02}"),
    "folders im0 and im1": ("im0/{s:02}", "im1/{s:02}"),
    "numbers with gaps": ("{s}0", "{s}1"),
}


@pytest.mark.parametrize("patterns", INDEPENDENT.values(), ids=INDEPENDENT)
def test_independent_pairs_are_recognised_by_their_names(tmp_path: Path, patterns: tuple[str, str]) -> None:
    folder = frames(tmp_path / "data", couples(*patterns))
    real = [tuple(pattern.format(s=s) for pattern in patterns) for s in range(1, 4)]
    pairs, notices = read(folder)
    assert pairs == real
    assert len(notices) == 1
    dataset = load_dataset("folder", folder)
    assert len({sample.group for sample in dataset}) == 3, "independent in statistics"
    assert len(read(folder, pairs="consecutive", gaps="keep")[0]) == (4 if "/" in patterns[0] else 5)
    refusal(lambda: load_dataset("folder", folder, step=2), UsageError, "step")


def film(pattern: str, numbers: list[float], scene: int = 1) -> dict[str, tuple[int, float]]:
    return {pattern.format(n=number): (scene, place) for place, number in enumerate(numbers)}


FILMS = {
    "one scene of KITTI's multi-view extension": (film("000000_{n:02}", [*range(21)]), 20, 0),
    "scenes of KITTI's multi-view extension": (
        film("000000_{n:02}", [*range(9)]) | film("000001_{n:02}", [*range(9)], 2), 16, 1),
    "Sintel": (film("alley_1/frame_{n:04}", [1, 2, 3]) | film("alley_2/frame_{n:04}", [1, 2, 3], 2), 4, 0),
    "stereo films": (film("left/{n:04}", [1, 2, 3]) | film("right/{n:04}", [1, 2, 3]), 4, 0),
    "two frames in each folder": (couples("scene{s}/frame10", "scene{s}/frame11"), 3, 0),
    "names without numbers": ({name: (1, time) for time, name in enumerate(("ant", "bee", "cow"))}, 2, 0),
    "every fifth frame": (film("{n}", [0, 5, 10, 15]), 3, 0),
    "beside masks, depth maps and labels": (
        film("images/{n}", [1, 2, 3]) | film("masks/{n}", [1, 2, 3], 2) | film("depth/{n}", [1, 2], 3), 2, 1),
    "with masks in the same folder": (film("{n}", [1, 2, 3]) | film("{n}_mask", [1, 2, 3], 2), 2, 1),
    "maps alone": (film("depth/{n}", [1, 2, 3]), 2, 0),
    "numbered pairs of scenes": (couples("{s}0", "{s}1") | {"40": (4, 0), "41": (4, 1)}, 4, 1),
}  # fmt: skip


@pytest.mark.parametrize(("names", "count", "notices"), FILMS.values(), ids=FILMS)
def test_films_and_maps_are_recognised(tmp_path: Path, names: dict, count: int, notices: int) -> None:
    pairs, messages = read(frames(tmp_path, names))
    assert (len(pairs), len(messages)) == (count, notices)
    assert all(names[first][0] == names[second][0] for first, second in pairs)


def test_consecutive_numbers_are_pairs_where_only_every_second_link_matches(tmp_path: Path) -> None:
    scenes = frames(tmp_path / "pairs", {f"{number:03}": (number // 2, number % 2) for number in range(8)})
    assert read(scenes)[0] == [("000", "001"), ("002", "003"), ("004", "005"), ("006", "007")]
    assert not read(frames(tmp_path / "film", film("{n:03}", [*range(8)])))[1]


def test_the_user_states_the_pairs(tmp_path: Path) -> None:
    numbered = frames(tmp_path / "film", film("{n}", [1, 2, 3, 4]))
    assert read(numbered, pairs="disjoint") == ([("1", "2"), ("3", "4")], [])
    refusal(lambda: load_dataset("folder", numbered, pairs="names"), UsageError, "pairs")
    refusal(lambda: load_dataset("folder", numbered, pairs="odd"), UsageError, "pairs")
    refusal(lambda: load_dataset("folder", numbered, gaps="no"), UsageError, "gaps")
    odd = frames(tmp_path / "odd", film("{n}", [1, 2, 3]))
    refusal(lambda: load_dataset("folder", odd, pairs="disjoint"), UsageError, "pairs")
    clip = video(tmp_path / "a.mp4", [view(1, time) for time in range(4)])
    refusal(lambda: load_dataset("folder", clip, pairs="names"), UsageError, "pairs")
    stereo = frames(tmp_path / "stereo", film("left/{n}", [1, 2]) | {"right/1": (1, 2), "right/2": (1, 3)})
    assert read(stereo, pairs="names")[0] == [("left/1", "right/1"), ("left/2", "right/2")]


def test_a_range_of_frames_selects_whole_pairs(tmp_path: Path) -> None:
    folder = frames(tmp_path, couples("{s}_10", "{s}_11"))
    assert read(folder, start=1, stop=5)[0] == [("2_10", "2_11")]
    refusal(lambda: load_dataset("folder", folder, start=5), DataError, folder)


def test_pairs_of_frames_of_different_sizes_are_read_if_independent(tmp_path: Path) -> None:
    folder = frames(tmp_path, couples("{s}_10", "{s}_11"))
    for name in ("1_10", "1_11"):
        cv2.imwrite(str(folder / f"{name}.png"), cv2.imread(str(folder / f"{name}.png"))[:40])
    assert len(read(folder)[0]) == 3


GAPS = {
    "numbers": (film("f{n:04}", [1, 2, 3, 13, 14, 15]), 4),
    "numbers, in steps": (film("f{n:04}", [0, 10, 20, 40, 50]), 3),
    "numbers without order": (film("id{n}", [5, 812, 90114, 7000021]), 3),
    "milliseconds": (film("{n}", [0, 33, 67, 100, 167, 200]), 4),
    "microseconds": (film("{n}", [33333 * n for n in (0, 1, 2, 3, 6, 7)]), 4),
    "nanoseconds": (film("{n}", [1403636579763555584 + 50000000 * n for n in (0, 1, 2, 4, 5)]), 3),
    "seconds": (film("{n:.6f}", [n / 30 for n in range(40) if n != 30]), 37),
    "seconds as Python writes them": (film("{n}", [round(1551915398 + n / 30, 6) for n in (0, 1, 2, 3, 6, 7)]), 4),
    "seconds and nanoseconds": (film("1305031102_{n}", [1000, 33000000, 66000000, 900000000, 933000000]), 3),
    "dates": (film("IMG_20240131_2359{n}", [57, 58, 59]) | film("IMG_20240201_0000{n:02}", [0, 2, 3]), 4),
    "other frame rate": (film("{n}", [0, 33, 67, 100, 117, 133]), 3),
    "a cut": ({f"{n}": (n // 3, n) for n in range(9)}, 6),
    "a cut after the first frame": ({f"{n}": (min(n, 1), n) for n in range(5)}, 3),
    "a repeated frame": ({f"{n}": (1, n - (n > 2)) for n in range(6)}, 4),
    "none": (film("f{n}", [1, 2, 3, 4]), 3),
}


@pytest.mark.parametrize(("names", "count"), GAPS.values(), ids=GAPS)
def test_pairs_across_gaps_cuts_and_repeated_frames_are_left_out(tmp_path: Path, names: dict, count: int) -> None:
    folder = frames(tmp_path, names)
    pairs, notices = read(folder)
    every, none = read(folder, gaps="keep")
    assert (len(pairs), len(every), none) == (count, len(names) - 1, [])
    assert len(notices) == (count < len(every))
    assert set(pairs) <= set(every)


def test_a_pair_two_frames_apart_is_left_out_if_a_frame_between_is_missing(tmp_path: Path) -> None:
    folder = frames(tmp_path, film("{n}", [1, 2, 3, 4, 6, 7, 8, 9]))
    assert read(folder, step=2)[0] == [("1", "3"), ("2", "4"), ("6", "8"), ("7", "9")]


def test_names_that_are_times_sort_as_times(tmp_path: Path) -> None:
    for names in (
        ["1551915398.175304", "1551915398.2", "1551915398.2249", "1551915398.25"],
        [f"{n / 8}" for n in range(20)],
        [f"{n / 2:g}" for n in range(9)],
        [f"shot1.{n}" for n in range(1, 13)],
        [f"run2_{round(n / 30, 4)}" for n in range(40)],
        [f"{1305031102 + n // 10}.{n % 10 * 10**8 + 5}" for n in range(25)],
        [f"{33333 * n}" for n in range(40)],
    ):
        folder = tmp_path / names[1]
        frames(folder, {name: (1, place) for place, name in enumerate(names)})
        assert [path.stem for path in images_in(folder)] == names
        assert [path.stem for (film,) in [films_of(images_in(folder))] for path in film.frames] == names


def test_a_pair_of_different_scenes_is_named(tmp_path: Path) -> None:
    folder = frames(tmp_path / "pairs", couples("{s}_10", "{s}_11") | {"2_11": (9, 0)})
    pairs, (notice,) = read(folder)
    assert len(pairs) == 3
    assert "2_10" in notice
    photos = frames(tmp_path / "photos", {f"{n}": (n, 0) for n in range(5)})
    assert "0, 1, 2" in read(photos)[1][0]


@pytest.mark.parametrize(
    ("times", "scenes", "kept"),
    [
        ([0, 1, 2, 30, 31, 32], [1] * 6, [0, 1, 3, 4]),
        ([0, 2, 4, 5, 6, 7, 8], [1] * 7, [2, 3, 4, 5]),
        ([0, 1, 2, 3, 4, 5], [1, 1, 1, 2, 2, 2], [0, 1, 3, 4]),
        ([0, 1, 2, 3], [1] * 4, [0, 1, 2]),
    ],
    ids=["gap", "variable frame rate", "cut", "none"],
)
def test_videos_are_read_like_folders(tmp_path: Path, times: list[int], scenes: list[int], kept: list[int]) -> None:
    images = [view(scene, time) for scene, time in zip(scenes, times, strict=True)]
    clip = video(tmp_path / "a.mp4", images, times=times)
    dataset = load_dataset("folder", clip)
    assert dataset.keys() == [f"{index:06}" for index in kept]
    assert len(load_dataset("folder", clip, gaps="keep").keys()) == len(times) - 1
    first = dataset.around(dataset.keys()[0], 9)
    assert first == range(3 if 2 in np.diff(kept) else first.stop), "no window across a gap or a cut"


def test_a_repeated_frame_of_a_video_is_left_out(tmp_path: Path) -> None:
    images = [view(1, time) for time in (0, 1, 1, 2, 3)]
    clip = video(tmp_path / "a.mkv", images, codec="ffv1", pixels="bgr0")
    assert load_dataset("folder", clip).keys() == ["000000", "000002", "000003"]


def test_commands_read_frames_alike(robustflow: CommandLine, tmp_path: Path) -> None:
    """Pairs of three scenes, as films of a gap, a cut and a repeated frame are read by `load_dataset`."""
    folder = frames(tmp_path / "film", film("{n}", [1, 2, 3, 9, 10]) | {"11": (2, 0), "12": (2, 1), "13": (2, 1)})
    pairs, (notice,) = read(folder)
    assert pairs == [("1", "2"), ("2", "3"), ("9", "10"), ("11", "12")]
    counts = "1 pair across a gap", "1 pair across a repeated frame", "1 pair across a cut"
    assert all(count in notice for count in counts)
    robustflow.prints("predict", "--model", "farneback", folder, "-o", tmp_path / "flows", "--no-pictures")
    assert sorted(path.stem for path in (tmp_path / "flows").iterdir()) == ["1", "11", "2", "9"]
    chosen = ("--data", folder, "--corruptions", "contrast", "--severities", 1)
    robustflow.prints("export", "folder", *chosen, "-o", tmp_path / "out")
    assert len(list((tmp_path / "out" / "clean" / "val" / "image_2").iterdir())) == 8
    result = rf.evaluate("farneback", "folder", folder, tmp_path / "run", corruptions="contrast", severities=1)
    assert sorted(result.manifest.samples) == ["1", "11", "2", "9"]
    kept = rf.evaluate("farneback", "folder", folder, tmp_path / "keep", corruptions="contrast", severities=1,
                       data_options={"gaps": "keep"})  # fmt: skip
    assert len(kept.manifest.samples) == 7
    assert kept.manifest.identity.frames.protocol == {"options": {"gaps": "keep"}}
    assert ClipPart(folder, start="0").count == 3, "a clip ends at a gap"


def test_nothing_is_left_out_of_still_scenes_and_benchmarks(tmp_path: Path) -> None:
    folder = frames(tmp_path / "a", couples("{s}_10", "{s}_11") | {"3_11": (3, 0)})
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        still = open_benchmark("folder", folder, still=True).narrowed(limit=9)
        assert len(still.keys) == 6
        assert "options" not in still.protocol
        assert load_benchmark("demo").narrowed(limit=1).keys


def test_what_was_recognised_is_part_of_the_identity(tmp_path: Path) -> None:
    folder = frames(tmp_path / "pairs", couples("{s}_10", "{s}_11"))
    options = [load_benchmark("folder", folder, options=given).protocol for given in ({}, {"pairs": "names"})]
    assert options == [{"options": {"pairs": "names"}}] * 2
    assert load_benchmark("folder", frames(tmp_path / "film", film("{n}", [1, 2, 4]))).protocol == {}


def test_a_limit_compares_only_the_chosen_pairs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[Path] = []
    monkeypatch.setattr(
        "robustflow.data.datasets.own_frames.read_image", lambda path: seen.append(path) or read_image(path)
    )
    benchmark = load_benchmark("folder", frames(tmp_path, film("{n:02}", [*range(20)])))
    assert len(benchmark.narrowed(limit=2).keys) == 2
    assert len(seen) <= 8


def test_no_pair_left_is_an_error(tmp_path: Path) -> None:
    folder = frames(tmp_path, {"1": (1, 0), "2": (1, 0), "3": (1, 0)})
    refusal(lambda: load_dataset("folder", folder), DataError, folder)
    assert len(read(folder, gaps="keep")[0]) == 2


def test_cuts_and_motion_of_real_footage_are_far_apart(shared) -> None:
    """Five cuts of a film; a handheld camera at four times its speed; KITTI's pairs at 10 Hz."""
    reader = VideoReader(shared("data", "video", "bikes.mp4"))
    cuts = [match(sketch_of(reader.frame, at), sketch_of(reader.frame, at + 1)) for at in (29, 75, 136, 186, 241)]
    assert max(cuts) < NO_MATCH / 2
    sketches = [[sketch_of(reader.frame, at) for at in range(110, 130)]]
    reader = VideoReader(shared("data", "video", "handheld_video-10.m4v"))
    sketches.append([sketch_of(reader.frame, at) for at in range(0, 80, 4)])
    folder = shared("data", "kitti2012", "training", "image_0")
    sketches += [[sketch_of(read_image, path) for path in images_in(folder)[at : at + 2]] for at in (0, 2, 4, 6)]
    motion = [match(a, b) for film in sketches for a, b in pairwise(film)]
    assert min(motion) > MATCH
    kitti, maps = without_maps({"": images_in(folder)})
    assert (len(films_of(kitti[""])), maps) == (4, [])
