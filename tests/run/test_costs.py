"""Costs stored with runs are validated, shown in the cost table, and ranked only for runs on the same frames."""

import json
import os
import shutil

import pytest

from robustflow.api import Result, evaluate
from robustflow.core.errors import RunError, UsageError
from robustflow.core.files import sealed
from robustflow.report.site.content import whole_content
from robustflow.report.tables import tables_of
from robustflow.run.costs import PROFILE, RunCost, check_profiled_model
from robustflow.run.records.pack import load_any_run, pack
from robustflow.stats.lines import FLOPS, RANKS
from robustflow.testing import ConstantFlow

from ..refusals import refusal

pytestmark = pytest.mark.usefixtures("demo_is_small")


class Shifted:
    """A model that predicts the same flow at every pixel, which determines its errors."""

    def __init__(self, name: str, shift: float, trained_on: str | None = None) -> None:
        self._name, self._shift = name, shift
        self.trained_on = trained_on

    def identity(self):
        return {"name": self._name}

    def predict(self, frame1, frame2):
        return ConstantFlow(self._shift * float(frame1.mean())).predict(frame1, frame2)


def _cost(run, flops: float, parameters: float = 1.5, **values) -> RunCost:
    counts = {"parameters": 7, "macs": 8, "thop_parameters": int(parameters * 1e6), "thop_macs": int(flops * 1e9)}
    return RunCost(run=run.manifest.identity_digest, **({"height": 432, "width": 720} | counts | values))


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs")
    models = [Shifted("one", -0.1, "C"), Shifted("two", -0.5, "C"), Shifted("three", 0.4, "C"), Shifted("four", 0.2)]
    for index, model in enumerate(models):
        evaluate(model, "demo", output=folder / str(index), corruptions=["contrast"], severities=[5])
    return folder


@pytest.fixture(autouse=True)
def no_exclusions(monkeypatch):
    """Turn off exclusions, which would apply to models that move every pixel alike."""
    monkeypatch.setattr("robustflow.stats.frame.exclusions", lambda runs: [""] * len(runs))


@pytest.fixture
def runs(measured, tmp_path):
    """Copies of the runs, because costs are written into them."""
    copy = shutil.copytree(measured, tmp_path / "runs")
    return [Result(copy / str(index)) for index in range(4)]


def _lines(runs, published=True):
    (table,) = tables_of(runs, published=published, wanted=["cost"])
    heads = [f"{column.group} {column.label}".strip() for column in table.columns]
    return {
        (section.title, line.label): (dict(zip(heads, (cell.text for cell in line.cells), strict=True)), line.note)
        for section in table.sections
        for line in section.lines
    }


def test_costs_of_runs_are_shown_without_ranks(runs):
    """A flow that is too short has a low CREr, which must not give it a good rank."""
    costs = (30.0, 20.04, 20.01, 5.0)
    for run, flops in zip(runs, costs, strict=True):
        _cost(run, flops).write(run.path)
    found = {
        name: cells for (title, name), (cells, _) in _lines(runs).items() if title == "Measured on different frames"
    }
    texts = dict(zip(found, [f"{flops:.1f}" for flops in costs], strict=True))
    assert {name: cells["MACs (G)"] for name, cells in found.items()} == texts
    assert {cells["Param. (M)"] for cells in found.values()} == {"1.50"}
    assert {cells["Avg. rank OOD"] for cells in found.values()} == {"-"}
    for run in runs[:3]:
        assert found[run.name]["CREr & rank OOD"] == f"{run.crer:.2f}"
    board = {
        line.label: {column.key: cell.text for column, cell in zip(table.columns, line.cells, strict=True)}
        for table in whole_content(runs).boards
        for section in table.sections
        for line in section.lines
        if line.label in found
    }
    assert not any(RANKS["average"] in cells for cells in board.values())
    assert {name: cells[FLOPS] for name, cells in board.items()} == texts


def test_costs_of_runs_leave_published_lines_unchanged(runs):
    alone = {key: cells for key, (cells, _) in _lines([]).items()}
    for run in runs:
        _cost(run, 0.1).write(run.path)
    beside = {key: cells for key, (cells, _) in _lines(runs).items() if key[0] == "Published"}
    assert {key: {k: v for k, v in cells.items() if "other" not in k} for key, cells in beside.items()} == alone


def test_counts_at_another_size_are_noted(runs):
    _cost(runs[0], 30.0).write(runs[0].path)
    _cost(runs[1], 20.0, height=64, width=64, iterations=24).write(runs[1].path)
    found = _lines(runs, published=False)
    cells, note = found["Measured on different frames", "two"]
    assert cells["MACs (G)"] == "20.0"
    assert note.endswith("MACs of 24 iterations, frames of 64x64")
    assert found["Measured on different frames", "one"][0]["MACs (G)"] == "30.0"
    assert found["Measured on different frames", "three"][0]["MACs (G)"] == "-"


def test_cost_is_packed_with_the_record(runs, tmp_path):
    cost = _cost(runs[0], 30.0, seconds=0.25, peak_bytes=10, device="cuda:0", iterations=12)
    cost.write(runs[0].path)
    assert RunCost.read(runs[0]) == cost
    assert RunCost.read(load_any_run(pack(runs[0], tmp_path / "a.robustflow"))) == cost
    assert RunCost.read(runs[1]) is None


@pytest.mark.parametrize(
    "change",
    [
        {"parameters": -1},
        {"seconds": float("nan")},
        {"version": 2},
        {"run": "0" * 16},
        "{",
        " " * 2_000_000 + "{}",
    ],
    ids=lambda change: str(change)[:20],
)
def test_damaged_cost_file_is_refused(runs, change):
    path = runs[0].path / PROFILE
    if isinstance(change, dict):
        change = json.dumps(sealed(_cost(runs[0], 1.0).model_dump() | change))
    path.write_text(change)
    refusal(lambda: RunCost.read(runs[0]), RunError, path)


def test_pipe_as_cost_file_is_refused_at_once(runs):
    os.mkfifo(runs[0].path / PROFILE)
    assert RunCost.read(runs[0]) is None


@pytest.mark.parametrize(("key", "value"), [("name", "two"), ("iterations", 24), ("tile", [432, 960])])
def test_cost_of_a_different_model_is_refused(runs, key, value):
    one = {"name": "one", "device": "cuda", "checkpoint": "abc"}
    check_profiled_model(runs[0], one)
    refusal(lambda: check_profiled_model(runs[0], one | {key: value}), UsageError, key)
