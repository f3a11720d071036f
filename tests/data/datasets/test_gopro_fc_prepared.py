"""Test GoPro-FC as a dataset: the prepared folder, the released folder, and all 24 corruptions end to end."""

import json
import shutil
from fractions import Fraction
from functools import partial
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from robustflow import evaluate
from robustflow.core.errors import DataError, UsageError
from robustflow.corruptions import CLIP, PAPER_ORDER, corrupt, load_corruption
from robustflow.data.benchmarks import load_benchmark
from robustflow.data.datasets import FromClips, PreCorrupted, load_dataset
from robustflow.data.datasets.dataset import CorruptedClips
from robustflow.data.datasets.gopro_fc import GoProFCPrepared
from robustflow.data.video.clip import ClipReader, read_pictures
from robustflow.data.video.codec import i420_to_rgb
from robustflow.data.video.open_clip import check_master
from robustflow.data.video.prepare import Preparation
from robustflow.data.video.prepare_folder import find_sources, prepare_folder
from robustflow.media.images import read_image
from tests.data.video import clips
from tests.refusals import refusal

from .layouts import picture

HEIGHT, WIDTH, COUNT = 64, 96, 36


@pytest.fixture(scope="module")
def prepared(tmp_path_factory) -> Path:
    """Two pairs of one clip rendered at 960 frames per second."""
    folder = tmp_path_factory.mktemp("gopro")
    source = clips.folder(folder / "frames" / "scene", COUNT, HEIGHT, WIDTH)
    settings = Preparation(fps=Fraction(240), interpolator="flow", preset="ultrafast")
    prepare_folder(find_sources(source), folder / "out", settings)
    return folder / "out"


def master_frames(dataset: GoProFCPrepared) -> list[np.ndarray]:
    return [i420_to_rgb(picture, HEIGHT, WIDTH) for _, picture in read_pictures(dataset.clips[0].master)]


def test_clean_pairs_are_the_masters_key_frames(prepared):
    dataset = load_dataset("gopro_fc_prepared", prepared)
    assert isinstance(dataset, PreCorrupted)
    assert isinstance(dataset, FromClips)
    assert dataset.keys() == ["scene/000032", "scene/000064"]
    frames = master_frames(dataset)
    sample = dataset.load("scene/000032")
    assert (sample.frames[0] == frames[32]).all()
    assert (sample.frames[1] == frames[64]).all()
    assert (sample.group, sample.flow) == ("scene", None)
    assert dataset.files("scene/000032") == [prepared / "scene" / "keyframes" / f"{i:06d}.png" for i in (32, 64)]
    refusal(lambda: dataset.load("scene/000033"), UsageError, "scene/000033")


@pytest.mark.parametrize("name", ["gopro_fc.json", "scene/clip.json", "scene/master.mp4", "scene/keyframes/000032.png"])
def test_a_flipped_bit_in_a_prepared_folder_is_detected(prepared, tmp_path, name):
    path = Path(shutil.copytree(prepared, tmp_path / "copy")) / name
    whole, rng = path.read_bytes(), np.random.default_rng(0)

    def use() -> np.ndarray:
        dataset = GoProFCPrepared(tmp_path / "copy", cache=tmp_path / "cache")
        check_master(dataset.clips[0])
        return dataset.load("scene/000032").frames[0]

    expected = use()
    for place, bit in zip(rng.integers(0, len(whole), 60), rng.integers(0, 8, 60), strict=True):
        flipped = bytearray(whole)
        flipped[place] ^= 1 << bit
        path.write_bytes(flipped)
        try:
            assert (use() == expected).all()
            assert path.suffix == ".png"  # in a part of the file that contains no pixel
        except DataError:
            pass


def test_a_record_of_a_variant_with_a_flipped_bit_is_refused(prepared, tmp_path):
    dataset = GoProFCPrepared(prepared, cache=tmp_path)
    dataset.corrupted("scene/000032", "h264_crf", 1)
    (path,) = (tmp_path / ".records").iterdir()
    path.write_bytes(path.read_bytes().replace(b'"frames_lost": 0', b'"frames_lost": 1'))
    refusal(dataset.clip_records, DataError, path)


def test_object_motion_blur_is_the_mean_of_master_frames(prepared):
    dataset = GoProFCPrepared(prepared)
    frames = np.stack(master_frames(dataset)).astype(np.float64)
    for severity, reach in enumerate((3, 6, 9, 12, 15), start=1):
        blurred = dataset.corrupted("scene/000064", "object_motion_blur", severity)
        for made, centre in zip(blurred, (64, 96), strict=True):
            assert (made == np.rint(frames[centre - reach : centre + reach + 1].mean(0))).all()


def test_a_key_frame_of_two_pairs_at_five_severities_is_computed_once(prepared, monkeypatch):
    read = []
    picture = ClipReader.picture
    monkeypatch.setattr(ClipReader, "picture", lambda self, index: (read.append(index), picture(self, index))[1])
    dataset = GoProFCPrepared(prepared)
    for key in ("scene/000032", "scene/000064"):
        for severity in range(1, 6):
            dataset.corrupted(key, "object_motion_blur", severity)
    assert len(read) == 3 * 31


def test_rolling_shutter_takes_its_rows_from_master_frames(prepared):
    dataset = GoProFCPrepared(prepared)
    frames = master_frames(dataset)
    for severity, readout in enumerate((6, 12, 18, 24, 30), start=1):
        for made, centre in zip(dataset.corrupted("scene/000064", "rolling_shutter", severity), (64, 96), strict=True):
            for y, row in enumerate(made):
                time = readout * ((y + 0.5) / HEIGHT - 0.5)
                assert (row == frames[centre + int(np.floor(time + 0.5))][y]).all()
            assert (made != frames[centre]).any()


@pytest.mark.filterwarnings("ignore")
def test_frames_around_a_pair_come_from_the_same_stream(prepared, tmp_path):
    dataset = GoProFCPrepared(prepared, cache=tmp_path)
    assert isinstance(dataset, CorruptedClips)
    first, second = dataset.keys()
    assert (dataset.around(first, 5), dataset.around(second, 5)) == (range(3), range(-1, 2))
    assert (dataset.around(first, 0), dataset.around(second, 0)) == (range(2), range(2))
    assert dataset.frame_files(second, [0, -1]) == [prepared / "scene" / "keyframes" / f"{i:06d}.png" for i in (32, 64)]
    assert (dataset.frame(first, 2) == dataset.load(second).frames[1]).all()
    assert (dataset.frame(second, -1) == dataset.load(first).frames[0]).all()
    for name in CLIP:
        one, other = dataset.corrupted(first, name, 5), dataset.corrupted(second, name, 5)
        assert (dataset.corrupted_frame(first, 2, name, 5) == other[1]).all()
        assert (dataset.corrupted_frame(second, -1, name, 5) == one[0]).all()
        for offset in (0, 1):
            assert (dataset.corrupted_frame(first, offset, name, 5) == one[offset]).all()


@pytest.mark.filterwarnings("ignore")
def test_a_multi_frame_model_gets_the_clip(prepared, tmp_path):
    """Use all corruptions of clips and one corruption of each other kind; a two-frame model gets the same frames."""
    chosen = {"corruptions": [*CLIP, "contrast", "impulse_noise"], "severities": [5]}
    pairs = evaluate("dis", "gopro-fc", prepared, tmp_path / "pairs", **chosen)
    one = evaluate("tests.run.models_for_tests:FiveFrames", "gopro-fc", prepared, tmp_path / "one", **chosen)
    same = ["sample", "corruption", "severity", "frames_digest"]
    assert one.rows.select(same).equals(pairs.rows.select(same))
    dataset = GoProFCPrepared(prepared)
    key = "scene/000064"
    changes = [
        dataset.corrupted_frame(key, offset, "object_motion_blur", 5).astype(int) - dataset.frame(key, offset)
        for offset in (-1, -1, 0, 1, 1)
    ]
    u = sum((place + 1) * change[..., 0] for place, change in enumerate(changes))
    v = sum((place - 2) * change[..., 1] for place, change in enumerate(changes))
    row = one.rows.filter(sample=key, corruption="object_motion_blur").row(0, named=True)
    assert row["rcre_all_sum"] == pytest.approx(np.hypot(u, v).sum() / 64, rel=1e-6)


def test_bit_errors_that_change_no_byte_warn(prepared, tmp_path):
    dataset = GoProFCPrepared(prepared, cache=tmp_path)
    with pytest.warns(UserWarning, match="bit_error"):
        shown = dataset.corrupted("scene/000032", "bit_error", 1)
    assert all((a == b).all() for a, b in zip(shown, dataset.load("scene/000032").frames, strict=True))
    (record,) = dataset.clip_records()
    assert (record["bytes_changed"], record["frames_hit"], record["frames_lost"]) == (0, 0, 0)
    assert record["encoder"].keys() == {"pyav", "libavcodec", "libx264"}


def test_cache_keeps_its_limit_and_evicted_variants_are_computed_again(prepared, tmp_path):
    whole = GoProFCPrepared(prepared, cache=tmp_path / "whole")
    small = GoProFCPrepared(prepared, cache=tmp_path / "small")
    small.cache.limit = 0
    for severity in (1, 3, 5, 1):
        key, name = "scene/000032", "h264_crf"
        pair, again = (dataset.corrupted(key, name, severity) for dataset in (whole, small))
        assert [(a == b).all() for a, b in zip(pair, again, strict=True)] == [True, True]
        assert len(small.cache.entries()) == 1
    assert len(whole.cache.entries()) == 3
    assert len(small.clip_records()) == 3  # the error is remembered


def test_bit_errors_of_the_reference_variant_use_5_m(prepared):
    default = GoProFCPrepared(prepared)
    assert load_corruption("bit_error", "reference").severities[4] == 5_000_000
    assert default.with_variant("default") is default
    assert default.with_variant("reference").variant == "reference"


def test_two_images_are_not_enough():
    grey = np.zeros((16, 16, 3), np.uint8)
    for name in CLIP:
        refusal(partial(corrupt, grey, grey, name, 1), UsageError, name)


@pytest.mark.filterwarnings("ignore")
def test_all_24_corruptions_are_in_the_table(prepared, tmp_path):
    """Run from a prepared folder; two workers produce the same rows of what depends on the whole clip."""
    few = {"severities": [5], "limit": 1}
    result = evaluate("dis", "gopro-fc", prepared, tmp_path / "run", workers=1, **few)
    manifest = json.loads((tmp_path / "run" / "manifest.json").read_text())
    assert {record["corruption"] for record in manifest["clips"]} == {"h264_crf", "h264_abr", "bit_error"}
    assert manifest["identity"]["frames"]["protocol"]["clips"]["scene"]["interpolator"]["name"] == "flow"
    assert {*result.rows["corruption"]} == {"clean", *PAPER_ORDER}
    assert len(PAPER_ORDER) == 24

    of_clips = [name for name in CLIP if name in PAPER_ORDER]
    two = evaluate("dis", "gopro-fc", prepared, tmp_path / "two", corruptions=of_clips, workers=2, **few)
    columns = ["sample", "corruption", "severity", "frames_digest", "rcre_all_sum"]
    one = result.rows.filter(pl.col("corruption").is_in(["clean", *of_clips]))
    assert two.rows.select(columns).sort(columns).equals(one.select(columns).sort(columns))


def test_released_folder_is_read_without_preparation(tmp_path):
    keys = ("GOPR0374_11_02/000032", "GOPR0374_11_02/000064", "GOPR0379_11_00/000032")
    images = {}
    for setting in ("clean", "fog_3", "brightness_3", "h264_crf_3", "fog_4"):
        for name in (f"{setting}/{key}_{position}" for key in keys for position in (0, 1)):
            images[name] = picture(tmp_path / f"{name}.png")
    benchmark = load_benchmark("gopro-fc", tmp_path)
    assert benchmark.keys == keys
    assert benchmark.corruptions == ("high_light", "fog", "h264_crf")
    assert benchmark.severities == (3,)
    dataset = benchmark.dataset
    clean = dataset.load("GOPR0379_11_00/000032")
    bright = dataset.corrupted("GOPR0379_11_00/000032", "high_light", 3)
    for position in (0, 1):
        assert (clean.frames[position] == images[f"clean/GOPR0379_11_00/000032_{position}"]).all()
        assert (bright[position] == images[f"brightness_3/GOPR0379_11_00/000032_{position}"]).all()
    lost = [tmp_path / folder / f"GOPR0374_11_02/000064_{n}.png" for folder, n in (("fog_3", 1), ("clean", 0))]
    lost[0].unlink()
    refusal(lambda: dataset.corrupted("GOPR0374_11_02/000064", "fog", 3), DataError, lost[0])
    lost[1].unlink()
    refusal(lambda: load_benchmark("gopro-fc", tmp_path), DataError, lost[1])


@pytest.mark.filterwarnings("ignore")
def test_a_video_file_is_prepared_on_the_fly(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    path = tmp_path / "mine.mp4"
    clips.clip(path, 60, HEIGHT, WIDTH, fps=30)
    with pytest.warns(UserWarning, match=r"30 .*1\.03 s"), pytest.warns(UserWarning, match="5 .*5 .*1 .*1 "):
        benchmark = load_benchmark("gopro-fc", path)
    assert benchmark.corruptions == PAPER_ORDER
    assert benchmark.keys[0] == "mine/000015"
    sample = benchmark.dataset.load(benchmark.keys[0])
    assert (read_image(benchmark.dataset.files(benchmark.keys[0])[0]) == sample.frames[0]).all()
    assert load_benchmark("gopro-fc", path).keys == benchmark.keys


def test_data_that_are_neither_prepared_nor_released_nor_a_video_are_refused(tmp_path):
    for data, split, error, culprit in (
        (None, None, UsageError, "--data"),
        (tmp_path / "none.mp4", None, DataError, tmp_path / "none.mp4"),
        (tmp_path, None, DataError, tmp_path),
        (tmp_path, tmp_path / "split.txt", UsageError, "--split"),
    ):
        refusal(lambda data=data, split=split: load_benchmark("gopro-fc", data, split), error, culprit)
