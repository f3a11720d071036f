"""The published values are compared with the paper's source, parsed here."""

from __future__ import annotations

import re

import polars as pl
import pytest

from robustflow.corruptions.registry import IMAGE_PAIR, PAPER_ORDER
from robustflow.stats.published.tables import method_of, published_costs, published_frame, published_methods

_KITTI = {"epe": "table:kitti-fc", "cre": "table:kitti_cre", "rcre": "table:kitti_rcre"}
_GOPRO_ORDER = [n for n in PAPER_ORDER if n not in ("h264_crf", "h264_abr", "bit_error")] + [
    "h264_abr",
    "h264_crf",
    "bit_error",
    "average",
]


def _tabular(tex: str, label: str) -> list[str]:
    """Lines of the tabular environment before a label, without rules."""
    end = tex.index(f"\\label{{{label}}}")
    start = tex.rindex("\\begin{tabular}", 0, end)
    body = tex[start : tex.index("\\end{tabular}", start)]
    body = re.sub(r"\\(hline|Xhline\{3\\arrayrulewidth\}|Xhline\{2\\arrayrulewidth\}|cline\{[^}]*\})", "", body)
    return body.split("\\\\")


def _cell(text: str) -> tuple[str, bool]:
    """A cell's printed text, and whether it is bold."""
    bold = "\\textbf" in text
    text = re.sub(r"\\(cellcolor|rowcolor)\{gray!20\}", "", text)
    text = text.replace('{\\"a}', "a").replace("\\&", "+")
    for _ in range(6):
        text = re.sub(r"\\multicolumn\{\d+\}\{[^{}]*\}\{((?:[^{}]|\{[^{}]*\})*)\}", r"\1", text)
        text = re.sub(r"\\(?:textbf|textit)\{((?:[^{}]|\{[^{}]*\})*)\}", r"\1", text)
        text = re.sub(r"~?\\(?:cite|tnote)\{[^{}]*\}", "", text)
    return text.replace("{", "").replace("}", "").strip(), bold


@pytest.fixture
def tex(shared):
    return (shared("paper") / "paper.tex").read_text(encoding="utf-8")


@pytest.mark.parametrize("metric", list(_KITTI))
def test_kitti_tables_are_those_of_the_paper(tex, metric):
    columns = (["clean"] if metric == "epe" else []) + [*IMAGE_PAIR, "average"]
    found = {}
    setting = "knowledge"
    for line in _tabular(tex, _KITTI[metric]):
        if re.search(r"out-of-domain", line, re.IGNORECASE):
            setting = "OOD"
        elif re.search(r"in-domain", line, re.IGNORECASE):
            setting = "ID"
        cells = [_cell(part) for part in line.split("&")]
        if len(cells) == len(columns) + 1 and re.fullmatch(r"-?\d+\.\d\d", cells[1][0]):
            for name, (value, bold) in zip(columns, cells[1:], strict=True):
                found[setting, cells[0][0], name] = (float(value), bold)
    ours = published_frame().filter(measure=metric, benchmark="kitti-fc")
    assert len(found) == 29 * len(columns)
    assert {
        (row["setting"], row["model"], row["condition"]): (row["value"], row["marked"])
        for row in ours.iter_rows(named=True)
    } == found
    assert set(ours["decimals"]) == {2}


def test_gopro_table_is_that_of_the_paper(tex):
    lines = [[_cell(part) for part in line.split("&")] for line in _tabular(tex, "table:gopro-fc")]
    lines = [line for line in lines if len(line) in (12, 13)]
    models = [name for name, _ in lines[0][1:]]
    values = [line[-11:] for line in lines[1:]]
    assert len(models) == 11
    found = {
        (model, name): (float(value), bold)
        for name, line in zip(_GOPRO_ORDER, values, strict=True)
        for model, (value, bold) in zip(models, line, strict=True)
    }
    ours = published_frame().filter(benchmark="gopro-fc")
    assert {(r["model"], r["condition"]): (r["value"], r["marked"]) for r in ours.iter_rows(named=True)} == found


def test_cost_table_is_that_of_the_paper(tex):
    found = {}
    for line in _tabular(tex, "tab:CRE_FLOPs"):
        cells = [_cell(part)[0] for part in line.split("&")]
        if len(cells) == 7 and cells[1][:1].isdigit():
            numbers = [re.findall(r"[\d.]+", cell) for cell in cells[1:]]
            found[cells[0]] = [float(number) for pair in numbers for number in pair]
    assert len(found) == 14
    for name, numbers in found.items():
        cost = published_costs()[name]
        fields = ("parameters_m", "flops_g", "flops_rank", "crer_ood", "crer_rank_ood", "crer_id", "crer_rank_id")
        ours = [cost[field] for field in (*fields, "average_rank_ood", "average_rank_id")]
        assert [float(value) for value in ours if value] == numbers, name


def test_methods_are_those_of_the_paper(tex):
    found = []
    for line in _tabular(tex, "tab:models"):
        cells = [_cell(part)[0] for part in line.replace("\\&", "+").split("&")]
        if len(cells) == 5 and cells[4].isdigit():
            found.append([cells[0], cells[1].lower(), *(c.strip("-") for c in cells[2:4]), int(cells[4])])
    ours = [[m.method, m.type, m.encoder, m.decoder, m.year] for m in published_methods().values()]
    assert ours == found
    assert len(ours) == 15


def test_published_tables_have_29_variants_of_15_methods():
    kitti = published_frame().filter(measure="epe")
    variants = set(kitti.select("setting", "model").iter_rows())
    assert len(variants) == 29
    assert {method_of(model).method for _, model in variants} == set(published_methods())
    tables = published_frame().filter(pl.col("measure").is_in(["epe", "cre", "rcre"]))
    assert tables.height == 29 * (22 + 21 + 21) + 11 * 25
