"""Names and objects that come from outside: a registry of lazily imported targets, the optional libraries, and a user's
objects given as `module.path:Attribute`."""

from __future__ import annotations

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
from types import ModuleType
from typing import Any, Generic, TypeVar, cast

from .errors import (
    AssetError,
    RobustFlowError,
    UsageError,
    class_and_message,
    first_line,
    names_options,
    raise_interrupt,
    unknown_name,
)

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

    def __init__(
        self, kind: str, entry_point_group: str | None = None, also: Sequence[str] = (), separator: str = ","
    ) -> None:
        self.kind, self.also, self._separator = kind, tuple(also), separator
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
            raise self.unknown(name)
        return cast(T, self._imported(name))

    def unknown(self, name: str) -> UsageError:
        """Return the error for a name that is not registered. Names for which the user's list stands (`also`) are
        proposed, too, and a text with several known names is recognised."""
        names = [*self.names(), *self.also]
        parts = [part for part in re.split(r"[,\s]+", name) if part]
        if len(parts) > 1 and set(parts) <= set(names):
            form = self._separator.join(parts) if names_options() else parts
            return UsageError(name, f"several names of {self.kind}s in one; write {form}")
        if name in self.also:
            return UsageError(name, f"stands for several {self.kind}s; give the name of one")
        return unknown_name(self.kind, name, names)

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
    if not is_target(target) and not target.partition(":")[0].endswith(".py"):
        raise UsageError(target, f"no {kind} has this name; give a registered name or MODULE:ATTRIBUTE")
    name, _, attribute = target.partition(":")
    if name.endswith(".py"):
        meant = f"{Path(name).stem}:{attribute}"
        raise UsageError(target, f"this is a file; run the command in its folder and pass {meant}")
    here = Path.cwd()
    if str(here) not in sys.path and "" not in sys.path:
        os.environ[MODULES] = str(here)
    try:
        with working_folder_kept():
            value: Any = import_module(name)
    except BaseException as cause:  # SystemExit: a script that reads its arguments on import
        raise_interrupt(cause)
        missing = cause.name.partition(".")[0] if isinstance(cause, ModuleNotFoundError) and cause.name else ""
        if missing in EXTRAS:
            raise _not_installed(missing, f"{kind} '{target}'") from cause
        raise UsageError(target, f"cannot import '{name}' for this {kind}: {_reason(name, cause, missing)}") from cause
    for part in attribute.split("."):
        if not hasattr(value, part):
            _refuse_hidden(name, here, kind, target)
            if name in sys.stdlib_module_names:
                raise UsageError(target, f"'{name}' is a module of Python; a registered {kind} is given by its name")
            raise unknown_name(f"attribute of {name}", part, [key for key in vars(value) if key[0] != "_"])
        value = getattr(value, part)
    return value


def _reason(name: str, cause: BaseException, missing: str) -> str:
    """Describe why an import failed and what to do about it."""
    what = class_and_message(cause)
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
    return option in parameters or any(parameter.kind is parameter.VAR_KEYWORD for parameter in parameters.values())


def needed_options(factory: Callable[..., Any]) -> list[str]:
    """Return the names of a factory's required options."""
    by_name = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)
    return [
        key
        for key, parameter in parameters_of(factory).items()
        if parameter.kind in by_name and parameter.default is parameter.empty
    ]


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
    except BaseException as error:
        raise_interrupt(error)
        reason = class_and_message(error)
        if read_only and "read-only" in reason:
            advice = f"copy {read_only} before changing it"
        raise UsageError(culprit, f"{doing} raised {reason}" + (f"; {advice}" if advice else "")) from error


def described(made: Any) -> str:
    """Describe a user's object for messages: `module:Class`, or "the function name"."""
    kind = made if inspect.isclass(made) else type(made)
    return f"the function {made.__name__}" if inspect.isroutine(made) else f"{kind.__module__}:{kind.__qualname__}"
