"""Write the log of a training run: one line of JSON per update, and TensorBoard files if TensorBoard is installed."""

from __future__ import annotations

import json
import math
from importlib.util import find_spec
from pathlib import Path
from types import TracebackType
from typing import Any

from ..atomic import write_bytes
from ..errors import DataError

METRICS_FILE = "metrics.jsonl"
_VALIDATION = '"validation_epe"'


class MetricsLog:
    """A context manager that appends to `metrics.jsonl`."""

    def __init__(self, folder: Path, first: int, validates: bool = False) -> None:
        self._path = folder / METRICS_FILE
        if self._path.exists():
            text = self._path.read_text(encoding="utf-8", errors="replace")  # a crash may leave any bytes
            again = first - validates
            lines = [line for line in text.splitlines() if _update(line) < (again if _VALIDATION in line else first)]
            write_bytes(self._path, "".join(f"{line}\n" for line in lines).encode())
        try:
            self._file = open(self._path, "a", encoding="utf-8")  # noqa: SIM115  # closed by __exit__
        except OSError as error:
            raise DataError(f"cannot write {self._path}: {error.strerror}; choose a different --output") from error
        self._board: Any = None
        if find_spec("tensorboard") is not None:
            from torch.utils.tensorboard import SummaryWriter

            self._board = SummaryWriter(str(folder / "tensorboard"), purge_step=first)

    def __enter__(self) -> MetricsLog:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._file.close()
        if self._board is not None:
            self._board.close()

    def write(self, update: int, values: dict[str, float]) -> None:
        """Write one line for an update, or for a validation after it. Values that are NaN or infinite, such as the EPE
        of pairs without valid pixels, are null, because JSON has no such numbers.
        """
        try:
            numbers = {name: value if math.isfinite(value) else None for name, value in values.items()}
            line = {"update": update} | numbers | {"update": update}  # a user's loss may return a value of this name
            self._file.write(json.dumps(line, allow_nan=False) + "\n")
            self._file.flush()
        except OSError as error:
            raise DataError(f"cannot write {self._path}: {error.strerror}; free up disk space and resume") from error
        if self._board is not None:
            for name, value in values.items():
                self._board.add_scalar(name, value, update)


def _update(line: str) -> float:
    """Return the update number of a line; an incomplete line counts as the last one."""
    try:
        return int(json.loads(line)["update"])
    except (ValueError, KeyError, TypeError):
        return float("inf")
