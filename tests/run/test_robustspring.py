"""A run on RobustSpring's layout, compared with values that the test computes from the files."""

import json
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest

from robustflow.api import evaluate
from robustflow.core.files import digest_of_value, json_bytes
from robustflow.core.files import sealed as with_digest
from robustflow.data.benchmarks import load_benchmark
from robustflow.data.datasets import load_dataset
from robustflow.media.images import write_image
from robustflow.models import load_model
from robustflow.report.leaderboard import boards_of
from robustflow.report.paper_tables import build_table
from robustflow.report.table import run_frame
from robustflow.run.records.format import container_bytes
from robustflow.run.records.pack import record_bytes
from robustflow.run.source import RunSource
from robustflow.run.submission import Robustness, Submitted
from robustflow.stats.lines import lines_of
from robustflow.stats.robustspring import robustspring_results
from tests.run.records.forge import entries_of as entries_of_record
from tests.run.records.forge import failure, verified

HEIGHT, WIDTH = 96, 128
SEQUENCES = {"0003": 3, "0028": 2}


@cache
def _whole() -> np.ndarray:
    return load_dataset("motorcycle").load("motorcycle").frames[0]


def _clean(sequence: str, side: str, number: int) -> np.ndarray:
    """A sequence of crops that move across a real frame."""
    whole = _whole()
    top, left = 60 + 3 * number, 80 + 5 * number + 8 * (side == "right") + 150 * (sequence == "0028")
    return np.ascontiguousarray(whole[top : top + HEIGHT, left : left + WIDTH])


def _fog(frame: np.ndarray) -> np.ndarray:
    return (0.5 * frame + 100).astype(np.uint8)


def _zoom_blur(frame: np.ndarray) -> np.ndarray:
    return cv2.blur(frame, (7, 3))


CONDITIONS = {"spring": np.array, "fog": _fog, "zoom_blur": _zoom_blur}


@pytest.fixture(scope="module")
def root(tmp_path_factory) -> Path:
    root = tmp_path_factory.mktemp("data") / "RobustSpring"
    for condition, make in CONDITIONS.items():
        for sequence, count in SEQUENCES.items():
            for side in ("left", "right"):
                folder = root / condition / "test" / sequence / f"frame_{side}"
                folder.mkdir(parents=True)
                for number in range(1, count + 1):
                    write_image(folder / f"frame_{side}_{number:04d}.png", make(_clean(sequence, side, number)))
    return root


@pytest.fixture(scope="module")
def run(root, tmp_path_factory):
    return evaluate("farneback", "robustspring", root, tmp_path_factory.mktemp("runs") / "mine", examples=False)


def _farneback(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    return load_model("farneback").predict(first, second).astype(np.float64)


@pytest.fixture(scope="module")
def expected() -> dict[str, float]:
    """RobustSpring's R_EPE: the change of the flow, averaged over pixels and over the pairs of both cameras and
    both directions.
    """
    moved: dict[str, list[float]] = {"fog": [], "zoom_blur": []}
    for sequence, count in SEQUENCES.items():
        for side in ("left", "right"):
            for number in range(1, count):
                for pair in ((number, number + 1), (number + 1, number)):
                    clean = [_clean(sequence, side, one) for one in pair]
                    before = _farneback(*clean)
                    for name, distances in moved.items():
                        after = _farneback(*map(CONDITIONS[name], clean))
                        distances.append(float(np.sqrt(((after - before) ** 2).sum(axis=2)).mean()))
    return {name: float(np.mean(distances)) for name, distances in moved.items()}


def test_rcre_is_how_far_the_flow_moves(run, expected):
    assert run.measured.corruptions == {"robustspring_fog": [1], "robustspring_zoom_blur": [1]}
    for own, value in expected.items():
        assert run.mean("rcre", f"robustspring_{own}") == pytest.approx(value, rel=1e-6)
        assert run.mean("epe", f"robustspring_{own}") is None
    assert run.rcre == pytest.approx(np.mean(list(expected.values())), rel=1e-6)
    assert run.mean("rcre", "weather") == run.mean("rcre", "robustspring_fog")
    assert run.measured.samples == 4 * sum(count - 1 for count in SEQUENCES.values()) == 12
    assert set(run.rows["group"]) == set(SEQUENCES)


def test_the_export_has_the_same_numbers_under_the_same_names(run, expected):
    flows = [Submitted("clean", "a", True, "0", None)]
    flows += [Submitted(name, "a", True, "1", Robustness(value, 0.0, 0.0)) for name, value in expected.items()]
    ours, theirs = (lines_of(frame) for frame in (run_frame([run]), robustspring_results(run, flows)))
    assert {key.benchmark for key in (*ours, *theirs)} == {"robustspring"}
    (ours,), (theirs,) = ours.values(), theirs.values()
    assert ours.by_corruption("rcre") == pytest.approx(theirs.by_corruption("rcre"), rel=1e-6)
    assert ours.number("rcre", "average") == pytest.approx(theirs.number("rcre", "average"), rel=1e-6)


def test_run_on_robustspring_is_shown_in_tables_and_pages(run):
    results = lines_of(run_frame([run]))
    table = build_table("rcre", results)
    headings = [(column.label, column.group) for column in table.columns]
    assert headings == [("RS fog", "Weather"), ("RS zoom blur", "Blur"), ("AVG RCRE", "")]
    (board,) = boards_of(results, {})
    assert ("rcre", "robustspring_fog", None) in [column.key for column in board.columns]


def test_path_of_springs_frames_is_not_part_of_the_identity(run, root, tmp_path, monkeypatch):
    """Their folder may be named relative to the working folder, which a later command does not share."""
    apart = tmp_path / "apart"
    apart.mkdir()
    for condition in ("fog", "zoom_blur"):
        (apart / condition).symlink_to(root / condition)
    monkeypatch.chdir(root.parent)
    options = {"data_options": {"spring": f"{root.name}/spring"}, "limit": 1, "examples": False}
    moved = evaluate("farneback", "robustspring", apart, tmp_path / "run", **options)
    assert moved.manifest.identity == run.manifest.identity
    monkeypatch.chdir(tmp_path)
    source = RunSource.read(moved.path)
    again = load_benchmark("robustspring", source.data, options=source.data_options)
    assert set(moved.manifest.samples) < set(again.keys)


def test_names_of_robustspring_are_valid_only_in_records_of_this_benchmark(run):
    data = record_bytes(run)
    assert verified(data).ok
    entries = entries_of_record(data)
    manifest = json.loads(entries["manifest.json"])
    manifest["identity"]["frames"]["benchmark"] = "gopro"
    manifest["identity_digest"] = digest_of_value(manifest["identity"])
    check, says = failure(container_bytes(entries | {"manifest.json": json_bytes(with_digest(manifest))}))
    assert check == "cells"
    assert "robustspring_fog" in says
