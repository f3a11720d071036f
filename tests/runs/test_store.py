"""The run folder: shards whole or absent, merged without a row lost, damage named."""

from __future__ import annotations

import threading

import numpy as np
import pytest

from robustflow.errors import RunError
from robustflow.metrics.regions import Regions
from robustflow.metrics.rows import CLEAN, measure
from robustflow.runs.plan import Unit
from robustflow.runs.store import RunFolder, read_clean, write_clean
from robustflow.sample import Sample


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


def test_keys_that_look_alike_as_file_names_stay_apart(folder):
    for key in ("a/b", "a_b", "a b", "a:b", "x" * 300, "x" * 299, ".."):
        _write(folder, key, "fog:1+snow", (1,))
    assert folder.rows()["sample"].n_unique() == 7


def test_merging_keeps_every_row_once(folder):
    for key in ("a", "ab"):
        _write(folder, key, CLEAN, (0,))
        _write(folder, key, "fog", (1, 2))
    before = folder.rows()
    folder.merge("a")
    assert len(list(folder.rows_folder.iterdir())) == 3
    assert folder.rows().equals(before)
    _write(folder, "a", "snow", (3,))
    folder.merge("a")
    folder.merge("a")
    assert len(list(folder.rows_folder.iterdir())) == 3
    assert set(folder.cells()) == {*before.select("sample", "corruption", "severity").iter_rows(), ("a", "snow", 3)}


def test_a_crash_between_merging_and_clearing_shows_no_row_twice(folder):
    _write(folder, "a", CLEAN, (0,))
    _write(folder, "a", "fog", (1, 2))
    left = [(path, path.read_bytes()) for path in folder.rows_folder.iterdir()]
    before = folder.rows()
    folder.merge("a")
    for path, data in left:
        path.write_bytes(data)
    assert folder.rows().equals(before)


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
    for number in range(15):
        for corruption in ("fog", "snow"):
            _write(folder, str(number), corruption, (1,))
        folder.merge(str(number))
    stop.set()
    reader.join()
    assert not failures


def test_half_a_shard_is_named(folder):
    _write(folder, "a", CLEAN, (0,))
    _write(folder, "b", CLEAN, (0,))
    (path,) = [path for path in folder.rows_folder.iterdir() if path.name.startswith("b")]
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(RunError, match=f"{path.name} is damaged"):
        folder.rows()


def test_temporary_files_of_a_killed_run_are_cleared_and_never_read(tmp_path):
    folder = RunFolder(tmp_path / "run")
    folder.lock()
    (folder.rows_folder / ".partial-1234-x.parquet").write_bytes(b"half")
    assert folder.rows().height == 0
    folder.unlock()
    folder.lock()
    assert not list(folder.path.rglob(".partial-*"))
    folder.unlock()


def test_clean_flows_come_back_to_the_bit(tmp_path):
    flow = np.random.default_rng(0).normal(size=(5, 7, 2)).astype(np.float32)
    assert read_clean(tmp_path / "a.npy") is None
    write_clean(tmp_path / "a.npy", flow)
    np.testing.assert_array_equal(read_clean(tmp_path / "a.npy"), flow)
