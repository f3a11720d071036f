"""The run folder: shards are complete or absent, merging them loses no row, and damage is reported."""

import multiprocessing
import os
import threading

import numpy as np
import polars as pl
import pytest

from robustflow.core.errors import RunError, UsageError
from robustflow.core.files import sealed_bytes
from robustflow.core.types import Sample
from robustflow.metrics.regions import Regions
from robustflow.metrics.rows import CLEAN, ROW_KEY, measure
from robustflow.run.plan import Unit
from robustflow.run.store import RunFolder, list_shards, read_shard, shard_name, write_shard
from robustflow.run.trust import read_array, write_array

from ..refusals import refusal

FLOW = np.zeros((2, 2, 2), np.float32)


def _row(key: str, corruption: str, severity: int) -> dict:
    frame = np.zeros((4, 6, 3), np.uint8)
    flow = np.full((4, 6, 2), severity, np.float32)
    sample = Sample(key, (frame, frame), flow, np.ones((4, 6), bool))
    return measure(flow, flow, sample, Regions.of(sample), corruption=corruption, severity=severity)


def _write(folder: RunFolder, key: str, corruption: str, severities: tuple[int, ...]) -> None:
    unit = Unit(key, corruption, severities)
    folder.write_rows(unit, [_row(key, corruption, severity) for severity in severities])


def _flips(data: bytes, count: int):
    """Copies of the data with one flipped bit each."""
    for flip in np.random.default_rng(0).integers(0, 8 * len(data), count).tolist():
        damaged = bytearray(data)
        damaged[flip // 8] ^= 1 << flip % 8
        yield bytes(damaged)


@pytest.fixture
def folder(tmp_path):
    folder = RunFolder(tmp_path / "run")
    folder.lock()
    yield folder
    folder.unlock()


def test_a_folder_that_another_run_holds_or_whose_lock_is_unwritable_is_refused(folder, tmp_path):
    refusal(RunFolder(folder.path).lock, RunError, folder.path)
    (tmp_path / ".lock").mkdir()
    refusal(RunFolder(tmp_path).lock, RunError, tmp_path)


@pytest.mark.parametrize("gone", ["", ".lock"])
def test_run_whose_folder_or_lock_was_moved_writes_nothing_into_its_successor(folder, gone):
    _write(folder, "a", CLEAN, (0,))
    (folder.path / gone).rename(folder.path.parent / "elsewhere")
    following = RunFolder(folder.path)
    following.lock()
    rows = following.rows()
    for write in (lambda: _write(folder, "a", "fog", (1,)), lambda: folder.write_manifest(None), folder.pack):
        refusal(write, RunError, folder.path)
    assert following.rows().equals(rows)
    following.unlock()


def test_rows_of_dropped_samples_and_clean_flows_of_finished_ones_are_deleted(folder):
    for key in ("a", "b", "c"):
        _write(folder, key, CLEAN, (0,))
        write_array(folder.clean_path(key), FLOW, key)
    folder.pack()
    assert len(list_shards(folder.rows_folder)) == 1
    _write(folder, "a", "fog", (1,))
    folder.drop_samples(["a", "b"])
    assert folder.tidy() == {("c", CLEAN, 0)}
    folder.finish_sample("c")
    assert set(folder.clean_folder.iterdir()) == {folder.clean_path("a"), folder.clean_path("b")}
    folder.unlock()
    assert not folder.clean_folder.exists()


def test_keys_with_similar_file_names_have_separate_files(folder):
    keys = ("a/b", "a_b", "a b", "a:b", "x" * 300, "x" * 299, "..")
    for key in keys:
        _write(folder, key, "fog:1+snow", (1,))
    assert folder.rows()["sample"].n_unique() == len(set(map(folder.clean_path, keys))) == len(keys)


def test_rows_of_one_corruption_are_those_among_all(folder):
    for key in ("a", "b"):
        _write(folder, key, CLEAN, (0,))
        _write(folder, key, "fog", (1, 2))
    assert folder.rows(corruption=CLEAN).equals(folder.rows().filter(corruption=CLEAN))
    assert folder.rows(corruption="snow").is_empty()


def test_a_reader_beside_a_writer_never_fails(folder):
    failures: list[BaseException] = []
    stop = threading.Event()

    def read() -> None:
        while not stop.is_set():
            try:
                assert not folder.rows().select(ROW_KEY).is_duplicated().any()
            except BaseException as error:
                failures.append(error)
                return

    reader = threading.Thread(target=read)
    reader.start()
    for number in range(10):
        for corruption in ("fog", "snow"):
            _write(folder, str(number), corruption, (1,))
        folder.pack()
    stop.set()
    reader.join()
    assert not failures


def test_damaged_shards_are_refused_by_path(folder):
    _write(folder, "a", "fog", (1, 2, 3))
    (path,) = list_shards(folder.rows_folder)
    whole = path.read_bytes()
    for damaged in _flips(whole, 500):
        path.write_bytes(damaged)
        refusal(folder.rows, RunError, path)
        refusal(folder.tidy, RunError, path)
    path.write_bytes(whole)
    other = write_shard(folder.rows_folder, "b", read_shard(path).drop("wauc_sum"))
    for read in (folder.rows, folder.scan):
        refusal(read, RunError, other)
    without_digest = path.rename(folder.rows_folder / f"{shard_name(path)}.parquet")
    refusal(folder.rows, RunError, without_digest)


def test_contradictory_shards_are_refused_by_name(folder):
    _write(folder, "a", "fog", (1, 2))
    (shard,) = list_shards(folder.rows_folder)
    folder.write_rows(Unit("a", "fog", (2, 3)), [_row("a", "fog", 2) | {"epe_sum": 17.0}, _row("a", "fog", 3)])
    error = refusal(folder.rows, RunError, shard)
    assert str(list_shards(folder.rows_folder)[1]) in str(error)
    refusal(folder.tidy, RunError, shard)


@pytest.mark.parametrize("key", ["a", None])
def test_contradictory_rows_of_one_shard_are_refused_by_its_name(folder, key):
    _write(folder, "a", "fog", (1, 2))
    (path,) = list_shards(folder.rows_folder)
    rows = read_shard(path).with_columns(sample=pl.lit(key, pl.String))
    path.unlink()
    shard = write_shard(folder.rows_folder, "b", pl.concat([rows, rows[:1].with_columns(epe_sum=pl.lit(1.0))]))
    for read in (folder.rows, folder.tidy):
        refusal(read, RunError, shard)


def test_small_shards_become_one_and_no_row_is_lost(folder):
    keys = [f"sample {number}" for number in range(70)]
    for key in keys:
        _write(folder, key, CLEAN, (0,))
        _write(folder, key, "fog", (1, 2))
        folder.finish_sample(key)
        assert len(list_shards(folder.rows_folder)) <= 64
    before = folder.rows()
    assert before["sample"].unique().sort().to_list() == sorted(keys)
    assert before.height == 210
    for _ in range(2):
        folder.pack()
        assert len(list_shards(folder.rows_folder)) == 1
        assert folder.rows().equals(before)


def test_rows_left_by_a_crash_between_merging_and_clearing_are_read_once(folder):
    _write(folder, "a", CLEAN, (0,))
    _write(folder, "a", "fog", (1,))
    _write(folder, "b", CLEAN, (0,))
    left = {path: path.read_bytes() for path in list_shards(folder.rows_folder)}
    before = folder.rows()
    folder.pack()
    for path, data in left.items():
        path.write_bytes(data)
    assert folder.rows().equals(before)
    assert folder.tidy() == set(before.select(ROW_KEY).iter_rows())
    assert len(list_shards(folder.rows_folder)) == 1
    assert folder.rows().equals(before)


def test_temporary_files_of_a_killed_run_are_cleared_and_never_read(folder):
    (folder.path / "attacks").mkdir()
    (folder.path / ".partial-1234-examples").mkdir()
    for name in ("rows/.partial-1234-x.parquet", "attacks/.partial-1234-x.npy", ".partial-1234-examples/worst.jpg"):
        (folder.path / name).write_bytes(b"half")
    assert folder.rows().height == 0
    folder.unlock()
    folder.lock()
    assert not list(folder.path.rglob(".partial-*"))


def test_arrays_come_back_bit_for_bit_if_their_inputs_are_the_same(tmp_path):
    path, flow = tmp_path / "a.npy", np.random.default_rng(0).normal(size=(5, 7, 2)).astype(np.float32)
    assert read_array(path, "a") is None
    write_array(path, flow, "a")
    np.testing.assert_array_equal(read_array(path, "a"), flow)
    np.testing.assert_array_equal(np.load(path), flow)
    assert read_array(path, "b") is None


def test_an_array_that_is_not_whole_counts_as_missing(tmp_path):
    path = tmp_path / "a.npy"
    write_array(path, FLOW, "a")
    whole = path.read_bytes()
    for damaged in (*(whole[:length] for length in range(len(whole))), *_flips(whole, 500)):
        path.write_bytes(damaged)
        assert read_array(path, "a") is None
    np.save(path, FLOW)
    assert read_array(path, "a") is None, "without a digest"
    for content in (b"", b"no array", b"\x93NUMPY\x01\x00\x10\x00{'descr': [[[[[[[", b"PK\x05\x06" + bytes(18)):
        path.write_bytes(sealed_bytes(content, "a"))
        assert read_array(path, "a") is None


@pytest.mark.parametrize(
    "name", ["rows", "clean", "examples", "manifest.json", ".lock", "rows/a.parquet", "clean/a.npy"]
)
def test_a_link_in_a_run_folder_is_refused_and_its_target_stays(tmp_path, name):
    victim = tmp_path / "victim"
    victim.mkdir()
    (victim / "kept.npy").write_bytes(b"not ours")
    (victim / ".partial-0123abcd-mine").write_bytes(b"not ours either")
    before = {path: path.read_bytes() for path in victim.iterdir()}
    folder = RunFolder(tmp_path / "run")
    folder.lock()
    folder.manifest_path.write_text("{}")
    folder.unlock()
    link = folder.path / name
    if link.is_dir():
        link.rmdir()
    link.unlink(missing_ok=True)
    link.parent.mkdir(exist_ok=True)
    link.symlink_to(victim if "." not in name else victim / "kept.npy")
    for use in (folder.lock, folder.manifest):
        refusal(use, RunError, link)
    assert {path: path.read_bytes() for path in victim.iterdir()} == before


def test_a_pipe_in_a_run_folder_is_refused_and_a_link_to_the_whole_folder_is_not(tmp_path):
    os.mkfifo(tmp_path / "manifest.json")
    refusal(RunFolder(tmp_path).manifest, RunError, tmp_path / "manifest.json")
    (tmp_path / "large").mkdir()
    (tmp_path / "run").symlink_to(tmp_path / "large")
    folder = RunFolder(tmp_path / "run")
    folder.lock()
    folder.unlock()
    assert (tmp_path / "large" / "rows").is_dir()


def test_fork_of_a_process_that_has_read_rows_is_refused_instead_of_hanging(folder):
    _write(folder, "a", CLEAN, (0,))
    folder.rows()
    with multiprocessing.get_context("fork").Pool(1) as pool, pytest.raises(UsageError):
        pool.apply_async(RunFolder(folder.path).rows).get(60)
