"""Text for a corruption's page: its equation, the meaning of its parameters, and its effect on flow."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import NamedTuple


class Note(NamedTuple):
    """Text that describes a corruption.

    Attributes:
        equation: LaTeX formula; x is a frame on [0, 1], x' the corrupted frame.
        where: definitions of symbols in the equation.
        effect: effect on optical flow, and its reason.
        parameters: symbol or name, and unit, of each parameter that depends on the severity.
    """

    equation: str
    where: str
    effect: str
    parameters: list[str]


NOTES = {name: Note(**note) for name, note in tomllib.loads(Path(__file__).with_suffix(".toml").read_text()).items()}
