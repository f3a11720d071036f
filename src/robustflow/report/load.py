"""A run from wherever it lies: what every command that reads runs takes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import RunError

if TYPE_CHECKING:
    from ..runner.result import Result


def load_run(path: str | Path) -> Result:
    """The run of a folder that `run` wrote.

    Raises:
        RunError: no run there, or one that this version cannot read.
    """
    from ..runner.result import Result

    path = Path(path).expanduser()
    if path.is_file():
        raise RunError(f"{path} is a file; give the folder that 'run' wrote")
    return Result(path)
