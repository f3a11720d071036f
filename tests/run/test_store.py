"""The run folder: shards are complete or absent, merging them loses no row, and damage is reported."""

from __future__ import annotations

import os
import threading

import numpy as np
import pytest

from robustflow.core.errors import RunError
from robustflow.core.files import sealed_bytes
from robustflow.core.types import Sample
from robustflow.metrics.regions import Regions
from robustflow.metrics.rows import CLEAN, measure
from robustflow.run.file_digests import read_array, write_array
from robustflow.run.plan import Unit
from robustflow.run.shards import list_shards, read_shard, shard_name, write_shard
from robustflow.run.store import RunFolder


def _row(key: str, corruption: str, severity: int) -> dict:
    frame = np.zeros((4, 6, 3), np.uint8)
    flow = np.full((4, 6, 2), severity, np.float32)
    sample = Sample(key, (frame, frame), flow, np.ones((4, 6), bool))
    return measure(flow, flow, sample, Regions.of(sample), corruption=corruption, severity=severity)


def _write(folder: RunFolder, key: str, corruption: str, severities: tuple[int, ...]) -> None:
    unit = Unit(key, corruption, severities)
    folder.write_rows(unit, [_row(key, corruption, severity) for severity in severities])


@pytest.fixture
def folder(tmp_path):
    folder = RunFolder(tmp_path / "run")
    folder.lock()
    yield folder
    folder.unlock()


def test_a_folder_that_another_run_holds_is_refused_at_once(folder):
    with pytest.raises(RunError, match="is locked by another run"):
        RunFolder(folder.path).lock()


def test_folder_with_an_unwritable_lock_is_refused_with_the_reason(tmp_path):
    (tmp_path / ".lock").mkdir()
    with pytest.raises(RunError, match=f"cannot write {tmp_path}: Is a directory; choose another folder"):
        RunFolder(tmp_path).lock()


@pytest.mark.parametrize("gone", ["", ".lock"])
def test_run_whose_folder_or_lock_was_moved_writes_nothing_into_its_successor(folder, gone):
    _write(folder, "a", CLEAN, (0,))
    (folder.path / gone).rename(folder.path.parent / "elsewhere")
    following = RunFolder(folder.path)
    following.lock()
    rows = following.rows()
    for write in (lambda: _write(folder, "a", "fog", (1,)), lambda: folder.write_manifest(None), folder.pack):
        with pytest.raises(RunError, match="is no longer locked: it was moved"):
            write()
    assert following.rows().equals(rows)
    following.unlock()


def test_dropping_samples_deletes_only_their_rows_and_clean_flows(folder):
    for key in ("a", "b", "c"):
        _write(folder, key, CLEAN, (0,))
        folder.finish_sample(key)
        write_array(folder.clean_path(key), np.zeros((2, 2, 2), np.float32), key)
    folder.pack()
    assert len(list_shards(folder.rows_folder)) == 1
    _write(folder, "a", "fog", (1,))
    folder.drop_samples(["a", "b"])
    assert folder.tidy() == {("c", CLEAN, 0)}
    assert list((folder.path / "clean").iterdir()) == [folder.clean_path("c")]


def test_keys_with_similar_file_names_have_separate_files(folder):
    for key in ("a/b", "a_b", "a b", "a:b", "x" * 300, "x" * 299, ".."):
        _write(folder, key, "fog:1+snow", (1,))
    assert folder.rows()["sample"].n_unique() == 7


def test_rows_of_one_corruption_are_those_among_all(folder):
    for key in ("a", "b"):
        _write(folder, key, CLEAN, (0,))
        _write(folder, key, "fog", (1, 2))
    assert folder.rows(corruption=CLEAN).equals(folder.rows().filter(corruption=CLEAN))
    assert folder.rows(corruption="snow").is_empty()


def test_merging_stores_every_row_once(folder):
    for key in ("a", "ab"):
        _write(folder, key, CLEAN, (0,))
        _write(folder, key, "fog", (1, 2))
    before = folder.rows()
    folder.finish_sample("a")
    assert len(list(folder.rows_folder.iterdir())) == 3
    assert folder.rows().equals(before)
    _write(folder, "a", "snow", (3,))
    folder.finish_sample("a")
    folder.finish_sample("a")
    assert len(list(folder.rows_folder.iterdir())) == 3
    assert folder.tidy() == {*before.select("sample", "corruption", "severity").iter_rows(), ("a", "snow", 3)}


def test_a_reader_beside_a_writer_never_fails(folder):
    failures: list[BaseException] = []
    stop = threading.Event()

    def read() -> None:
        while not stop.is_set():
            try:
                rows = folder.rows()
                assert not rows.select("sample", "corruption", "severity").is_duplicated().any()
            except BaseException as error:
                failures.append(error)
                return

    reader = threading.Thread(target=read)
    reader.start()
    for number in range(10):
        for corruption in ("fog", "snow"):
            _write(folder, str(number), corruption, (1,))
        folder.finish_sample(str(number))
    stop.set()
    reader.join()
    assert not failures


def test_every_flipped_bit_of_a_shard_is_an_error(folder):
    _write(folder, "a", "fog", (1, 2, 3))
    (path,) = list_shards(folder.rows_folder)
    whole = path.read_bytes()
    flips = np.random.default_rng(0).integers(0, 8 * len(whole), 500)
    for flip in flips.tolist():
        damaged = bytearray(whole)
        damaged[flip // 8] ^= 1 << flip % 8
        path.write_bytes(damaged)
        with pytest.raises(RunError, match=f"{path.name} is damaged"):
            folder.rows()
        with pytest.raises(RunError, match=f"{path.name} is damaged"):
            folder.tidy()


def test_a_shard_without_a_digest_is_refused(folder):
    _write(folder, "a", "fog", (1, 2, 3))
    (path,) = list_shards(folder.rows_folder)
    path.rename(folder.rows_folder / f"{shard_name(path)}.parquet")
    with pytest.raises(
        RunError, match=r"is damaged .its name has no digest.; delete it and run the same command again"
    ):
        folder.rows()


def test_a_shard_with_different_columns_is_refused(folder):
    _write(folder, "a", "fog", (1,))
    (path,) = list_shards(folder.rows_folder)
    write_shard(folder.rows_folder, "b", read_shard(path).drop("wauc_sum"))
    for read in (folder.rows, folder.scan):
        with pytest.raises(RunError, match="has different columns than this version writes"):
            read()


def test_contradictory_shards_are_refused_by_name(folder):
    _write(folder, "a", "fog", (1, 2))
    (shard,) = list_shards(folder.rows_folder)
    other = _row("a", "fog", 2) | {"epe_sum": 17.0}
    folder.write_rows(Unit("a", "fog", (2, 3)), [other, _row("a", "fog", 3)])
    with pytest.raises(RunError, match=rf"{shard.name} .*contain different rows for sample 'a', fog severity 2"):
        folder.rows()
    with pytest.raises(RunError, match="contain different rows"):
        folder.tidy()


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
    folder.pack()
    assert len(list_shards(folder.rows_folder)) == 1
    assert folder.rows().equals(before)


def test_files_left_by_a_killed_run_are_deleted_at_the_next_start(folder):
    for key in ("done", "not merged", "begun", "predicted"):
        if key != "predicted":
            _write(folder, key, CLEAN, (0,))
        write_array(folder.clean_path(key), np.zeros((4, 6, 2), np.float32), key)
    for key in ("done", "not merged"):
        _write(folder, key, "fog", (1,))
    left = {path: path.read_bytes() for path in list_shards(folder.rows_folder) if path.name.startswith("done")}
    before = folder.rows()
    folder.finish_sample("done")
    for path, data in left.items():  # as after a crash between merging and clearing
        path.write_bytes(data)
    assert folder.rows().equals(before), "no row is shown twice"
    cells = folder.tidy()
    folder.settle(["done", "not merged", "begun", "predicted"], {"begun", "predicted"}, cells)
    assert cells == set(before.select("sample", "corruption", "severity").iter_rows())
    assert folder.rows().equals(before)
    assert len(list_shards(folder.rows_folder)) == 3
    assert list((folder.path / "clean").iterdir()) == [folder.clean_path("begun")]


def test_temporary_files_of_a_killed_run_are_cleared_and_never_read(folder):
    (folder.rows_folder / ".partial-1234-x.parquet").write_bytes(b"half")
    (folder.path / "attacks").mkdir()
    (folder.path / "attacks" / ".partial-1234-x.npy").write_bytes(b"half")
    (folder.path / ".partial-1234-examples").mkdir()
    (folder.path / ".partial-1234-examples" / "worst.jpg").write_bytes(b"half")
    assert folder.rows().height == 0
    folder.unlock()
    folder.lock()
    assert not list(folder.path.rglob(".partial-*"))


def test_clean_flows_come_back_bit_for_bit(tmp_path):
    flow = np.random.default_rng(0).normal(size=(5, 7, 2)).astype(np.float32)
    assert read_array(tmp_path / "a.npy", "a") is None
    write_array(tmp_path / "a.npy", flow, "a")
    np.testing.assert_array_equal(read_array(tmp_path / "a.npy", "a"), flow)
    np.testing.assert_array_equal(np.load(tmp_path / "a.npy"), flow)
    assert read_array(tmp_path / "a.npy", "b") is None, "it was computed from different inputs"


def test_a_clean_flow_that_is_not_whole_counts_as_missing(tmp_path):
    path, flow = tmp_path / "a.npy", np.ones((1, 1, 2), np.float32)
    write_array(path, flow, "a")
    whole = path.read_bytes()
    for length in range(len(whole)):
        path.write_bytes(whole[:length])
        assert read_array(path, "a") is None
    for flip in range(8 * len(whole)):
        damaged = bytearray(whole)
        damaged[flip // 8] ^= 1 << flip % 8
        path.write_bytes(damaged)
        assert read_array(path, "a") is None
    np.save(path, flow)
    assert read_array(path, "a") is None, "its integrity cannot be checked"


@pytest.mark.parametrize(
    "content", [b"", b"no array", b"\x93NUMPY\x01\x00\x10\x00{'descr': [[[[[[[", b"PK\x05\x06" + bytes(18)]
)
def test_bytes_that_are_no_array_count_as_missing_whatever_their_digest(tmp_path, content):
    path = tmp_path / "a.npy"
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
    link.symlink_to(victim if "." not in name else victim / "kept.npy")
    for use in (folder.lock, folder.manifest):
        with pytest.raises(RunError, match=rf"{name}: is a link; .*delete it$"):
            use()
    assert {path: path.read_bytes() for path in victim.iterdir()} == before


def test_a_pipe_in_a_run_folder_is_refused_instead_of_read(tmp_path):
    folder = RunFolder(tmp_path)
    os.mkfifo(folder.manifest_path)
    with pytest.raises(RunError, match=r"neither a file nor a folder"):
        folder.manifest()


def test_a_folder_that_is_itself_reached_through_a_link_is_used(tmp_path):
    (tmp_path / "large").mkdir()
    (tmp_path / "run").symlink_to(tmp_path / "large")
    folder = RunFolder(tmp_path / "run")
    folder.lock()
    folder.unlock()
    assert (tmp_path / "large" / "rows").is_dir()


def test_other_files_beside_clean_flows_are_not_removed(folder):
    (folder.path / "clean" / "notes.txt").write_text("mine")
    (folder.path / "clean" / "flow.npy").write_text("mine, too")
    write_array(folder.clean_path("a"), np.zeros((2, 2, 2), np.float32), "a")
    folder.keep_clean(())
    assert sorted(path.name for path in (folder.path / "clean").iterdir()) == ["flow.npy", "notes.txt"]
