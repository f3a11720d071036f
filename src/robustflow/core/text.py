"""Make names from files safe to display as text.

A model's name is arbitrary text from a user or a file. Renderers escape characters that are special in their format;
characters that are unsafe in every format are removed here first.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Sequence

LONGEST_TEXT = 80


def plain(text: str, longest: int | None = LONGEST_TEXT) -> str:
    """Return one line without control, bidirectional or other invisible characters, at most `longest` characters
    long.
    """
    spaced = " ".join(str(text).split())
    clean = "".join("\ufffd" if unicodedata.category(c)[0] == "C" else c for c in spaced)
    return clean if longest is None or len(clean) <= longest else clean[: longest - 1] + "…"


def is_utf8(name: str) -> bool:
    r"""Return whether the name of a file, as Python decoded it, is valid UTF-8; other bytes are lone surrogates.

    >>> is_utf8("café"), is_utf8("caf\udce9")
    (True, False)
    """
    return not any("\ud800" <= letter <= "\udfff" for letter in name)


def counted(number: int, singular: str, plural: str | None = None) -> str:
    """Return a number with its noun."""
    return f"{number} {singular if number == 1 else plural or singular + 's'}"


def joined(parts: Sequence[str]) -> str:
    """Join parts of a sentence into a list."""
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}"


def first_of(parts: Sequence[str], most: int) -> str:
    """Join the first `most` parts and count the others.

    >>> first_of(["fog", "snow", "frost"], 2), first_of(["fog"], 2)
    ('fog, snow and 1 more', 'fog')
    """
    more = len(parts) - most
    return ", ".join(parts[:most]) + (f" and {more} more" if more > 0 else "")


def name_text(name: str) -> str:
    r"""Escape a name for a matplotlib label, where a dollar sign starts a formula and a leading underscore hides a
    legend entry.

    >>> name_text("a$b$"), name_text("_x")
    ('a\\$b\\$', '\u200a_x')
    """
    text = plain(name, 40).replace("$", r"\$")
    return f"\u200a{text}" if text.startswith("_") else text


def text_cell(text: str) -> str:
    """Prefix a text with an apostrophe if a spreadsheet would evaluate it as a formula.

    >>> text_cell("=HYPERLINK(1)"), text_cell("RAFT")
    ("'=HYPERLINK(1)", 'RAFT')
    """
    clean = plain(text, 600)
    first = unicodedata.normalize("NFKC", clean[:1])  # some spreadsheets accept full-width characters
    return f"'{clean}" if first in ("=", "+", "-", "@") else clean


def file_name(text: str) -> str:
    """Return a file name made from any text; characters that are special to a file system or a shell become hyphens.

    >>> file_name("mypkg.flow:MyModel"), file_name("weights/../net.onnx")
    ('mypkg.flow-MyModel', 'weights-..-net.onnx')
    """
    return re.sub(r"[^A-Za-z0-9_.-]+", "-", text).strip("-.") or "unnamed"
