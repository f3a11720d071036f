"""What a corruption's page says in words: its equation, what its parameters are, and what it does to flow."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import NamedTuple


class Note(NamedTuple):
    """A corruption in words.

    Attributes:
        equation: LaTeX; x is a frame on [0, 1], x' the corrupted one.
        where: the symbols of the equation that need words.
        effect: what it does to flow, and why.
        parameters: of a severity: symbol or name, and unit.
    """

    equation: str
    where: str
    effect: str
    parameters: list[str]


NOTES = {name: Note(**note) for name, note in tomllib.loads(Path(__file__).with_suffix(".toml").read_text()).items()}
