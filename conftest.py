"""Without their extras the modules that need them are not collected for doctests; their tests skip, with a reason."""

import os
import re
import sys
from importlib.util import find_spec
from pathlib import Path

# Tests start hundreds of processes; without compiled files each would compile the package's sources.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

_ROOT = Path(__file__).parent
_EXTRAS = ("torch", "onnx", "starlette", "uvicorn")
_IMPORT = re.compile(r"^(?:from (\S+) import (\([^)]*\)|[^\n(#]+)|import ([^\n#]+))", re.MULTILINE)
_TORCH_INSIDE = ("safetensors.torch",)  # modules of other libraries that import torch


def _module(path: Path) -> tuple[str, ...]:
    """A file's dotted name, in parts: src/robustflow/api.py is ("robustflow", "api")."""
    parts = path.relative_to(_ROOT).with_suffix("").parts
    parts = parts[1:] if parts[0] == "src" else parts
    return parts[:-1] if parts[-1] == "__init__" else parts


def _imports(path: Path) -> set[str]:
    """What a module imports as it is imported itself: names of modules, and of what is taken from them."""
    package = _module(path) if path.name == "__init__.py" else _module(path)[:-1]
    names = set()
    for source, taken, modules in _IMPORT.findall(path.read_text(encoding="utf-8")):
        if modules:
            names |= {part.split()[0] for part in modules.split(",")}
            continue
        level = len(source) - len(source.lstrip("."))
        above = package[: len(package) - level + 1] if level else ()
        module = ".".join([*above, *filter(None, [source[level:]])])
        names |= {module, *(f"{module}.{part.split()[0]}" for part in taken.strip("()").split(",") if part.strip())}
    return names


def _not_importable(missing: list[str]) -> set[Path]:
    """The modules that import a missing library, themselves or through modules of ours."""
    imports = {path: _imports(path) for folder in ("src", "tests") for path in sorted((_ROOT / folder).rglob("*.py"))}
    without = {*missing, *(_TORCH_INSIDE if "torch" in missing else ())}
    affected: set[Path] = set()
    while True:
        more = {
            path
            for path, names in imports.items()
            if path not in affected and any(name.split(".")[0] in without or name in without for name in names)
        }
        if not more:
            return affected
        affected |= more
        without |= {".".join(_module(path)) for path in more}


_missing = [library for library in _EXTRAS if find_spec(library) is None]
_ignored = _not_importable(_missing) if _missing else set()


def pytest_ignore_collect(collection_path: Path) -> bool | None:
    """Leave them out; a test module says itself what it needs (pytest.importorskip), before its imports.

    The list `collect_ignore` would be made into paths again for every file: a quarter of the time of a collection.
    """
    return (collection_path in _ignored and not collection_path.name.startswith("test_")) or None
