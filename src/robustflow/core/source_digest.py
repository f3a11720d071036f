"""A hash of what defines a user's object: the text of its file, script or notebook cell, and of the user's files that
this imports; its attributes; and what a class or function of a script or notebook holds and uses from outside its text.

Text counts as a whole, so that an edit of a comment counts as well. What else determines the result (a file, the
command line, an object that Python cannot compare) belongs in the object's attribute `source`.
"""

from __future__ import annotations

import ast
import hashlib
import inspect
import linecache
import os
import sys
from argparse import Namespace
from collections.abc import Iterator
from pathlib import Path
from types import CodeType, FunctionType
from typing import Any

import numpy as np

from .errors import UsageError
from .plugins import called

_SELF = __name__.partition(".")[0]
_MAIN = ("__main__", "__mp_main__")
"""Names of the module of a script or notebook; the second one, in a child process."""
_INSTALLED = ("site-packages", "dist-packages")
_STANDARD = Path(os.__file__).parent
"""Folder of the standard library; a user's file can have the name of one of its modules."""
_REMEDY = "give it a property `source` that describes, as text, everything that determines its result"


def source_digest(made: Any) -> str:
    """Return a hash of the source of a class or function, or of an object's class and attributes, as 16 hexadecimal
    digits. With an attribute `source`, values that a later run could not recognise are left out.

    Raises:
        UsageError: without `source`, a value cannot be recognised, or the text of a class is unknown.
    """
    is_code = inspect.isclass(made) or inspect.isfunction(made)
    kind = made if is_code else type(made)
    named = "" if is_code else called(kind.__name__, "source", lambda: getattr(made, "source", ""))
    source = _SourceText(kind.__module__.partition(".")[0], lenient=bool(named))
    described = [source.describe(kind, kind.__name__)]
    if not is_code:
        described.append(source.describe(_attributes(made) | {"source": named or ""}, kind.__name__))
    digest = hashlib.blake2b(repr(described).encode(), digest_size=8)
    for text in sorted(source.texts.values()):
        digest.update(hashlib.sha256(text).digest())
    return digest.hexdigest()


def _attributes(made: Any) -> dict[str, Any]:
    """Return an object's attributes, including those in slots, without the variant."""
    state = object.__getstate__(made)
    parts = state if isinstance(state, tuple) else (state,)
    return {name: value for part in parts for name, value in (part or {}).items() if name != "variant"}


class _SourceText:
    """Describes values as text that is identical in every process, and collects the texts that define them.

    Attributes:
        texts: contents of the user's files and notebook cells, by the name of the module or cell.
    """

    def __init__(self, package: str, lenient: bool) -> None:
        self.texts: dict[str, bytes] = {}
        self._package, self._lenient = package, lenient
        self._seen: set[Any] = set()

    def describe(self, value: Any, where: str) -> str:
        if value is None or isinstance(value, bool | int | float | complex | str | bytes | Path | np.generic):
            return f"{type(value).__name__}:{value!r}"
        if isinstance(value, np.ndarray) and not value.dtype.hasobject:
            hashed = hashlib.sha256(np.ascontiguousarray(value).tobytes()).hexdigest()
            return f"array:{value.dtype}:{value.shape}:{hashed}"
        if isinstance(value, list | tuple):
            return f"[{','.join(self.describe(item, where) for item in value)}]"
        if isinstance(value, set | frozenset):
            return f"{{{','.join(sorted(self.describe(item, where) for item in value))}}}"
        if isinstance(value, dict | Namespace):
            items = value.items() if isinstance(value, dict) else vars(value).items()
            texts = (f"{key}={self.describe(item, f'{where}.{key}')}" for key, item in items)
            return f"{{{','.join(sorted(texts))}}}"
        if inspect.ismodule(value):
            self._add_module(value.__name__)
            return value.__name__
        if inspect.isclass(value):
            return self._class(value, where)
        if inspect.ismethod(value):
            return f"{self.describe(value.__self__, where)}.{self.describe(value.__func__, where)}"
        function = value if inspect.isfunction(value) else getattr(value, "__wrapped__", None)
        if inspect.isfunction(function):
            return self._function(function, where)
        if inspect.isroutine(value):
            return f"{value.__module__}:{value.__qualname__}"
        if self._lenient:
            return ""
        raise UsageError(where, f"contains a {type(value).__name__}, which a later run could not recognise; {_REMEDY}")

    def _class(self, kind: type[Any], where: str) -> str:
        parts = [f"{kind.__module__}:{kind.__qualname__}"]
        if kind not in self._seen:
            self._seen.add(kind)
            for base in kind.__mro__:
                in_module = self._add_module(base.__module__)
                if not in_module or "<locals>" in base.__qualname__:
                    bare = {key: getattr(v, "__func__", getattr(v, "fget", v)) for key, v in vars(base).items()}
                    members = {key: v for key, v in bare.items() if inspect.isfunction(v) or not key.startswith("__")}
                    members.pop("_abc_impl", None)  # of Python's abstract classes
                    parts.append(self._held(members, where, in_module))
        return ":".join(parts)

    def _function(self, function: FunctionType, where: str) -> str:
        """Return a function's name and, if that does not identify it, its place in the text and the values that it
        holds; in a script or notebook, also the variables that it uses."""
        name, code = f"{function.__module__}:{function.__qualname__}", function.__code__
        if function in self._seen:
            return name
        self._seen.add(function)
        in_module = self._add_module(function.__module__)
        if in_module and getattr(sys.modules.get(function.__module__), function.__name__, None) is function:
            return name
        if not in_module:
            self._add_cell(code.co_filename, where)
        held = {"defaults": function.__defaults__, "named": function.__kwdefaults__}
        held |= zip(code.co_freevars, (cell.cell_contents for cell in function.__closure__ or ()), strict=True)
        variables = {} if in_module else function.__globals__
        held |= {variable: variables[variable] for variable in {*_names(code)} & variables.keys()}
        return f"{name}:{[*code.co_positions()]}:{self._held(held, where, in_module)}"

    def _held(self, values: dict[str, Any], where: str, in_module: bool) -> str:
        """Describe values that a class or function holds or uses; those of a script may be left out, because its whole
        text counts."""
        script = not in_module and Path(getattr(sys.modules["__main__"], "__file__", "")).is_file()
        texts = []
        for name in sorted(values):
            try:
                texts.append(f"{name}={self.describe(values[name], where)}")
            except UsageError:
                if not script:
                    raise
        return f"{{{','.join(texts)}}}"

    def _add_module(self, name: str) -> bool:
        """Add the text of a user's module, and of those that it imports; return False for a script or notebook, whose
        text is that of its functions."""
        if name in _MAIN:
            return False
        module, package = sys.modules.get(name), name.partition(".")[0]
        if package != _SELF and (file := getattr(module, "__file__", None)):
            path = Path(file).resolve()
            installed = not {*_INSTALLED}.isdisjoint(path.parts)
            if (installed and package == self._package) or not (installed or _STANDARD in path.parents):
                levels = name.count(".") - (not hasattr(module, "__path__"))
                self._add_file(name, path, path.parents[max(levels, 0)])
        return True

    def _add_cell(self, filename: str, where: str) -> None:
        """Add the text of a script, and of the modules that it imports, or of a cell of a notebook."""
        path = Path(filename)
        if path.is_file():
            self._add_file(filename, path.resolve(), path.resolve().parent)
        elif lines := linecache.getlines(filename):
            self.texts[filename] = "".join(lines).encode()
        elif not self._lenient:
            raise UsageError(
                where, f"is defined in a session that does not keep its text; save it as a file, or {_REMEDY}"
            )

    def _add_file(self, name: str, path: Path, root: Path) -> None:
        """Add a file, and those in the folder `root` of its top-level package that it imports."""
        if name in self.texts:
            return
        self.texts[name] = content = path.read_bytes()
        levels = name.count(".") + (path.stem == "__init__")
        package, top = ".".join(name.split(".")[:levels]), path.parents[min(levels, len(path.parents) - 1)]
        for imported in _imported(content, package):
            file = _file_of(imported, top)
            parts = file.relative_to(root.parent).parts if file is not None and root in file.parents else _INSTALLED
            if file is not None and {*_INSTALLED}.isdisjoint(parts):  # an environment may lie in the user's folder
                self._add_file(imported, file, root)


def _file_of(name: str, folder: Path) -> Path | None:
    """Return the file of a module, imported or not yet, as one that a function imports when it is called."""
    if name in sys.modules:
        file = getattr(sys.modules[name], "__file__", None)
        return None if file is None else Path(file).resolve()
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


def _names(code: CodeType) -> Iterator[str]:
    yield from code.co_names
    for value in code.co_consts:
        if isinstance(value, CodeType):
            yield from _names(value)
