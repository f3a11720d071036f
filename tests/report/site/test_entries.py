"""The leaderboard carries the paper's numbers, marks and ranks, and what the paper does not print is made from them."""

from __future__ import annotations

from statistics import fmean
from typing import ClassVar

import pytest

from robustflow.analysis.imported import NOTE
from robustflow.analysis.labels import SETTING_LABELS
from robustflow.analysis.model_result import ModelResult, Value, merged
from robustflow.analysis.published.tables import published_costs, published_results
from robustflow.analysis.results_file import parse_results
from robustflow.corruptions.registry import FAMILIES, PAPER_ORDER
from robustflow.report.site.entries import PLACE, default_order, entries_of
from robustflow.report.tables import build_table

_ENTRIES = entries_of(published_results(), published_costs())
_SETTING_OF = {label: setting for setting, label in SETTING_LABELS.items()}


@pytest.mark.parametrize("table", ["epe", "cre", "rcre", "gopro-rcre"])
def test_values_and_marks_are_those_of_the_tables(table):
    """Every cell of Tab. 2, 4, 7 and 8 with its bold mark, against the table that the renderers get."""
    metric = table.removeprefix("gopro-")
    benchmark = "gopro-fc" if table.startswith("gopro") else "kitti-fc"
    built = build_table(table, published_results())
    names = ["clean"] * (metric == "epe")
    measured = {c for e in _ENTRIES if e.line.benchmark == benchmark for m, c in e.texts if m == metric}
    names += [name for name in PAPER_ORDER if name in measured] + ["average"]
    count = 0
    for section in built.sections:
        for line in section.lines:
            entry = next(
                e
                for e in _ENTRIES
                if (e.line.benchmark, e.setting, e.model) == (benchmark, _SETTING_OF[section.title], line.label)
            )
            for name, cell in zip(names, line.cells, strict=True):
                assert entry.texts[metric, name] == cell.text
                assert ((metric, name) in entry.best) == cell.best
                count += 1
    assert count == {"epe": 29 * 22, "cre": 29 * 21, "rcre": 29 * 21, "gopro-rcre": 11 * 25}[table]


def test_ranks_and_cost_are_those_that_the_paper_prints():
    for name, cost in published_costs().items():
        for setting, crer, rank in (
            ("OOD", cost.crer_ood, cost.average_rank_ood),
            ("ID", cost.crer_id, cost.average_rank_id),
        ):
            if rank is None:
                continue
            entry = next(e for e in _ENTRIES if (e.line.benchmark, e.setting, e.model) == ("kitti-fc", setting, name))
            assert entry.numbers["rank", ""] == rank
            assert entry.texts["crer", "average"] == f"{crer:.2f}"
            assert (("rank", "") in entry.best) == (rank == 1)
            assert entry.numbers["parameters", ""] == cost.parameters_m
            assert entry.numbers["flops", ""] == cost.flops_g


def test_crer_that_the_paper_does_not_print_is_derived_and_unmarked():
    entry = next(e for e in _ENTRIES if (e.line.benchmark, e.setting, e.model) == ("kitti-fc", "OOD", "FlowDiffuser"))
    clean, whole = entry.numbers["epe", "clean"], entry.numbers["epe", "average"]
    assert entry.numbers["crer", "average"] == pytest.approx((whole - clean) / clean)
    assert ("crer", "average") in entry.derived
    assert ("crer", "average") not in entry.best
    assert not any(("crer", "average") in e.texts for e in _ENTRIES if e.line.benchmark == "gopro-fc")


def test_class_means_are_means_of_the_printed_values():
    entry = next(e for e in _ENTRIES if (e.line.benchmark, e.setting, e.model) == ("kitti-fc", "OOD", "CSFlow"))
    for family in ("weather", "noise"):
        values = [entry.numbers["cre", name] for name in FAMILIES[family]]
        assert entry.numbers["cre", family] == pytest.approx(fmean(values))


def test_knowledge_driven_methods_and_models_alone_are_not_marked():
    assert not any(entry.best for entry in _ENTRIES if entry.setting == "knowledge")
    head = "setting,model,metric,corruption,value\n"
    alone = entries_of(parse_results(head + "OOD,A,epe,clean,2.00\n", "a.csv", "a"), {})
    assert not alone[0].best
    two = entries_of(parse_results(head + "OOD,A,epe,clean,2.00\nOOD,B,epe,clean,2.004\n", "a.csv", "a"), {})
    assert [bool(entry.best) for entry in two] == [True, False]


def test_same_name_on_other_frames_is_another_page_and_no_rival():
    head = "setting,model,metric,corruption,value,sample_set\n"
    text = head + "OOD,RAFT,epe,clean,0.10,mine\nOOD,RAFT,epe,average,0.20,mine\n"

    entries = entries_of(merged([*parse_results(text, "a.csv", "a"), *published_results()]), published_costs())
    mine = entries[0]
    assert mine.page != next(e for e in entries if e.model == "RAFT" and e.line.frames == "paper").page
    assert ("flops", "") not in mine.texts
    before = {(e.setting, e.model): e.best for e in _ENTRIES if e.line.benchmark == "kitti-fc"}
    after = {
        (e.setting, e.model): e.best for e in entries if e.line.benchmark == "kitti-fc" and e.line.frames == "paper"
    }
    assert after == before


def test_order_puts_what_is_missing_last():
    head = "setting,model,metric,corruption,value\n"
    text = head + "OOD,A,epe,average,5.00\nOOD,B,cre,fog,1.00\nOOD,C,epe,average,4.00\n"
    entries = sorted(entries_of(parse_results(text, "a.csv", "a"), {}), key=default_order)
    assert [entry.model for entry in entries] == ["C", "A", "B"]


def test_imported_lines_are_the_best_of_nothing():
    lines = "setting,model,metric,corruption,value,note\n"
    numbers = [(model, f"own,{model},epe,fog,{value}") for model, value in (("A", "1.00"), ("B", "2.00"))]
    for note, best in (("", 1), (NOTE, 0)):
        text = lines + "".join(f'{line},"{note}"\n' for _, line in numbers)
        entries = entries_of(parse_results(text, "r.csv", "file"), {})
        assert len([entry for entry in entries if ("epe", "fog") in entry.best]) == best


class _Measured(ModelResult):
    """The line of a run without cost, coverage and intervals."""

    cost = coverage = None
    intervals: ClassVar = {}


def _measured(*models: tuple[str, str, float]):
    lines = [
        _Measured(
            *("kitti-fc", "here", setting, name, ""),
            {("epe", "average"): Value(number)},
            run=object(),
            exclusion=lambda name=name: "it is blind" if name == "Blind" else "",
        )
        for name, setting, number in models
    ]
    return {entry.line.name: entry.texts.get(PLACE) for entry in entries_of(lines, {})}


def test_measured_models_of_every_setting_are_ranked_together_and_excluded_ones_not():
    sound = [("DIS", "knowledge", 3.0), ("A", "OOD", 2.0), ("B", "ID", 3.0), ("C", "own", 4.0)]
    ranks = _measured(*sound, ("Blind", "OOD", 1.0))
    assert ranks == {"DIS": "2", "Blind": None, "A": "1", "B": "2", "C": "4"}


def test_a_single_measured_model_has_no_rank():
    assert _measured(("DIS", "knowledge", 3.0), ("Blind", "OOD", 1.0)) == {"DIS": None, "Blind": None}
