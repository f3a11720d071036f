"""Names and objects that come from outside: a registry of lazily imported targets, the optional libraries, a user's
objects given as `module.path:Attribute`, and a hash of everything that determines what a user's object computes.
"""

from __future__ import annotations

import ast
import hashlib
import inspect
import os
import re
import sys
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib import import_module
from importlib.machinery import ModuleSpec, PathFinder
from importlib.metadata import entry_points
from importlib.util import find_spec
from pathlib import Path
from pkgutil import resolve_name
from types import CodeType, ModuleType
from typing import Any, Generic, TypeVar, cast

from .errors import AssetError, RobustFlowError, UsageError, first_line, unknown_name

T = TypeVar("T")

_SELF = __name__.partition(".")[0]


class Registry(Generic[T]):
    """The names of one kind of object, in the order of registration; duplicate names are rejected.

    >>> colours = Registry[str]("colour")
    >>> colours.add("red", "string:ascii_lowercase")
    >>> colours.get("red")[:3]
    'abc'
    >>> colours.get("rad")  # doctest: +IGNORE_EXCEPTION_DETAIL
    Traceback (most recent call last):
    robustflow.core.errors.UsageError: unknown colour 'rad': did you mean 'red'? Known: red
    """

    def __init__(self, kind: str, entry_point_group: str | None = None) -> None:
        self.kind = kind
        self._targets: dict[str, str] = {}
        self._group = entry_point_group

    def add(self, name: str, target: str) -> None:
        """Register `name` for the lazy target `"module:attribute"`."""
        if self._targets.get(name, target) != target:
            raise RobustFlowError(
                name, f"{self.kind} registered twice, for {self._targets[name]} and for {target}; rename one"
            )
        self._targets[name] = target

    def __contains__(self, name: object) -> bool:
        return name in self.names()

    def __iter__(self) -> Iterator[str]:
        return iter(self.names())

    def __len__(self) -> int:
        return len(self.names())

    def names(self) -> list[str]:
        """Return all names in the order of registration; names from installed packages come last."""
        self._discover()
        return list(self._targets)

    def get(self, name: str) -> T:
        """Return the object registered under a name, imported on first use."""
        if name not in self._targets:
            self._discover()
        if name not in self._targets:
            raise unknown_name(self.kind, name, self._targets)
        return cast(T, self._imported(name))

    def _imported(self, name: str) -> Any:
        target = self._targets[name]
        try:
            return resolve_name(target)
        except Exception as error:
            if isinstance(error, RobustFlowError) or target.startswith(f"{_SELF}."):
                raise
            raise UsageError(
                name,
                f"the entry point '{name} = {target}' of an installed package cannot be imported: "
                f"{type(error).__name__}: {first_line(error)}; repair or uninstall the package",
            ) from error

    def _discover(self) -> None:
        if self._group is None:
            return
        for point in entry_points(group=self._group):
            self.add(point.name, f"{point.module}:{point.attr}")
        self._group = None


EXTRAS = {
    "torch": "torch",
    "torchvision": "torch",
    "ptlflow": "ptlflow",
    "onnx": "onnx",
    "onnxruntime": "onnx",
    "ray": "ray",
    "h5py": "h5",
    "starlette": "app",
    "uvicorn": "app",
    "python_multipart": "app",
}
"""Mapping from a module to the extra of this package that installs it."""


def require(library: str, needing: str) -> None:
    """Raise an error that names the required extra if a library is not installed."""
    if find_spec(library) is None:
        raise _not_installed(library, needing)


def _not_installed(library: str, needing: str) -> AssetError:
    remedy = f"{install_command(library)} (with -c constraints.txt from a checkout)"
    return AssetError(library, f"not installed, but {needing} needs it: {remedy}")


def install_command(library: str) -> str:
    """Return the command that installs a library of `EXTRAS`."""
    return f"pip install 'robustflow[{EXTRAS[library]}]'"


MODULES = "ROBUSTFLOW_MODULES"
"""Environment variable that names an additional folder to import modules from; child processes inherit it."""

_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,59}")


class FolderOfModules:
    """Finder of modules in the folder named by `MODULES`, the last finder on `sys.meta_path`."""

    @staticmethod
    def find_spec(name: str, path: Sequence[str] | None = None, target: ModuleType | None = None) -> ModuleSpec | None:
        folder = os.environ.get(MODULES)
        if folder is None or path is not None or name in sys.stdlib_module_names:
            return None
        return PathFinder.find_spec(name, [folder], target)


sys.meta_path.append(FolderOfModules)


@contextmanager
def working_folder_kept() -> Iterator[None]:
    """Return to the working folder, to which the paths of a command are relative, if the user's code leaves it."""
    before = os.getcwd()
    try:
        yield
    finally:
        os.chdir(before)


def is_target(text: str) -> bool:
    """Return whether a text has the form `module.path:Attribute`.

    >>> is_target("mypkg.data:MySet"), is_target("kitti-fc"), is_target("C:/data"), is_target("data/clip.mp4")
    (True, False, False, False)
    """
    module, colon, attribute = text.partition(":")
    return bool(colon) and all(name.isidentifier() for name in f"{module}.{attribute}".split("."))


def import_target(target: str, kind: str) -> Any:
    """Import an attribute of a module that is installed or in the working folder."""
    name, _, attribute = target.partition(":")
    here = Path.cwd()
    if str(here) not in sys.path and "" not in sys.path:
        os.environ[MODULES] = str(here)
    try:
        with working_folder_kept():
            value: Any = import_module(name)
    except (Exception, SystemExit) as cause:  # SystemExit: a script that reads its arguments on import
        missing = cause.name.partition(".")[0] if isinstance(cause, ModuleNotFoundError) and cause.name else ""
        if missing in EXTRAS:
            raise _not_installed(missing, f"{kind} '{target}'") from cause
        raise UsageError(target, f"cannot import '{name}' for this {kind}: {_reason(name, cause, missing)}") from cause
    for part in attribute.split("."):
        if not hasattr(value, part):
            _refuse_hidden(name, here, kind, target)
            raise unknown_name(f"attribute of {name}", part, [key for key in vars(value) if key[0] != "_"])
        value = getattr(value, part)
    return value


def _reason(name: str, cause: BaseException, missing: str) -> str:
    """Describe why an import failed and what to do about it."""
    what = f"{type(cause).__name__}: {cause}"
    if missing == name.partition(".")[0]:
        return f"{what}; run from the folder that contains it, or install its package"
    if missing:
        return f"{what}; install {missing}"
    if isinstance(cause, SyntaxError) and cause.text:
        return f"{what}: {cause.text.strip()[:200]}"
    return f"{what} (raised during the import)"


def _refuse_hidden(name: str, here: Path, kind: str, target: str) -> None:
    """Raise if an installed module hides the module in the working folder."""
    file, first = getattr(sys.modules[name], "__file__", None), name.partition(".")[0]
    local = next((path for path in (here / f"{first}.py", here / first) if path.exists()), None)
    if local is not None and (file is None or not Path(file).is_relative_to(here)):
        raise UsageError(
            f"'{name}' for {kind} '{target}' is {file or 'part of Python'}, not {local}: an installed module takes "
            f"precedence; rename {local.name}"
        )


def source_of_target(target: str) -> bytes | None:
    """Return the source file of a target's module, or None if it was not imported or has no file."""
    path = getattr(sys.modules.get(target.partition(":")[0]), "__file__", None)
    return Path(path).read_bytes() if path else None


def own_name(made: Any) -> str:
    """Return the name of a user's class or object: its attribute `name`, or the class name in snake case."""
    kind = made if inspect.isclass(made) else type(made)
    named = getattr(made, "name", None)
    return named if isinstance(named, str) else re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", kind.__name__).lower()


def checked_name(made: Any, kind: str, is_taken: Callable[[str], bool]) -> str:
    """Return the name under which a user's class or object is registered."""
    name = own_name(made)
    if not _NAME.fullmatch(name) or name in ("clean", "average"):
        raise UsageError(name, f"not a valid {kind} name; use only letters, digits and '_'")
    if is_taken(name):
        raise UsageError(name, f"{described(made)} has the same name as this {kind}; give it a different `name`")
    return name


def parameters_of(function: Callable[..., Any]) -> Mapping[str, inspect.Parameter]:
    """Return a callable's parameters, or an empty mapping if Python cannot determine them (some built-in types)."""
    try:
        return inspect.signature(function).parameters
    except (TypeError, ValueError):
        return {}


def accepts(function: Callable[..., Any], option: str) -> bool:
    """Return whether a callable accepts an option."""
    parameters = parameters_of(function)
    return option in parameters or any(one.kind is one.VAR_KEYWORD for one in parameters.values())


def needed_options(factory: Callable[..., Any]) -> list[str]:
    """Return the names of a factory's required options."""
    by_name = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)
    return [key for key, one in parameters_of(factory).items() if one.kind in by_name and one.default is one.empty]


def check_options(factory: Callable[..., Any], what: str, options: Collection[str], flag: str) -> None:
    """Check the options for a class or function before it is called."""
    for option in options:
        if not accepts(factory, option):
            raise unknown_name(f"option of {what}", option, parameters_of(factory) or ["(it has no options)"])
    missing = [option for option in needed_options(factory) if option not in options]
    if missing:
        raise UsageError(missing[0], f"an option that {what} needs; pass {flag} {missing[0]}=VALUE")


def called(culprit: str, doing: str, function: Callable[[], Any], advice: str = "", read_only: str = "") -> Any:
    """Call a user's function and return its result; convert its exceptions to a `UsageError`."""
    try:
        return function()
    except RobustFlowError:
        raise
    except Exception as error:
        if read_only and "read-only" in str(error):
            advice = f"copy {read_only} before changing it"
        reason = f"{type(error).__name__}: {error}" + (f"; {advice}" if advice else "")
        raise UsageError(culprit, f"{doing} raised {reason}") from error


def described(made: Any) -> str:
    """Describe a user's object for messages: `module:Class`, or "the function name"."""
    kind = made if inspect.isclass(made) else type(made)
    return f"the function {made.__name__}" if inspect.isroutine(made) else f"{kind.__module__}:{kind.__qualname__}"


def source_digest(made: Any) -> str:
    """Return a hash of a class's or object's attributes and source, as 16 hexadecimal digits: the files of the class
    and its base classes, and every module of the same folder or package that they import.
    """
    kind = made if inspect.isclass(made) else type(made)
    digest = hashlib.blake2b(digest_size=8)
    for text in sorted(_sources(kind)):
        digest.update(hashlib.sha256(text).digest())
    if not inspect.isclass(made):
        named = getattr(made, "source", "")
        state = named if isinstance(named, str) and named else {k: v for k, v in vars(made).items() if k != "variant"}
        digest.update(_value_text(state, f"{kind.__name__}").encode())
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
    constants = [_code(value) if isinstance(value, CodeType) else repr(value) for value in code.co_consts]
    return f"{code.co_code.hex()} {constants} {code.co_names}"


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
    if inspect.isclass(value) or inspect.isroutine(value):
        return f"{value.__module__}:{value.__qualname__}"
    raise UsageError(
        where,
        f"contains a {type(value).__name__}, which a later run could not recognise; give it a property "
        "`source` that describes, as text, everything that determines its result",
    )
