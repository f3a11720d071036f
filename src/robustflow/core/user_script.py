"""The script that Python runs, which child processes of `multiprocessing` may run again from the top."""

from __future__ import annotations

import multiprocessing
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType

from .errors import UsageError

UNGUARDED = (
    'a script that starts several workers needs its code under `if __name__ == "__main__":`, because each worker '
    "runs the script from the top"
)


def refuse_unguarded_script() -> None:
    """Raise if a worker process runs the user's script from the top again while starting."""
    if getattr(multiprocessing.current_process(), "_inheriting", False):
        raise UsageError(UNGUARDED)


def user_script() -> Path | None:
    """Return the file that Python runs; None in a notebook, at a prompt, and for a script on standard input."""
    file = Path(getattr(sys.modules["__main__"], "__file__", ""))
    return file if file.is_file() else None


def may_have_children() -> bool:
    """Return whether children can start without running the script again. They can if the script has a guard, if there
    is no script, or if the script is a package's `__main__`, which `multiprocessing` does not run again."""
    script = user_script()
    package = getattr(getattr(sys.modules["__main__"], "__spec__", None), "name", "").endswith(".__main__")
    return script is None or package or "__main__" in script.read_text(errors="replace")


@contextmanager
def without_user_script() -> Iterator[None]:
    """Start a process that does not run the user's script."""
    script = sys.modules["__main__"]
    sys.modules["__main__"] = ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = script
