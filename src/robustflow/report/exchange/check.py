"""Compare exported files with a record."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from ...bounded_file import read_bounded
from ...errors import RunError
from ...records.read import Reader
from ...runs.run import Run
from ...text import counted, plain
from . import EXCHANGE_FORMATS, HUB_NAME, exchange_files

_LARGEST = 2**29
_HUB_DATASET = re.compile(f'^    id: "({HUB_NAME})"$'.encode(), re.MULTILINE)


def check_exported(reader: Reader, paths: Sequence[Path]) -> str:
    """Check that each file matches an export of the record, byte for byte; return a sentence with the number of
    files.
    """
    with TemporaryDirectory(prefix="robustflow-") as folder:
        reader.extract(Path(folder))
        run = Run(folder)
        for path in paths:
            _check(path, run)
    return counted(len(paths), "file")


def _check(path: Path, run: Run) -> None:
    data = read_bounded(path, _LARGEST, "give a file written by 'robustflow export'")
    found = _HUB_DATASET.search(data)
    dataset = found[1].decode() if found else None
    made = [
        each
        for format in EXCHANGE_FORMATS
        if format != "huggingface" or dataset is not None
        for each in exchange_files(run, format, dataset).values()
    ]
    if data in made:
        return
    given = data.split(b"\n")
    nearest = max((each.split(b"\n") for each in made), key=lambda lines: _equal_lines(lines, given))
    number = next((n for n, pair in enumerate(zip(nearest, given, strict=False)) if pair[0] != pair[1]), None)
    if number is None:
        raise RunError(
            f"{path} has {len(given)} lines, but an export of the record has {len(nearest)}: export it again"
        )
    written, expected = (plain(lines[number].decode(errors="replace"), 80) for lines in (given, nearest))
    raise RunError(
        f"{path}, line {number + 1}: '{written}', but an export of the record has '{expected}': export it again"
    )


def _equal_lines(lines: Sequence[bytes], given: Sequence[bytes]) -> int:
    return sum(one == other for one, other in zip(lines, given, strict=False))
