"""The cost of a plan grows with its size: many parts, and many cells of which few have rows."""

import shutil
import time
import tracemalloc

import pytest

import robustflow as rf
from robustflow.core.errors import RunError
from robustflow.core.files import json_bytes
from robustflow.run.manifest import Cells
from robustflow.run.records.format import Record, container_bytes, rows_to_text
from robustflow.run.records.read import Reader
from robustflow.run.records.verify import verify_read
from robustflow.run.run import Run

from ..refusals import refusal

FILES = (("a.png", "0" * 16), ("b.png", "1" * 16))
LEVELS = [tuple(level for level in range(1, 6) if chosen >> level & 1) for chosen in range(2, 64, 2)]


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    folder = tmp_path_factory.mktemp("plan") / "run"
    return rf.evaluate("farneback", output=folder, corruptions=["contrast"], severities=[1], examples=False)


def _parts(count):
    """Return parts of one sample each, no two of which have equal conditions."""
    corruptions = ("fog", "snow", "frost")
    return [
        Cells(
            samples=(f"sample {number}",),
            corruptions={name: LEVELS[number // 31**place % 31] for place, name in enumerate(corruptions)},
        )
        for number in range(count)
    ]


def _full(samples, pairs):
    """Return a part of many samples under stacks of corruptions at all severities."""
    names = [f"fog+{name}" for name in ("snow", "frost", "contrast", "pixelate")][:pairs]
    return [Cells(samples=tuple(map(str, range(samples))), corruptions=dict.fromkeys(names, (1, 2, 3, 4, 5)))]


def _planning(run, parts):
    manifest = run.manifest
    new = {key: FILES for part in parts for key in part.samples}
    return manifest.model_copy(
        update={"planned": (*manifest.planned, *parts), "samples": {**manifest.samples, **new}, "finished": None}
    )


def _record(run, parts):
    record, manifest = Record(complete=False), _planning(run, parts).shareable()
    entries = {"record.json": json_bytes(record.model_dump()), "manifest.json": manifest.document()}
    return container_bytes({**entries, "rows.csv": rows_to_text(run.rows)})


def test_time_to_verify_a_record_is_linear_in_its_parts(small):
    seconds = []
    for count in (1500, 6000):
        data = _record(small, _parts(count))
        start = time.process_time()
        assert verify_read(Reader(data, "record")).ok
        seconds.append(time.process_time() - start)
    assert seconds[1] < 8 * max(seconds[0], 0.1)  # 16 times if the time grew with the square


def _peak(call):
    tracemalloc.start()
    call()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak


def test_memory_for_rows_that_do_not_exist_is_that_of_their_samples(small, tmp_path):
    parts = _full(5000, 4)
    folder = tmp_path / "run"
    shutil.copytree(small.path, folder)
    (folder / "manifest.json").write_bytes(_planning(small, parts).document())
    run = Run(folder)
    assert sum(cells.count for cells in run.measured.missing) == 105_000
    assert len(run.measured.missing) == 1
    run.write_means()
    assert (folder / "summary.json").stat().st_size < 200_000
    _ = run.rows
    assert _peak(run.average) < 3_000_000
    reader = Reader(_record(small, parts), "record")
    _ = reader.plan, reader.frame
    assert _peak(lambda: verify_read(reader)) < 30_000_000


def test_a_plan_of_more_rows_than_can_exist_is_refused(small, tmp_path):
    names = [f"fog+{number}" for number in range(400)]
    part = Cells(samples=tuple(map(str, range(10_001))), corruptions=dict.fromkeys(names, (1, 2, 3, 4, 5)))
    path = tmp_path / "run" / "manifest.json"
    path.parent.mkdir()
    path.write_bytes(_planning(small, [part]).document())
    refusal(lambda: Run(path.parent), RunError, path)
    path.write_bytes(_planning(small, [part.among(part.samples[:9000])]).document())
    assert Run(path.parent).manifest.planned[1].count() == 9000 * 2001
