"""A hash of everything that determines what a user's object computes: its attributes, its class and the modules that
it imports."""

from __future__ import annotations

import ast
import hashlib
import inspect
import sys
from collections.abc import Iterator
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any

from .errors import UsageError
from .plugins import called

_SELF = __name__.partition(".")[0]


def source_digest(made: Any) -> str:
    """Return a hash of a class's or object's attributes and source, as 16 hexadecimal digits: the files of the class
    and its base classes, and every module of the same folder or package that they import. With a property `source`,
    attributes that a later run could not recognise are left out.
    """
    kind = made if inspect.isclass(made) else type(made)
    digest = hashlib.blake2b(digest_size=8)
    for text in sorted(_sources(kind)):
        digest.update(hashlib.sha256(text).digest())
    if not inspect.isclass(made):
        named = called(kind.__name__, "source", lambda: getattr(made, "source", ""))
        state = _attributes(made)
        if named:
            state = {name: value for name, value in state.items() if _is_recognised(value)} | {"source": named}
        digest.update(_value_text(state, kind.__name__).encode())
    digest.update(kind.__qualname__.encode())
    return digest.hexdigest()


def _sources(kind: type[Any]) -> Iterator[bytes]:
    seen: set[str] = set()
    for base in kind.__mro__:
        top = base.__module__.partition(".")[0]
        if top in (_SELF, "builtins", "abc", "typing") or (top in sys.stdlib_module_names and top != "__main__"):
            continue
        module = sys.modules.get(base.__module__)
        path = getattr(module, "__file__", None)
        if module is None or path is None or base.__module__ == "__main__":
            yield _class_source(base)
        else:
            yield from _module_parts(base.__module__, Path(path).resolve(), _root(module), seen)


def _root(module: ModuleType) -> Path:
    """Return the folder of a module's top-level package, or of the module itself; all code in it counts as the
    user's."""
    assert module.__file__ is not None
    levels = module.__name__.count(".") + (1 if hasattr(module, "__path__") else 0)
    folder = Path(module.__file__).resolve().parent
    for _ in range(max(levels - 1, 0)):
        folder = folder.parent
    return folder


def _module_parts(name: str, path: Path, root: Path, seen: set[str]) -> Iterator[bytes]:
    if name in seen or root not in path.parents:
        return
    if seen and "site-packages" in path.parts[len(root.parent.parts) :]:
        return  # installed beside the user's file, or in an environment in its folder
    seen.add(name)
    content = path.read_bytes()
    yield content
    levels = name.count(".") + (path.stem == "__init__")
    package, top = ".".join(name.split(".")[:levels]), path.parents[min(levels, len(path.parents) - 1)]
    for each in _imported(content, package):
        if (file := _file_of(each, top)) is not None:
            yield from _module_parts(each, file, root, seen)


def _file_of(name: str, folder: Path) -> Path | None:
    """Return the file of a module, imported or not yet, as one that a function imports when it is called."""
    if name in sys.modules:
        known = getattr(sys.modules[name], "__file__", None)
        return None if known is None else Path(known).resolve()
    place = folder.joinpath(*name.split("."))
    return next((file for file in (place / "__init__.py", Path(f"{place}.py")) if file.is_file()), None)


def _imported(content: bytes, package: str) -> Iterator[str]:
    """Return the full names of all modules that a source file imports, at any level."""
    try:
        nodes = list(ast.walk(ast.parse(content)))
    except (SyntaxError, ValueError):
        return
    for node in nodes:
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            above = package.split(".")[: len(package.split(".")) - node.level + 1] if node.level else []
            base = ".".join([*above, *([node.module] if node.module else [])])
            yield base
            yield from (f"{base}.{alias.name}" for alias in node.names)


def _class_source(kind: type[Any]) -> bytes:
    """Return the source of a class defined in a script or session, or its compiled code if the source is
    unavailable."""
    try:
        return inspect.getsource(kind).encode()
    except (OSError, TypeError):
        code = (getattr(value, "__code__", None) for _, value in sorted(vars(kind).items()))
        return "\n".join(_code(each) for each in code if each is not None).encode()


def _code(code: CodeType) -> str:
    ordered = (sorted(value, key=repr) if isinstance(value, frozenset) else value for value in code.co_consts)
    constants = [_code(value) if isinstance(value, CodeType) else repr(value) for value in ordered]
    return f"{code.co_code.hex()} {constants} {code.co_names}"


def _attributes(made: Any) -> dict[str, Any]:
    """Return an object's attributes, including those in slots, without the variant."""
    state = object.__getstate__(made)
    parts = state if isinstance(state, tuple) else (state,)
    return {name: value for part in parts for name, value in (part or {}).items() if name != "variant"}


def _is_recognised(value: Any) -> bool:
    try:
        return bool(_value_text(value, ""))
    except UsageError:
        return False


def _value_text(value: Any, where: str) -> str:
    """Return a value as text that is identical in every process."""
    import numpy as np

    if value is None or isinstance(value, bool | int | float | complex | str | bytes | Path):
        return f"{type(value).__name__}:{value!r}"
    if isinstance(value, np.ndarray) and not value.dtype.hasobject:
        hashed = hashlib.sha256(np.ascontiguousarray(value).tobytes()).hexdigest()
        return f"array:{value.dtype}:{value.shape}:{hashed}"
    if isinstance(value, np.generic):
        return f"{value.dtype}:{value!r}"
    if isinstance(value, list | tuple):
        return f"[{','.join(_value_text(each, f'{where}[{i}]') for i, each in enumerate(value))}]"
    if isinstance(value, set | frozenset):
        return f"{{{','.join(sorted(_value_text(each, where) for each in value))}}}"
    if isinstance(value, dict):
        items = sorted((str(key), _value_text(each, f"{where}.{key}")) for key, each in value.items())
        return f"{{{','.join(f'{key}={each}' for key, each in items)}}}"
    if inspect.isfunction(value):  # its name does not identify it: it can be a lambda or hold values
        held = [cell.cell_contents for cell in value.__closure__ or () if cell.cell_contents is not value]
        rest = _value_text([value.__defaults__, value.__kwdefaults__, held], where)
        return f"{value.__module__}:{value.__qualname__}:{_code(value.__code__)}:{rest}"
    if inspect.ismethod(value):
        return f"{_value_text(value.__self__, where)}.{_value_text(value.__func__, where)}"
    if inspect.isclass(value) or inspect.isroutine(value):
        return f"{value.__module__}:{value.__qualname__}"
    raise UsageError(
        where,
        f"contains a {type(value).__name__}, which a later run could not recognise; give it a property "
        "`source` that describes, as text, everything that determines its result",
    )
