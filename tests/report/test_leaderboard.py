"""The leaderboard has the paper's numbers, marks and ranks, keeps sample sets apart, and no shortened flow wins."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable
from statistics import fmean

import numpy as np
import polars as pl
import pytest

import robustflow as rf
from robustflow.corruptions.registry import FAMILIES
from robustflow.models import load_model
from robustflow.models.provenance import Training
from robustflow.report.leaderboard import GROUP, board_cells, boards_of, by_error
from robustflow.report.paper_tables import build_table, cost_table
from robustflow.report.render import render
from robustflow.report.site.content import whole_content
from robustflow.report.tables import tables_of
from robustflow.run.run import Run
from robustflow.stats.lines import Lines, Numbers, lines_of
from robustflow.stats.published.tables import published_costs, published_lines
from robustflow.stats.results_file import parse_results, results_csv
from tests.made_rows import change_manifest

EPE = ("epe", "average", None)


def _file(text: str, *columns: str) -> pl.DataFrame:
    return parse_results(",".join(("setting,model,metric,corruption,value", *columns)) + "\n" + text, "a.csv", "a")


_CELLS = board_cells(published_lines())


def _published(benchmark: str, setting: str, name: str):
    of = (benchmark, setting, name)
    return next(cells for key, cells in _CELLS.items() if (key.benchmark, key.setting, key.model) == of)


def _best(cells):
    return {key for key, cell in cells.items() if cell.best}


def test_ranks_and_cost_are_those_that_the_paper_prints():
    for name, cost in published_costs().items():
        for setting in ("OOD", "ID"):
            rank = cost[f"average_rank_{setting.lower()}"]
            if not rank:
                continue
            cells = _published("kitti-fc", setting, name)
            assert (cells["average_rank", "", None].text, cells["average_rank", "", None].best) == (rank, rank == "1")
            assert cells["crer", "average", None].text == cost[f"crer_{setting.lower()}"]
            assert cells["parameters", "", None].text == cost["parameters_m"]
            assert cells["flops", "", None].text == cost["flops_g"]


def test_crer_and_class_means_that_the_paper_does_not_print_are_derived_and_unmarked():
    cells = _published("kitti-fc", "OOD", "FlowDiffuser")
    clean, whole = (float(cells["epe", name, None].text) for name in ("clean", "average"))
    assert float(cells["crer", "average", None].text) == pytest.approx((whole - clean) / clean, abs=0.005)
    assert [key for key, cell in cells.items() if cell.derived] == [("crer", "average", None)]
    assert not cells["crer", "average", None].best
    assert not any(("crer", "average", None) in cells for key, cells in _CELLS.items() if key.benchmark == "gopro-fc")
    cells = _published("kitti-fc", "OOD", "CSFlow")
    for family in ("weather", "noise"):
        values = [float(cells["cre", name, None].text) for name in FAMILIES[family]]
        assert float(cells["cre", family, None].text) == pytest.approx(fmean(values), abs=0.005)


def _measured(*models: tuple[str, str, float]) -> Lines:
    made = "\n".join(
        f"{setting},{name},epe,{of},{number}" for name, setting, number in models for of in ("clean", "average")
    )
    return {
        key: Numbers(
            (of, row | {"source": "measured", "excluded": "it is blind" if key.model == "Blind" else ""})
            for of, row in line.items()
        )
        for key, line in lines_of(_file(f"{made}\n")).items()
    }


@pytest.mark.parametrize(
    ("models", "best"),
    [
        ([("A", "OOD", 2.0), ("B", "OOD", 2.01)], {"A"}),
        (
            [
                ("DIS", "knowledge", 3.0),
                *(("A", "OOD", 2.0), ("B", "ID", 3.0), ("C", "UNKNOWN", 4.0), ("Blind", "OOD", 1.0)),
            ],
            set(),
        ),
        ([("DIS", "knowledge", 3.0), ("Blind", "OOD", 1.0)], set()),
        ([("Blind", "OOD", 1.0), ("A", "OOD", 2.0), ("B", "OOD", 3.0)], {"A"}),
    ],
)
def test_marks_are_within_one_setting(models, best):
    """Excluded models, a single model and knowledge-driven ones have no mark."""
    cells = board_cells(_measured(*models))
    assert {key.model for key, of in cells.items() if of[EPE].best} == best


def test_group_letters_are_within_one_setting(many_images):
    """Excluded models and a single model of a setting have none."""
    runs = [many_images("A"), many_images("Bb", 1.22, seed=1), many_images("Ccc", 3.0)]
    change_manifest(runs[1], training=Training(sets=("kitti2015",), basis="declared"))
    cells = board_cells(whole_content(runs, published=False).lines)
    assert {key.model for key, of in cells.items() if GROUP in of} == {"A", "Ccc"}


def test_models_that_a_paired_test_cannot_tell_apart_share_a_group_letter(many_images):
    """A and Bb differ by less than the images allow to tell; Ccc has three times the error of A."""
    runs = [many_images("A"), many_images("Bb", 1.22, seed=1), many_images("Ccc", 3.0)]
    content = whole_content(runs, published=False)
    letters = {key.model: cells[GROUP].text for key, cells in board_cells(content.lines).items()}
    assert letters == {"A": "a", "Bb": "a", "Ccc": "b"}
    assert "Rank" not in [column.label for board in content.boards for column in board.columns]
    equal = whole_content([many_images("A"), many_images("Bb")], published=False)
    assert {cells[GROUP].text for cells in board_cells(equal.lines).values()} == {"a"}


def test_runs_have_intervals(many_images):
    content = whole_content([many_images("A"), many_images("Bb", 1.5)], published=False)
    for key, cells in board_cells(content.lines).items():
        low, high = content.lines[key].ends("cre", "average")
        assert low < content.lines[key].number("cre", "average") < high
        assert cells["cre", "average", None].interval == f"[{low:.2f}, {high:.2f}]"


def test_results_on_different_frames_are_not_ranked_together():
    own = _file("OOD,RAFT,epe,clean,0.10,mine\nOOD,RAFT,epe,average,0.20,mine\n", "sample_set")
    content = whole_content([], [("a.csv", own)])
    cells, mine = board_cells(content.lines), list(content.lines)[-1]
    assert mine.sample_set == "mine"
    assert list(content.pages.values()).count(content.pages[mine]) == 1
    assert ("flops", "", None) not in cells[mine]
    assert {key: _best(of) for key, of in cells.items() if key != mine} == {
        key: _best(of) for key, of in _CELLS.items()
    }


def test_missing_values_are_sorted_last():
    results = lines_of(_file("OOD,A,epe,average,5.00\nOOD,B,cre,fog,1.00\nOOD,C,epe,average,4.00\n"))
    assert [key.model for key, _ in sorted(results.items(), key=by_error)] == ["C", "A", "B"]
    (board,) = boards_of(results, {"a": "Frames of a"})
    assert [line.label for line in board.lines] == ["C", "A", "B"]
    assert list(csv.DictReader(io.StringIO(render(board, "csv"))))[1]["EPE"] == "5.00"


def test_results_file_that_names_a_measured_or_the_published_sample_set_is_a_group_below_them(small_run):
    """A file with half of every value of a run, the paper's numbers halved, and their sample sets."""
    content = whole_content([small_run])
    rows = list(csv.DictReader(io.StringIO(results_csv(content.frame))))
    halved = [
        f"{row['benchmark']},{row['setting']},{row['model']} halved,{row['metric']},{row['corruption']},"
        f"{float(row['value']) / 2},{row['sample_set']},yes"
        for row in rows
    ]
    text = "benchmark,setting,model,metric,corruption,value,sample_set,marked\n" + "\n".join(halved) + "\n"
    both = whole_content([small_run], [("halved.csv", parse_results(text, "halved.csv", "halved"))])
    assert {line.fact("source") for line in both.lines.values()} == {"measured", "published", "claimed"}
    for board in both.boards:
        sections = [{both.lines[line.result].fact("source") for line in part.lines} for part in board.sections]
        assert (len(sections), sections[-1]) == (2, {"claimed"})
        assert not any(cell.best for line in board.sections[-1].lines for cell in line.cells)
    before, after = board_cells(content.lines), board_cells(both.lines)
    assert {key: _best(after[key]) for key in before} == {key: _best(cells) for key, cells in before.items()}


def _clipped(flow: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(flow, axis=-1, keepdims=True)
    return np.where(length > 3, flow * (3 / np.maximum(length, 1)), flow).astype(np.float32)


class _Changed:
    """DIS with a changed flow."""

    def __init__(self, name: str, change: Callable[[np.ndarray], np.ndarray]) -> None:
        self._name, self._change, self._dis = name, change, load_model("dis")

    def predict(self, first: np.ndarray, second: np.ndarray) -> np.ndarray:
        return self._change(self._dis.predict(first, second))

    def identity(self) -> dict[str, str]:
        return {"name": self._name}


_MODELS = {
    "sound": lambda flow: flow,
    "x 0.9": lambda flow: np.float32(0.9) * flow,
    "x 0.6": lambda flow: np.float32(0.6) * flow,
    "clipped": _clipped,
}


@pytest.fixture(scope="module")
def models(tmp_path_factory) -> dict[str, Run]:
    """Runs of DIS and of DIS with shorter flows on the same 16 pairs. A flow of 0.6 times the length is accurate enough
    to be ranked."""
    options = {"corruptions": ["fog", "contrast", "gaussian_noise"], "severities": [3], "limit": 16}
    return {
        name: rf.evaluate(_Changed(name, change), "shapes", output=tmp_path_factory.mktemp("short"), **options)
        for name, change in _MODELS.items()
    }


@pytest.mark.parametrize("short", ["x 0.9", "x 0.6", "clipped"])
def test_shortened_flow_leads_no_board_and_has_no_bold_value(models, short):
    """It has the lower CRE and RCRE, but the larger error."""
    content = whole_content([models[short], models["sound"]], published=False)
    keys = {key.model: key for key in content.lines}
    (sound, other), cells = (content.lines[keys[name]] for name in ("sound", short)), board_cells(content.lines)
    for of in (("cre", "average"), ("rcre", "average")):
        assert other.number(*of) < sound.number(*of)
    assert [line.label for line in content.boards[0].lines] == ["sound", short]
    excluded = bool(other.fact("excluded"))
    assert not _best(cells[keys[short]])
    assert _best(cells[keys["sound"]]) == (set() if excluded else {of for of in cells[keys["sound"]] if of[0] == "epe"})
    for name in ("epe", "cre", "rcre", "cost"):
        table = cost_table(content.lines) if name == "cost" else build_table(name, content.lines)
        marked = {line.label for line in table.lines if line.best or any(cell.best for cell in line.cells)}
        assert marked == ({"sound"} if name == "epe" and not excluded else set())


def test_comparison_without_a_metric_follows_the_error(models):
    comparison = rf.compare(models["x 0.9"], models["sound"])
    assert comparison.metric == "epe"
    cells = [line.cells for section in comparison.table().sections for line in section.lines]
    assert any(second.best for _, second, *_ in cells)
    assert not any(first.best for first, *_ in cells)


def test_board_without_ground_truth_shows_what_tells_a_blind_model_from_a_robust_one(runs_without_truth):
    """The length of the flow, and the photometric errors of the flow and of zero flow."""
    content = whole_content(runs_without_truth, published=False)
    for cells, run in zip(board_cells(content.lines).values(), runs_without_truth, strict=True):
        clean = run.rows.filter(corruption="clean")
        shown = {key: cell.text for key, cell in cells.items()}
        assert shown["flow_length", "clean", None] == f"{(clean['pred_magnitude_sum'] / clean['n_all']).mean():.2f}"
        for name in ("photometric", "photometric_still"):
            assert shown[name, "clean", None] == f"{(clean[f'{name}_sum'] / clean['n_photometric']).mean():.2f}"
        assert GROUP not in cells
    for table in tables_of(runs_without_truth, published=False):
        assert not any("paper" in line.note for line in table.lines)
        assert not any(column.label == "clean EPE (px)" for column in table.columns)
