"""Every format contains the same numbers, and shows hostile names as text."""

from __future__ import annotations

import csv
import io
import re
import shutil
import subprocess
import unicodedata
from dataclasses import replace

import pytest
from rich.cells import cell_len

from robustflow.core.errors import UsageError
from robustflow.paper.observations import observations_table
from robustflow.report.render import FORMATS, render
from robustflow.report.render.latex import escape
from robustflow.report.render.terminal import render as render_terminal
from robustflow.report.table import Column, Line, Section, Table, TableCell
from robustflow.report.tables import TABLES, build_table
from robustflow.stats.published.tables import published_results

from .elements import Elements
from .hostile import HOSTILE


def _table(name: str, note: str = "") -> Table:
    line = Line(name, (TableCell("1.00", True), TableCell("-0.50")), note)
    return Table("x", f"Errors of {name}", (Column("Clean"), Column("Fog", name)), (Section(name, (line,)),), (name,))


@pytest.mark.parametrize("name", TABLES)
@pytest.mark.parametrize("format", FORMATS)
def test_rendered_tables_contain_every_number(name, format):
    table = build_table(name, published_results())
    text = render(table, format)
    found = re.findall(r"-?\d+\.\d+", text)
    for section in table.sections:
        for line in section.lines:
            assert line.label in text.replace("\\", "")
            for cell in line.cells:
                number = re.match(r"-?\d+\.\d+", cell.text)
                assert number is None or number[0] in found
    assert text.endswith("\n")


def test_csv_reads_back_equal():
    table = build_table("epe", published_results())
    lines = list(csv.DictReader(io.StringIO(render(table, "csv"))))
    assert len(lines) == 29
    raft = next(line for line in lines if line["model"] == "RAFT" and line["section"].startswith("In"))
    assert raft["Weather Snow"] == "35.76"
    samflow = next(line for line in lines if line["model"] == "SAMFlow-H" and line["section"].startswith("Out"))
    assert "Clean" in samflow["best"].split("; ")


@pytest.mark.parametrize("format", FORMATS)
@pytest.mark.parametrize("name", HOSTILE)
def test_every_format_removes_control_characters(name, format):
    text = render(_table(name, note=name), format)
    assert not re.search("[\x00-\x09\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]", text)


@pytest.mark.parametrize("name", HOSTILE)
def test_html_of_a_hostile_name_is_text(name):
    found = Elements(render(_table(name, note=name), "html")).found
    known = {"figure", "figcaption", "table", "thead", "tbody", "tr", "th", "td", "b", "p", "sup"}
    assert {tag for tag, _ in found} <= known
    assert {name for _, attributes in found for name in attributes} <= {"class", "scope", "colspan"}


@pytest.mark.parametrize("name", HOSTILE)
def test_csv_escapes_names_that_look_like_formulas(name):
    rows = list(csv.reader(io.StringIO(render(_table(name, note=name), "csv"))))
    assert len(rows) == 2
    assert len(rows[0]) == len(rows[1]) == 6
    for cell in (unicodedata.normalize("NFKC", cell) for cell in rows[0] + rows[1]):
        assert cell[:1] not in ("=", "+", "@")
        assert cell[:1] != "-" or re.fullmatch(r"-?\d+\.\d+", cell)


@pytest.mark.parametrize("name", HOSTILE)
def test_markdown_of_a_hostile_name_stays_in_its_cell(name):
    rows = [line for line in render(_table(name, note=name), "markdown").splitlines() if line.startswith("|")]
    assert len(rows) == 4
    for row in rows:
        assert len(re.findall(r"(?<!\\)\|", row)) == 4
        plain = row.replace("<sup>1</sup>", "")
        assert "<" not in plain
        assert not re.search(r"(?<!\\)(`|\[|\]|\$)", plain)


@pytest.mark.parametrize("colour", [True, False])
@pytest.mark.parametrize("name", HOSTILE)
def test_terminal_shows_markup_as_text(name, colour):
    text = render_terminal(_table(name, note=name), colour=colour)
    sequences = set(re.findall("\x1b[^m]*m", text))
    assert all(re.fullmatch("\x1b\\[[0-9;]*m", sequence) for sequence in sequences)
    assert "\x1b]" not in text
    if name.startswith("[red]"):
        assert "[red]" in text


@pytest.mark.parametrize("width", [60, 80, 200])
def test_terminal_table_is_never_wider_than_the_terminal(width):
    text = render_terminal(build_table("epe", published_results()), width)
    assert max(map(len, text.splitlines())) <= width
    assert "51.76" in text


@pytest.mark.parametrize("name", ["a name " * 12, "光流" * 40])
@pytest.mark.parametrize("width", [60, 80, 120])
def test_the_terminal_cuts_names_and_no_numbers(width, name):
    cells = tuple(TableCell(f"{index}2.34 [10.00, 15.{index}0]", best=True) for index in range(8))
    columns = tuple(Column(f"corruption {index}") for index in range(8))
    sections = tuple(Section(title, (Line(name, cells, note="a note"),)) for title in ("Runs", name))
    text = render_terminal(Table("x", "Means", columns, sections), width)
    assert max(map(cell_len, text.splitlines())) <= width
    assert all(text.count(f" {cell.text}*") == 2 for cell in cells)
    assert text.count("… [1]") >= 2


@pytest.mark.parametrize("width", [60, 120])
def test_the_terminal_does_not_cut_an_address(width):
    address = f"https://example.org/{'weights/' * 20}raft.ckpt"
    line = Line("RAFT", (TableCell(f"get {address} as a stand-in"),))
    text = render_terminal(Table("plan", "plan", (Column("How", prose=True),), (Section("OOD", (line,)),)), width)
    assert max(map(len, text.splitlines())) <= width
    assert address in "".join(part.rpartition("│")[2].strip() for part in text.splitlines())


@pytest.mark.parametrize("name", HOSTILE)
def test_latex_of_a_hostile_name_has_no_live_command(name):
    text = render(_table(name, note=name), "latex")
    bare = re.sub(r"\\[{}$&#%_]|\\text[a-z]+\{\}|\\dots\{\}|-\{\}", "", text)
    row = next(line for line in bare.splitlines() if line.endswith(r"\\") and "1.00" in line)
    for line in (row, bare.splitlines()[-3]):
        # the remaining braces are balanced and belong to our own commands
        ours = ("textbf", "textsuperscript", "caption", "boldmath", "cellcolor")
        assert set(re.findall(r"\\([a-zA-Z]+)", line)) <= set(ours)
        assert line.count("{") == line.count("}")
    assert text.count(r"\end{tabular}") == 1


def test_latex_has_no_ligature_of_dashes_or_commas():
    text = escape("a--b---c----d,,e,,,f")
    assert "--" not in text
    assert ",," not in text
    assert text.replace("{}", "") == "a--b---c----d,,e,,,f"


@pytest.mark.skipif(shutil.which("pdflatex") is None, reason="pdflatex is not installed")
def test_latex_of_every_table_compiles(tmp_path):
    parts = [render(build_table(name, published_results()), "latex") for name in TABLES]
    parts += [render(_table(name, note=name), "latex") for name in HOSTILE]
    parts.append(render(observations_table(), "latex"))
    head = r"\documentclass{article}\usepackage[T1]{fontenc}\usepackage{textcomp,booktabs,graphicx}\begin{document}"
    (tmp_path / "t.tex").write_text("\n".join([head, *(f"{part}\\clearpage" for part in parts), r"\end{document}"]))
    command = ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "t.tex"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, check=False)
    assert done.returncode == 0, done.stdout[-2000:]
    assert b"Float too large" not in done.stdout


def test_latex_shades_as_the_paper_does_and_can_be_referred_to():
    epe = render(build_table("epe", published_results()), "latex")
    assert r"\label{tab:robustflow-epe}" in epe
    best = r"SAMFlow-H & \cellcolor{gray!20}\textbf{3.78} & \cellcolor{gray!20}\textbf{7.08} & "
    assert best in epe
    cost = render(build_table("cost", published_results()), "latex")
    shaded = [line.split(" & ")[0] for line in cost.splitlines() if line.startswith(r"\rowcolor{gray!20}")]
    assert shaded == [r"\rowcolor{gray!20}CSFlow", r"\rowcolor{gray!20}ARFlow"]
    assert r"\cellcolor" not in cost


def test_latex_of_sentences_longer_than_a_page_continues_in_another_table():
    table = observations_table()
    text = render(table, "latex")
    assert text.count(r"\begin{table*}") == text.count(r"\caption") == 3
    assert "observations (1 of 3)" in text
    titles = [section.title for section in table.sections]
    assert re.findall(r"\\textit{\\textbf{(.*)}}}", text) == [escape(title) for title in titles]
    short = replace(table, sections=table.sections[:2])
    assert render(short, "latex").count(r"\begin{table*}") == 1
    assert "(1 of" not in render(short, "latex")


def test_latex_of_many_lines_continues_in_another_table():
    runs = [
        Section(f"run {index}", tuple(Line(f"part {n}", (TableCell("1.00"),)) for n in range(36))) for index in range(3)
    ]
    text = render(Table("anatomy", "Anatomy", (Column("CRE"),), tuple(runs), ("The end.",)), "latex")
    floats = text.split(r"\end{table*}")[:-1]
    assert [re.findall(r"run \d", part) for part in floats] == [["run 0"], ["run 1"], ["run 2"]]
    assert [part.count("part ") for part in floats] == [36, 36, 36]
    assert ["The end." in part for part in floats] == [False, False, True]


def test_custom_table_format_is_available(tmp_path, monkeypatch):
    (tmp_path / "mine_json.py").write_text(
        "import json\n\n\ndef lines(table):\n"
        "    return json.dumps([[c.text for c in line.cells] for s in table.sections for line in s.lines])\n\n\n"
        "def broken(table):\n    return table.rows\n\n\ndef nothing(table):\n    return None\n"
    )
    monkeypatch.chdir(tmp_path)
    assert render(_table("RAFT"), "mine_json:lines") == '[["1.00", "-0.50"]]'
    with pytest.raises(UsageError, match="'mine_json:broken' failed on table 'x': AttributeError"):
        render(_table("RAFT"), "mine_json:broken")
    with pytest.raises(UsageError, match="returned NoneType for table 'x', not text"):
        render(_table("RAFT"), "mine_json:nothing")
    with pytest.raises(UsageError, match="unknown attribute of mine_json 'line': did you mean 'lines'"):
        render(_table("RAFT"), "mine_json:line")
    with pytest.raises(UsageError, match="unknown format 'latx': did you mean 'latex'"):
        render(_table("RAFT"), "latx")


def test_terminal_prints_the_end_of_long_names_that_distinguishes_two_runs():
    names = [f"DIS (KITTI flow 2015, preset {preset})" for preset in ("medium", "ultrafast")]
    lines = tuple(Line(name, (TableCell("1.00"),)) for name in names)
    text = render(Table("x", "Errors", (Column("Clean"),), (Section("Runs", lines),)), "terminal")
    assert all(name in text for name in names)
