"""LaTeX output with booktabs, in the layout of the paper's tables: rotated column headings below their family, a rule
between settings, and the best value of a column in bold on grey. A row marked as best has a grey background.

Its first line names the packages that it needs (`PACKAGES`); `\\ref{tab:robustflow-NAME}` refers to a table. Characters
that pdfLaTeX cannot typeset are written as code points.
"""

from __future__ import annotations

import re
from dataclasses import replace
from itertools import groupby

from ...core.text import plain
from ..table import LONGEST_NOTE, Section, Table, TableCell

PACKAGES = r"\usepackage[T1]{fontenc}\usepackage[table]{xcolor}\usepackage{textcomp,booktabs,graphicx}"
"""What the preamble of a document with these tables must load."""

_PROSE = r"p{0.5\linewidth}"
_PROSE_LETTERS, _PAGE_LINES = 38, 60
"""Characters per line of a prose column, and lines per page, in LaTeX's article class, which has the smallest text
area of the standard classes."""
_SPECIAL = {
    "\\": r"\textbackslash{}",
    "{": r"\{",
    "}": r"\}",
    "$": r"\$",
    "&": r"\&",
    "#": r"\#",
    "%": r"\%",
    "_": r"\_",
    "^": r"\textasciicircum{}",
    "~": r"\textasciitilde{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "|": r"\textbar{}",
    '"': r"\textquotedbl{}",
    "'": r"\textquotesingle{}",
    "`": r"\textasciigrave{}",
    "…": r"\dots{}",
    "±": r"\textpm{}",
    # after the end of a row, LaTeX would read these characters as arguments of \\
    "[": "{[}",
    "*": "{*}",
}
_LETTERS = "äöüÄÖÜßéèêëáàâãåæçíìîïñóòôõøúùûýÁÀÂÃÅÆÇÉÈÊËÍÌÎÏÑÓÒÔÕØÚÙÛÝ"


def render(table: Table) -> str:
    """Render the table as a `table*` environment, or as several if it exceeds a page; sections are never split."""
    table = table.with_shared_notes()
    parts = _pages(table)
    if len(parts) == 1:
        return _float(table, table.name)
    floats = []
    for number, sections in enumerate(parts, start=1):
        remarks = table.remarks if number == len(parts) else ()
        title = f"{table.title} ({number} of {len(parts)})"
        name = table.name if number == 1 else f"{table.name}-part-{number}"
        floats.append(_float(replace(table, title=title, sections=tuple(sections), remarks=remarks), name))
    return "\n".join(floats)


def only_lines(table: Table) -> str:
    """Render only the lines of a table, to be pasted into a different table. A comment at the end of each line lists
    the columns and the measurement conditions."""
    columns = ", ".join(column.label for column in table.columns)
    return "".join(
        " & ".join([escape(plain(line.label)), *(_cell(cell, shaded=False) for cell in line.cells)])
        + rf" \\ % {'; '.join(filter(None, (columns, plain(line.note, LONGEST_NOTE))))}"
        + "\n"
        for section in table.sections
        for line in section.lines
    )


def _pages(table: Table) -> list[list[Section]]:
    prose = [index for index, column in enumerate(table.columns) if column.prose]
    parts: list[list[Section]] = [[]]
    room = _PAGE_LINES
    for section in table.sections:
        needed = 2  # the section title between two rules
        for line in section.lines:
            needed += max([1, *(-(-len(line.cells[index].text) // _PROSE_LETTERS) for index in prose)])
        if parts[-1] and needed > room:
            parts.append([])
            room = _PAGE_LINES
        parts[-1].append(section)
        room -= needed
    return parts


def _float(table: Table, name: str) -> str:
    width = len(table.columns) + 1
    notes = table.notes
    kinds = "".join(_PROSE if column.prose else "r" for column in table.columns)
    lines = [
        f"% needs {PACKAGES}",
        r"\begin{table*}[t]",
        r"\centering",
        r"\sbox0{%",
        rf"\begin{{tabular}}{{l{kinds}}}",
        r"\toprule",
        *_headings(table),
    ]
    for section in table.sections:
        lines += [
            r"\midrule",
            rf"\multicolumn{{{width}}}{{c}}{{\textit{{\textbf{{{escape(section.title)}}}}}}} \\",
            r"\midrule",
        ]
        for line in section.lines:
            mark = rf"\textsuperscript{{{notes[line.note]}}}" if line.note else ""
            shade = r"\rowcolor{gray!20}" if line.best else ""
            cells = (_cell(cell, shaded=cell.best and not line.best) for cell in line.cells)
            lines.append(shade + " & ".join([escape(plain(line.label)) + mark, *cells]) + r" \\")
    # a table that is wider than the page shrinks, but a small one does not grow
    fitted = r"\ifdim\wd0>\linewidth\resizebox{\linewidth}{!}{\usebox0}\else\usebox0\fi"
    lines += [r"\bottomrule", r"\end{tabular}}", fitted]
    below = [escape(plain(remark, None)) for remark in table.remarks]
    below += [rf"\textsuperscript{{{number}}} {escape(plain(note, LONGEST_NOTE))}." for note, number in notes.items()]
    label = re.sub("[^a-z0-9-]+", "-", name.lower())
    lines += [rf"\caption{{\textbf{{{escape(table.title)}.}} {' '.join(below)}}}"]
    lines += [rf"\label{{tab:robustflow-{label}}}", r"\end{table*}"]
    return "\n".join(lines) + "\n"


def escape(text: str) -> str:
    """Escape text for LaTeX. Repeated hyphens and commas are separated, because fonts have ligatures of them."""
    return re.sub(r"([-,])(?=\1)", r"\1{}", "".join(map(_letter, plain(text, None))))


def _letter(c: str) -> str:
    if c in _SPECIAL:
        return _SPECIAL[c]
    return c if c.isascii() or c in _LETTERS else f"(U+{ord(c):04X})"


def _cell(cell: TableCell, shaded: bool) -> str:
    # Typeset the sign of a number as a minus sign, but leave hyphens in names unchanged.
    text = f"${cell.text}$" if cell.text[:1] == "-" and cell.text[1:].replace(".", "").isdigit() else escape(cell.text)
    if not cell.best:
        return text
    bold = rf"\boldmath{text}" if text.startswith("$") else rf"\textbf{{{text}}}"
    return rf"\cellcolor{{gray!20}}{bold}" if shaded else bold


def _headings(table: Table) -> list[str]:
    groups = [(group, len(list(columns))) for group, columns in groupby(table.columns, lambda column: column.group)]
    if all(not group for group, _ in groups):
        return [" & ".join([escape(table.row_header), *(escape(column.label) for column in table.columns)]) + r" \\"]
    first, rules, at = [escape(table.row_header)], [], 2
    for group, count in groups:
        first.append(rf"\multicolumn{{{count}}}{{c}}{{{escape(group)}}}")
        if group:
            rules.append(rf"\cmidrule(lr){{{at}-{at + count - 1}}}")
        at += count
    second = ["", *(rf"\rotatebox{{45}}{{{escape(column.label)}}}" for column in table.columns)]
    return [" & ".join(first) + r" \\", " ".join(rules), " & ".join(second) + r" \\"]
