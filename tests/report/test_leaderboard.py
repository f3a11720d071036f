"""The leaderboard contains the paper's numbers, marks and ranks, and derives the values that the paper
does not print.
"""

from __future__ import annotations

import csv
import io
from statistics import fmean
from typing import ClassVar

import pytest

from robustflow.corruptions.registry import FAMILIES, PAPER_ORDER
from robustflow.report.leaderboard import PLACE, boards_of, by_error
from robustflow.report.render import render
from robustflow.report.site.content import whole_content
from robustflow.report.site.headline import headline
from robustflow.report.tables import build_table
from robustflow.stats.model_result import ModelResult, Value
from robustflow.stats.published.tables import published_costs, published_results
from robustflow.stats.results import SETTING_LABELS
from robustflow.stats.results_file import parse_results, results_csv


def _cells_of(results):
    """The cells of each line by key, in the order of the lines."""
    boards = boards_of(results, {})
    cells = {line.result: board.cells_of(line) for board in boards for line in board.lines}
    return {line: cells[line] for line in results}


def _file(text: str, *columns: str) -> list[ModelResult]:
    return parse_results(",".join(("setting,model,metric,corruption,value", *columns)) + "\n" + text, "a.csv", "a")


_CELLS = _cells_of(published_results())
_SETTING_OF = {label: setting for setting, label in SETTING_LABELS.items()}


def _published(benchmark: str, setting: str, name: str):
    of = (benchmark, setting, name)
    return next(cells for line, cells in _CELLS.items() if (line.benchmark, line.setting, line.name) == of)


def _best(cells):
    return {key for key, cell in cells.items() if cell.best}


@pytest.mark.parametrize("table", ["epe", "cre", "rcre", "gopro-rcre"])
def test_values_and_marks_are_those_of_the_tables(table):
    """Compare every cell of Tab. 2, 4, 7 and 8, and its bold mark, with the table that the renderers receive."""
    metric = table.removeprefix("gopro-")
    benchmark = "gopro-fc" if table.startswith("gopro") else "kitti-fc"
    built = build_table(table, published_results())
    names = ["clean"] * (metric == "epe")
    measured = {c for line, cells in _CELLS.items() if line.benchmark == benchmark for m, c in cells if m == metric}
    names += [name for name in PAPER_ORDER if name in measured] + ["average"]
    count = 0
    for section in built.sections:
        for line in section.lines:
            shown = _published(benchmark, _SETTING_OF[section.title], line.label)
            for name, cell in zip(names, line.cells, strict=True):
                assert (shown[metric, name].text, shown[metric, name].best) == (cell.text, cell.best)
                count += 1
    assert count == {"epe": 29 * 22, "cre": 29 * 21, "rcre": 29 * 21, "gopro-rcre": 11 * 25}[table]


def test_ranks_and_cost_are_those_that_the_paper_prints():
    for name, cost in published_costs().items():
        in_settings = ("OOD", cost.crer_ood, cost.average_rank_ood), ("ID", cost.crer_id, cost.average_rank_id)
        for setting, crer, rank in in_settings:
            if rank is None:
                continue
            cells = _published("kitti-fc", setting, name)
            assert (cells["rank", ""].text, cells["rank", ""].best) == (str(rank), rank == 1)
            assert cells["crer", "average"].text == f"{crer:.2f}"
            assert cells["parameters", ""].text == f"{cost.parameters_m:.2f}"
            assert cells["flops", ""].text == f"{cost.flops_g:.1f}"


def test_crer_that_the_paper_does_not_print_is_derived_and_unmarked():
    cells = _published("kitti-fc", "OOD", "FlowDiffuser")
    clean, whole = (float(cells["epe", name].text) for name in ("clean", "average"))
    assert float(cells["crer", "average"].text) == pytest.approx((whole - clean) / clean, abs=0.005)
    assert [key for key, cell in cells.items() if cell.derived] == [("crer", "average")]
    assert not cells["crer", "average"].best
    assert not any(("crer", "average") in cells for line, cells in _CELLS.items() if line.benchmark == "gopro-fc")


def test_class_means_are_means_of_the_printed_values():
    cells = _published("kitti-fc", "OOD", "CSFlow")
    for family in ("weather", "noise"):
        values = [float(cells["cre", name].text) for name in FAMILIES[family]]
        assert float(cells["cre", family].text) == pytest.approx(fmean(values), abs=0.005)


def test_knowledge_driven_methods_and_single_models_are_not_marked():
    assert not any(_best(cells) for line, cells in _CELLS.items() if line.setting == "knowledge")
    (alone,) = _cells_of(_file("OOD,A,epe,clean,2.00\n")).values()
    assert not _best(alone)
    two = _cells_of(_measured_lines(("A", "OOD", 2.0), ("B", "OOD", 2.01)))
    assert [bool(_best(cells)) for cells in two.values()] == [True, False]


def test_runs_of_one_name_on_different_frames_are_not_ranked_together():
    own = _file("OOD,RAFT,epe,clean,0.10,mine\nOOD,RAFT,epe,average,0.20,mine\n", "sample_set")
    content = whole_content([], [("a.csv", own)])
    mine = content.lines[-1]
    assert mine.frames == "mine"
    assert list(content.pages.values()).count(content.pages[mine]) == 1
    assert ("flops", "") not in content.cells[mine]
    before = {(line.setting, line.name): _best(cells) for line, cells in _CELLS.items() if line.benchmark == "kitti-fc"}
    rest = [line for line in content.lines if line.benchmark == "kitti-fc" and line != mine]
    assert {(line.setting, line.name): _best(content.cells[line]) for line in rest} == before


def test_missing_values_are_sorted_last():
    results = _file("OOD,A,epe,average,5.00\nOOD,B,cre,fog,1.00\nOOD,C,epe,average,4.00\n")
    assert [line.name for line in sorted(results, key=by_error)] == ["C", "A", "B"]
    (board,) = boards_of(results, {})
    assert [line.label for line in board.lines] == ["C", "A", "B"]


def test_claimed_lines_have_no_best_value_and_are_ranked_by_no_sentence():
    lines = _file("own,A,epe,average,1.00\nown,B,epe,average,2.00\n")
    assert not any(map(_best, _cells_of(lines).values()))
    (only,) = headline(whole_content([], [("a.csv", lines)], published=False))
    assert only.startswith("Not ranked here: 2 claimed lines")


def test_results_file_that_names_a_measured_or_the_published_sample_set_is_a_group_below_them(small_run):
    """A file with half of every value of a run, the paper's numbers halved, and their sample sets."""
    content = whole_content([small_run])
    rows = list(csv.DictReader(io.StringIO(results_csv(content.lines))))
    halved = [
        f"{row['benchmark']},{row['setting']},{row['model']} halved,{row['metric']},{row['corruption']},"
        f"{float(row['value']) / 2},{row['sample_set']},yes"
        for row in rows
    ]
    text = "benchmark,setting,model,metric,corruption,value,sample_set,marked\n" + "\n".join(halved) + "\n"
    both = whole_content([small_run], [("halved.csv", parse_results(text, "halved.csv", "halved"))])
    assert {line.source for line in both.lines} == {"measured", "published", "claimed"}
    for board in both.boards:
        sections = [{line.result.source for line in section.lines} for section in board.sections]
        assert sections[-1] == {"claimed"}
        assert len(sections) == 2
        claimed = board.sections[-1]
        assert claimed.title.startswith("Claimed: halved.csv")
        assert not any(cell.best for line in claimed.lines for cell in line.cells)
    before = {line.key: _best(content.cells[line]) for line in content.lines}
    assert {line.key: _best(both.cells[line]) for line in both.lines if line.source != "claimed"} == before
    assert not any("halved" in sentence for sentence in headline(both))


class _Measured(ModelResult):
    """The table entry of a run without cost, coverage and intervals."""

    cost = coverage = None
    intervals: ClassVar = {}


def _measured_lines(*models: tuple[str, str, float]) -> list[ModelResult]:
    return [
        _Measured(
            *("kitti-fc", "here", setting, name, ""),
            {("epe", "average"): Value(number)},
            run=object(),
            exclusion=lambda name=name: "it is blind" if name == "Blind" else "",
        )
        for name, setting, number in models
    ]


def _places(*models: tuple[str, str, float]) -> dict[str, str | None]:
    cells = _cells_of(_measured_lines(*models))
    return {line.name: of_line[PLACE].text if PLACE in of_line else None for line, of_line in cells.items()}


def test_measured_models_of_every_setting_are_ranked_together_and_excluded_or_single_ones_not():
    sound = [("DIS", "knowledge", 3.0), ("A", "OOD", 2.0), ("B", "ID", 3.0), ("C", "own", 4.0)]
    ranks = _places(*sound, ("Blind", "OOD", 1.0))
    assert ranks == {"DIS": "2", "Blind": None, "A": "1", "B": "2", "C": "4"}
    assert _places(("DIS", "knowledge", 3.0), ("Blind", "OOD", 1.0)) == {"DIS": None, "Blind": None}


def test_mark_of_the_best_value_skips_an_excluded_line_that_comes_first():
    cells = _cells_of(_measured_lines(("Blind", "OOD", 1.0), ("A", "OOD", 2.0), ("B", "OOD", 3.0)))
    assert [line.name for line, of_line in cells.items() if _best(of_line)] == ["A"]


@pytest.mark.parametrize("sets", [("a",), ("a", "b")])
def test_remark_about_groups_appears_only_with_several_groups(sets):
    lines = _file("".join(f"OOD,{name},epe,clean,1.00,{name}\n" for name in sets), "sample_set")
    (board,) = boards_of(lines, {})
    assert ("Rows are sorted within each group." in board.remarks) == (len(sets) > 1)


def test_every_renderer_writes_a_leaderboard_like_any_table():
    (board,) = boards_of(_file("OOD,A|B,epe,average,2.00\n"), {"a": "Frames of a"})
    assert list(csv.DictReader(io.StringIO(render(board, "csv")))) == [
        {"section": "Frames of a", "model": "A|B", "EPE": "2.00", "best": "", "note": ""}
    ]
    assert "A\\|B" in render(board, "markdown")
