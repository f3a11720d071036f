"""Use a weight file in the ARFlow authors' format end to end, from the command line to the report, on real frames."""

from __future__ import annotations

import sys

import polars as pl
import pytest

pytest.importorskip("torch", reason="needs the torch extra")

import torch

import robustflow as rf
from robustflow.cli.main import main
from robustflow.models.networks.arflow import ARFlow

pytestmark = [pytest.mark.parity, pytest.mark.torch, pytest.mark.slow]
PACK = "arflow"


@pytest.fixture
def checkpoint(pack, tmp_path):
    """Write a file in the authors' format: weights from multi-GPU training, alongside the other entries that the
    authors' trainer saves.
    """
    state = {f"module.{key}": value for key, value in pack.fill(ARFlow()).state_dict().items()}
    torch.save({"epoch": 1000, "state_dict": state}, tmp_path / "pwclite_ar.tar")
    return tmp_path / "pwclite_ar.tar"


def command_line(monkeypatch, *arguments):
    monkeypatch.setattr(sys, "argv", ["robustflow", *map(str, arguments)])
    with pytest.raises(SystemExit) as stop:
        main()
    assert not stop.value.code, "the command failed"


def test_the_same_rows_for_every_batch_and_number_of_workers(shared, checkpoint, tmp_path, monkeypatch):
    data = shared("data", "kitti2015")
    run = ["run", "--model", "arflow", "--checkpoint", checkpoint, "--benchmark", "kitti-fc", "--data", data]
    run += ["--device", "cpu", "-c", "fog", "-s", "1,2,3,5"]
    rows = {}
    for batch, workers in ((1, 1), (4, 1), (1, 2), (4, 2)):
        folder = tmp_path / f"{batch}_{workers}"
        command_line(monkeypatch, *run, "--batch-size", batch, "--workers", workers, "--output", folder)
        rows[batch, workers] = rf.Result(folder).rows
    first = rows.pop((1, 1))
    assert first["sample"].n_unique() * 5 == first.height >= 5
    for (batch, workers), other in rows.items():
        assert other.schema == first.schema
        assert difference(first, other) == 0, f"batch {batch}, {workers} workers"
        assert other.equals(first)
    page = tmp_path / "report.html"
    command_line(monkeypatch, "report", tmp_path / "4_2", "--format", "page", "--output", page)
    assert "arflow" in page.read_text()


def difference(first: pl.DataFrame, other: pl.DataFrame) -> float:
    """The largest absolute difference between corresponding numbers."""
    numbers = [name for name, kind in first.schema.items() if kind.is_numeric()]
    return max(float((first[name].cast(float) - other[name].cast(float)).abs().max() or 0) for name in numbers)
