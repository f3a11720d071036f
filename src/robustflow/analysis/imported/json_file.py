"""Read JSON files from other programs, with a size limit and checks for repeated names and invalid numbers."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path
from typing import Any

from ...bounded_file import read_bounded
from ...errors import DataError
from ...layout import user_path
from ...text import plain

_LARGEST_FILE = 16 * 2**20
_LARGEST_NUMBER = 1e9


def read_json_file(path: Path) -> Any:
    """Read a JSON file. NaN, which Python's `json.dump` can write, is accepted here and rejected where the number is
    used.
    """
    data = read_bounded(user_path(path), _LARGEST_FILE, "give a results file")
    try:
        return json.loads(data.decode(), object_pairs_hook=_dict_without_duplicates)
    except (ValueError, RecursionError) as error:
        raise DataError(f"{path} is not valid JSON ({plain(str(error))}); give the original file") from error


def finite_number(value: Any, where: str, *, signed: bool = False) -> float:
    """Return a finite number: a length in pixels or, if `signed`, a difference of lengths.

    >>> finite_number(2, "r.json, fog"), finite_number(-0.5, "r.json, fog", signed=True)
    (2.0, -0.5)
    """
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise DataError(f"{where}: {plain(repr(value), 40)} is not a number")
    if not abs(value) <= _LARGEST_NUMBER:  # comparisons with NaN are false
        raise DataError(f"{where}: {plain(repr(value), 40)} is not a finite number of pixels")
    if value < 0 and not signed:
        raise DataError(f"{where}: {float(value):g}: a length in pixels cannot be negative")
    return float(value)


def _dict_without_duplicates(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    duplicates = [name for name, count in Counter(name for name, _ in pairs).items() if count > 1]
    if duplicates:
        raise ValueError(f"'{plain(duplicates[0], 40)}' appears twice")
    return dict(pairs)
