"""Without their extras the modules that need them are not collected for doctests; their tests skip, with a reason."""

import re
from importlib.util import find_spec
from pathlib import Path

_ROOT = Path(__file__).parent
_EXTRAS = ("torch", "onnx", "starlette", "uvicorn")


def _imports_what_is_missing(path: Path) -> bool:
    """Whether a module imports, as it is imported itself, a library of an extra that is not installed."""
    missing = [library for library in _EXTRAS if find_spec(library) is None]
    if not missing:
        return False
    return re.search(rf"^(import|from) ({'|'.join(missing)})\b", path.read_text(encoding="utf-8"), re.M) is not None


# A test module says itself what it needs (pytest.importorskip), before its imports.
collect_ignore = [
    str(path)
    for folder in ("src", "tests")
    for path in sorted((_ROOT / folder).rglob("*.py"))
    if not path.name.startswith("test_") and _imports_what_is_missing(path)
]
if find_spec("torch") is None:  # these import modules that import it
    collect_ignore += [
        str(_ROOT / name)
        for name in (
            "tests/parity/samflow_case.py",
            "src/robustflow/training/validate.py",
            "src/robustflow/profiling/measure.py",
            "src/robustflow/profiling/network_of.py",
        )
    ]
