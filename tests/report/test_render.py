"""Every format has the same numbers, and one hostile table stays text in each."""

from __future__ import annotations

import csv
import io
import re
import shutil
import subprocess
import unicodedata
from dataclasses import replace
from functools import partial

import pytest
from rich.cells import cell_len

from robustflow.core.errors import UsageError
from robustflow.core.plugins import Registry
from robustflow.report import tables
from robustflow.report.paper_tables import PAPER_TABLES, build_table, cost_table
from robustflow.report.render import FORMATS, render
from robustflow.report.render.latex import escape
from robustflow.report.render.terminal import render as render_terminal
from robustflow.report.table import Column, Line, Section, Table, TableCell
from robustflow.report.tables import tables_of
from robustflow.stats.published.tables import published_lines

from ..refusals import refusal
from .elements import Elements
from .hostile import HOSTILE

PAPER = [*(build_table(name, published_lines()) for name in PAPER_TABLES), cost_table(published_lines())]
NAMES = [name or "(none)" for name in HOSTILE]
TABLE = Table(
    "x",
    f"Errors of {NAMES[0]}",
    (Column("Clean"), Column("Fog", group=NAMES[1])),
    tuple(Section(name, (Line(name, (TableCell("1.00", True), TableCell("-0.50")), name),)) for name in NAMES),
    tuple(NAMES),
)
"""A table in which every text is a hostile name."""


@pytest.mark.parametrize("format", FORMATS)
def test_rendered_tables_contain_every_number_and_name(format):
    for table in PAPER:
        text = render(table, format)
        found = re.findall(r"-?\d+\.\d+", text)
        assert table.lines
        assert all(line.label in text.replace("\\", "") for line in table.lines)
        numbers = (re.match(r"-?\d+\.\d+", cell.text) for line in table.lines for cell in line.cells)
        assert {number[0] for number in numbers if number} <= set(found)
        assert text.endswith("\n")


@pytest.mark.parametrize("format", FORMATS)
def test_every_format_removes_control_characters(format):
    assert not re.search("[\x00-\x09\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]", render(TABLE, format))


def test_html_of_hostile_names_is_text():
    found = Elements(render(TABLE, "html")).found
    known = {"figure", "figcaption", "table", "thead", "tbody", "tr", "th", "td", "b", "p", "sup"}
    assert {tag for tag, _ in found} <= known
    assert {name for _, attributes in found for name in attributes} <= {"class", "scope", "colspan"}


def test_csv_escapes_names_that_look_like_formulas_and_reads_back_equal():
    rows = list(csv.reader(io.StringIO(render(TABLE, "csv"))))
    assert {len(row) for row in rows} == {6}
    assert len(rows) == 1 + len(NAMES)
    for cell in (unicodedata.normalize("NFKC", cell) for row in rows for cell in row):
        assert cell[:1] not in ("=", "+", "@")
        assert cell[:1] != "-" or re.fullmatch(r"-?\d+\.\d+", cell)
    lines = list(csv.DictReader(io.StringIO(render(PAPER[0], "csv"))))
    assert len(lines) == 29
    raft = next(line for line in lines if line["model"] == "RAFT" and line["section"].startswith("In"))
    assert raft["Weather Snow"] == "35.76"
    samflow = next(line for line in lines if line["model"] == "SAMFlow-H" and line["section"].startswith("Out"))
    assert "Clean" in samflow["best"].split("; ")


def test_markdown_of_hostile_names_stays_in_its_cells():
    rows = [line for line in render(TABLE, "markdown").splitlines() if line.startswith("|")]
    assert len(rows) == 2 + 2 * len(NAMES)
    for row in rows:
        assert len(re.findall(r"(?<!\\)\|", row)) == 4
        plain = re.sub("</?sup>", "", row)
        assert "<" not in plain
        assert not re.search(r"(?<!\\)(`|\[|\]|\$)", plain)


@pytest.mark.parametrize("colour", [True, False])
def test_terminal_shows_markup_as_text(colour):
    text = render_terminal(TABLE, colour=colour)
    sequences = re.findall("\x1b[^m]*m", text)
    assert bool(sequences) == colour
    assert all(re.fullmatch("\x1b\\[[0-9;]*m", sequence) for sequence in sequences)
    assert "\x1b]" not in text
    assert "[red]" in text


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
    published = render_terminal(PAPER[0], width)
    assert max(map(len, published.splitlines())) <= width
    assert "51.76" in published


def test_the_terminal_cuts_no_address_and_no_end_of_a_name_that_distinguishes_runs():
    address = f"https://example.org/{'weights/' * 20}raft.ckpt"
    line = Line("RAFT", (TableCell(f"get {address} as a stand-in"),))
    text = render_terminal(Table("plan", "plan", (Column("How", prose=True),), (Section("OOD", (line,)),)), 60)
    assert max(map(len, text.splitlines())) <= 60
    assert address in "".join(part.rpartition("│")[2].strip() for part in text.splitlines())
    names = [f"DIS (KITTI flow 2015, preset {preset})" for preset in ("medium", "ultrafast")]
    lines = tuple(Line(name, (TableCell("1.00"),)) for name in names)
    text = render(Table("x", "Errors", (Column("Clean"),), (Section("Runs", lines),)), "terminal")
    assert all(name in text for name in names)


def test_latex_of_hostile_names_has_no_live_command():
    text = render(TABLE, "latex")
    bare = re.sub(r"\\[{}$&#%_]|\\text[a-z]+\{\}|\\dots\{\}|[-,]\{\}|\\\\", "", text)
    ours = "begin end centering resizebox linewidth toprule midrule bottomrule cmidrule multicolumn textit textbf"
    ours += " rotatebox cellcolor boldmath textsuperscript caption label usepackage sbox usebox ifdim wd else fi"
    assert set(re.findall(r"\\([a-zA-Z]+)", bare)) <= set(ours.split())
    lines = [line for line in bare.splitlines() if "1.00" in line]
    assert lines
    assert all(line.count("{") == line.count("}") for line in lines)
    assert text.count(r"\end{tabular}") == 1
    ligatures = escape("a--b---c----d,,e,,,f")
    assert "--" not in ligatures
    assert ",," not in ligatures
    assert ligatures.replace("{}", "") == "a--b---c----d,,e,,,f"


@pytest.fixture(scope="module")
def pasted(many_images) -> list[Table]:
    """Every table of three runs, in the order of a command that is not the alphabet's, with one name twice."""
    runs = [many_images("zebra", 1.2), many_images("apple_50%", 1.0), many_images("zebra", 1.5, seed=1)]
    return [*tables_of(runs, published=False), *(replace(table, name=f"paper-{table.name}") for table in PAPER), TABLE]


@pytest.mark.skipif(shutil.which("pdflatex") is None, reason="pdflatex is not installed (texlive-latex-recommended)")
def test_latex_of_every_table_compiles_with_the_packages_it_names(pasted, tmp_path):
    parts = [render(table, "latex") for table in pasted]
    (packages,) = {part.splitlines()[0].removeprefix("% needs ") for part in parts}
    head = rf"\documentclass{{article}}{packages}\begin{{document}}"
    (tmp_path / "t.tex").write_text("\n".join([head, *(f"{part}\\clearpage" for part in parts), r"\end{document}"]))
    command = ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "t.tex"]
    done = [subprocess.run(command, cwd=tmp_path, capture_output=True, check=False) for _ in range(2)][-1]
    assert done.returncode == 0, done.stdout[-2000:]
    assert b"Float too large" not in done.stdout
    assert b"multiply defined" not in done.stdout


def test_latex_has_a_label_a_table_each_note_once_and_the_order_of_the_command(pasted):
    parts = [render(table, "latex") for table in pasted]
    labels = [label for part in parts for label in re.findall(r"\\label\{(.*?)\}", part)]
    assert len(labels) == len(set(labels)) >= len(parts)
    (means,) = (table for table in pasted if table.name == "means")
    (shared,) = {part for line in means.lines for part in line.note.split("; ") if "40 pairs" in part}
    assert render(means, "latex").count(escape(shared)) == 1
    assert rf"\textbf{{{escape(means.title)}.}} {escape(shared)}" in render(means, "latex")
    (epe,) = (table for table in pasted if table.name == "epe")
    names = [line.label for line in epe.lines]
    assert [name.split()[0] for name in names] == ["zebra", "apple_50%", "zebra"]


def test_latex_shades_as_the_paper_does_and_can_be_referred_to():
    epe = render(PAPER[0], "latex")
    assert r"\label{tab:robustflow-epe}" in epe
    assert r"SAMFlow-H & \cellcolor{gray!20}\textbf{3.78} & \cellcolor{gray!20}\textbf{7.08} & " in epe
    cost = render(PAPER[-1], "latex")
    shaded = [line.split(" & ")[0] for line in cost.splitlines() if line.startswith(r"\rowcolor{gray!20}")]
    assert shaded == [r"\rowcolor{gray!20}CSFlow", r"\rowcolor{gray!20}ARFlow"]
    assert r"\cellcolor" not in cost


def test_latex_longer_than_a_page_continues_in_another_table():
    runs = [
        Section(f"run {index}", tuple(Line(f"part {n}", (TableCell("1.00"),)) for n in range(36))) for index in range(3)
    ]
    text = render(Table("means", "Means", (Column("CRE"),), tuple(runs), ("The end.",)), "latex")
    floats = text.split(r"\end{table*}")[:-1]
    assert [re.findall(r"run \d", part) for part in floats] == [["run 0"], ["run 1"], ["run 2"]]
    assert [part.count("part ") for part in floats] == [36, 36, 36]
    assert ["The end." in part for part in floats] == [False, False, True]
    prose = Section("long", (Line("a", (TableCell("word " * 200),)),))
    many = Table("prose", "Prose", (Column("Claim", prose=True),), (prose,) * 6)
    assert 1 < render(many, "latex").count(r"\begin{table*}") < 6


FAILURES = {
    "mine_json:broken": ("mine_json:broken", "AttributeError"),
    "mine_json:nothing": ("mine_json:nothing", "NoneType"),
    "mine_json:line": ("line", "mine_json"),
    "latx": ("latx", "latex"),
}


def test_planted_format_and_table_cost_a_function_and_a_registry_line(tmp_path, monkeypatch):
    (tmp_path / "mine_json.py").write_text(
        "import json\nfrom robustflow.report.table import Table\n\n\n"
        "def lines(table):\n    return json.dumps([[c.text for c in line.cells] for line in table.lines])\n\n\n"
        "def broken(table):\n    return table.rows\n\n\ndef nothing(table):\n    return None\n\n\n"
        "def planted(wanted):\n"
        "    rows = [(key.model, [one.number('epe', 'clean')]) for key, one in wanted.lines.items()]\n"
        "    return [Table.of('planted', 'Planted', ['clean EPE'], {'All': rows})]\n"
    )
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    registry: Registry = Registry("table")
    registry.add("planted", "mine_json:planted")
    monkeypatch.setattr(tables, "TABLES", registry)
    (made,) = tables.tables_of([], published=True, wanted=["planted"])
    monkeypatch.setitem(FORMATS._targets, "mine", "mine_json:lines")
    assert render(made, "mine") == render(made, "mine_json:lines")
    assert '["1.81"]' in render(made, "mine")  # RAFT, in-domain
    for format, (culprit, fact) in FAILURES.items():
        assert fact in str(refusal(partial(render, made, format), UsageError, culprit))
