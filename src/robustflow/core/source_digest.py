"""A hash of everything that determines what a user's object computes: its attributes, its class and the modules that
it imports."""

from __future__ import annotations

import ast
import hashlib
import inspect
import os
import sys
from argparse import Namespace
from collections.abc import Iterator
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any

from .errors import UsageError
from .plugins import called

_SELF = __name__.partition(".")[0]
_UNRECOGNISED = object()
_NOT_RECOGNISED = (
    "which a later run could not recognise; give it a property `source` that describes, as text, everything that "
    "determines its result"
)
_STANDARD = Path(os.__file__).parent
"""Folder of the standard library; a user's file can have the name of one of its modules."""


def source_digest(made: Any) -> str:
    """Return a hash of the source of a class or function, or of an object's attributes and class, as 16 hexadecimal
    digits: the files of the class and its base classes, and every module of the same folder or package that they
    import. Of a script or session, only the class counts, with the values and functions that it uses. With a property
    `source`, attributes that a later run could not recognise are left out.
    """
    is_code = inspect.isclass(made) or inspect.isfunction(made)
    kind = made if is_code else type(made)
    digest = hashlib.blake2b(digest_size=8)
    for text in sorted(_sources(kind)):
        digest.update(hashlib.sha256(text).digest())
    if not is_code:
        named = called(kind.__name__, "source", lambda: getattr(made, "source", ""))
        seen: set[Any] = set()
        state = _attributes(made)
        if named:
            state = {**_recognised(state, set()), "source": named}
        digest.update(_value_text(state, kind.__name__, seen).encode())
        if _UNRECOGNISED in seen:
            raise UsageError(kind.__name__, f"a function in its attributes uses something {_NOT_RECOGNISED}")
    digest.update(kind.__qualname__.encode())
    return digest.hexdigest()


def _sources(kind: Any) -> Iterator[bytes]:
    seen: set[str] = set()
    for base in getattr(kind, "__mro__", (kind,)):
        top = base.__module__.partition(".")[0]
        module = sys.modules.get(base.__module__)
        path = Path(getattr(module, "__file__", None) or "")
        standard = top in sys.stdlib_module_names and (not path.is_file() or _STANDARD in path.parents)
        if top in (_SELF, "builtins", "abc", "typing") or (standard and top != "__main__"):
            continue
        in_session = not path.is_file() or base.__module__ == "__main__"  # a session can follow a script
        if in_session or "<locals>" in base.__qualname__:
            yield from _class_source(base, path)
        if module is not None and path.is_file():
            yield from _module_parts(base.__module__, path.resolve(), _root(module), seen)


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
    if name != "__main__":  # a script also contains what does not matter, such as the samples to run
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


def _class_source(kind: type[Any], script: Path) -> Iterator[bytes]:
    """Return the attributes and the compiled code of a class that is not identified by a file: it is defined in a
    script or session, or in a function, whose arguments it can use; and the whole script, if the class uses something
    that a later run could not recognise. Of a session without a file, the user's modules that the class uses count."""
    seen: set[Any] = set()
    yield _class_text(kind, seen).encode()
    if script.is_file():
        if _UNRECOGNISED in seen:
            yield script.read_bytes()
        return
    for name in sorted({getattr(each, "__module__", None) or each.__name__ for each in seen - {_UNRECOGNISED}}):
        module = sys.modules.get(name)
        path = Path(getattr(module, "__file__", None) or "")
        installed = _STANDARD in path.parents or "site-packages" in path.parts or name.partition(".")[0] == _SELF
        if module is not None and path.is_file() and not installed:
            yield from _module_parts(name, path.resolve(), _root(module), set())


def _class_text(kind: type[Any], seen: set[Any]) -> str:
    bare = {name: getattr(value, "__func__", getattr(value, "fget", value)) for name, value in vars(kind).items()}
    own = {name: value for name, value in bare.items() if inspect.isfunction(value) or not name.startswith("__")}
    return f"{kind.__qualname__}:{_recognised(own, seen)}"


def _function_text(function: Any, where: str, seen: set[Any]) -> str:
    """Return a function's name and, where the name does not identify it, its code and the values that it holds; in a
    script or session, also the values and functions that it uses."""
    name, in_session = f"{function.__module__}:{function.__qualname__}", function.__module__ == "__main__"
    is_named = getattr(sys.modules.get(function.__module__), function.__name__, None) is function
    known_before = function in seen
    seen.add(function)
    if known_before or (is_named and not in_session):
        return name
    cells = [cell.cell_contents for cell in function.__closure__ or ()]
    held = dict(enumerate([*(function.__defaults__ or ()), *(function.__kwdefaults__ or {}).items(), *cells]))
    known = function.__globals__ if in_session else {}
    used = {each: known[each] for each in sorted({*_names(function.__code__)} & known.keys())}
    return f"{name}:{_code(function.__code__)}:{_recognised(held, seen)}:{_recognised(used, seen)}"


def _names(code: CodeType) -> Iterator[str]:
    yield from code.co_names
    for value in code.co_consts:
        if isinstance(value, CodeType):
            yield from _names(value)


def _code(code: CodeType) -> str:
    ordered = (sorted(value, key=repr) if isinstance(value, frozenset) else value for value in code.co_consts)
    constants = [_code(value) if isinstance(value, CodeType) else repr(value) for value in ordered]
    return f"{code.co_code.hex()} {constants} {code.co_names}"


def _attributes(made: Any) -> dict[str, Any]:
    """Return an object's attributes, including those in slots, without the variant."""
    state = object.__getstate__(made)
    parts = state if isinstance(state, tuple) else (state,)
    return {name: value for part in parts for name, value in (part or {}).items() if name != "variant"}


def _recognised(values: dict[Any, Any], seen: set[Any]) -> dict[Any, str]:
    """Return the values as text, without those that a later run could not recognise."""
    texts = {}
    for name, value in values.items():
        try:
            texts[name] = _value_text(value, str(name), seen)
        except UsageError:
            seen.add(_UNRECOGNISED)
    return texts


def _value_text(value: Any, where: str, seen: set[Any] | None = None) -> str:
    """Return a value as text that is identical in every process; `seen` holds the functions and classes described so
    far, and `_UNRECOGNISED` if they use something else."""
    import numpy as np

    seen = set() if seen is None else seen

    if value is None or isinstance(value, bool | int | float | complex | str | bytes | Path):
        return f"{type(value).__name__}:{value!r}"
    if isinstance(value, np.ndarray) and not value.dtype.hasobject:
        hashed = hashlib.sha256(np.ascontiguousarray(value).tobytes()).hexdigest()
        return f"array:{value.dtype}:{value.shape}:{hashed}"
    if isinstance(value, np.generic):
        return f"{value.dtype}:{value!r}"
    if isinstance(value, list | tuple):
        return f"[{','.join(_value_text(each, f'{where}[{i}]', seen) for i, each in enumerate(value))}]"
    if isinstance(value, set | frozenset):
        return f"{{{','.join(sorted(_value_text(each, where, seen) for each in value))}}}"
    if isinstance(value, dict):
        items = sorted((str(key), _value_text(each, f"{where}.{key}", seen)) for key, each in value.items())
        return f"{{{','.join(f'{key}={each}' for key, each in items)}}}"
    if inspect.isfunction(value):
        return _function_text(value, where, seen)
    if inspect.ismethod(value):
        return f"{_value_text(value.__self__, where, seen)}.{_value_text(value.__func__, where, seen)}"
    if inspect.ismodule(value):
        seen.add(value)
        return value.__name__
    if isinstance(value, Namespace):
        return _value_text(vars(value), where, seen)
    if inspect.isclass(value) and value not in seen:
        seen.add(value)
        if value.__module__ == "__main__":
            return _class_text(value, seen)
    if inspect.isclass(value) or inspect.isroutine(value):
        return f"{value.__module__}:{value.__qualname__}"
    raise UsageError(
        where,
        f"contains a {type(value).__name__}, {_NOT_RECOGNISED}",
    )
