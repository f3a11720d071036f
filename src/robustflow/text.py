"""Make names that come from files safe to show anywhere as text.

A model's name is whatever a user or a file says. Renderers escape what is special in their format; what no format
should receive is removed here first.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Sequence

LONGEST_TEXT = 80


def plain(text: str, longest: int | None = LONGEST_TEXT) -> str:
    """One line without control, direction or other invisible characters, at most `longest` characters long.

    Escape sequences of terminals, line breaks, characters that reverse the text around them and lone surrogates become
    U+FFFD, so that one sees that something was there.

    >>> plain("RAFT\\x1b[31m"), plain("a\\u202eb"), plain("two\\nlines")
    ('RAFT�[31m', 'a�b', 'two lines')
    """
    spaced = " ".join(str(text).split())
    clean = "".join("\ufffd" if unicodedata.category(c)[0] == "C" else c for c in spaced)
    return clean if longest is None or len(clean) <= longest else clean[: longest - 1] + "…"


def counted(number: int, singular: str, plural: str | None = None) -> str:
    """A number with its noun.

    >>> counted(1, "clip"), counted(3, "clip"), counted(2, "severity", "severities")
    ('1 clip', '3 clips', '2 severities')
    """
    return f"{number} {singular if number == 1 else plural or singular + 's'}"


def joined(parts: Sequence[str]) -> str:
    """Parts of a sentence as a list.

    >>> joined(["fog"]), joined(["fog", "snow"]), joined(["fog", "snow", "frost"])
    ('fog', 'fog and snow', 'fog, snow and frost')
    """
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}"


def name_text(name: str) -> str:
    """A name for a label. A dollar sign would begin a formula, and a leading underscore hide a legend's entry.

    >>> name_text("a$b$"), name_text("_x")
    ('a\\\\$b\\\\$', '\\u200a_x')
    """
    text = plain(name, 40).replace("$", r"\$")
    return f"\u200a{text}" if text.startswith("_") else text


def text_cell(text: str) -> str:
    """A text that no spreadsheet takes for a formula: an apostrophe is put before one that would be evaluated.

    >>> text_cell("=HYPERLINK(1)"), text_cell("RAFT")
    ("'=HYPERLINK(1)", 'RAFT')
    """
    clean = plain(text, 300)
    return f"'{clean}" if clean[:1] in ("=", "+", "-", "@") else clean


def file_name(text: str) -> str:
    """A file name made from any text: what is special to a file system or a shell becomes a hyphen.

    >>> file_name("mypkg.flow:MyModel"), file_name("weights/../net.onnx")
    ('mypkg.flow-MyModel', 'weights-..-net.onnx')
    """
    return re.sub(r"[^A-Za-z0-9_.-]+", "-", text).strip("-.") or "unnamed"
