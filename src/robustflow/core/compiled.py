"""Compile functions with numba; the only file that imports numba.

By default numba reads settings from `.numba_config.yaml` in the working folder before every compilation, and unpickles
compiled code from whatever folder the settings name. This module prevents both. `_cache_files` replaces the part of a
function's cache that reads and writes files, which numba has no documented hook for: each file is sealed with a digest,
so that damaged code is compiled again instead of run, and named so that several processes can write at the same time.
`_cache`, `_cache_file`, `_impl` and `_numba_type_` are internal and have no public counterpart in numba 0.60 to 0.68,
to which its version is bounded.

Importing numba takes a third of the time of importing the package, so it is imported when a function is first called.
"""

from __future__ import annotations

import gc
import grp
import hashlib
import os
import pickle
import pwd
import stat
import sys
import warnings
from collections.abc import Callable
from functools import cache, update_wrapper
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np

from .errors import UsageError
from .files import sealed_bytes, unsealed_bytes
from .types import Frame, read_only

Function = Callable[..., Any]

_inner: list[Function] = []
"""Functions of `inner` that numba does not know yet."""

_importing = Lock()


def load_numba() -> Any:
    """Return numba, imported without the settings of the working folder, after registering all functions of `inner`.
    Call this before starting threads: while numba is imported, no other thread can import yaml."""
    with _importing:
        numba = _import_numba()
        while _inner:
            numba.extending.register_jitable(_inner.pop())
    return numba


@cache
def _import_numba() -> Any:
    yaml = sys.modules.get("yaml")
    sys.modules["yaml"] = None  # type: ignore[assignment]  # without yaml, numba cannot read settings
    try:
        warnings.filterwarnings("ignore", "A Numba config file is found")
        import numba.core.caching
        import numba.core.cgutils
        import numba.extending
    finally:
        if yaml is None:
            del sys.modules["yaml"]
        else:
            sys.modules["yaml"] = yaml
    return numba


def inner(function: Function) -> Function:
    """Let compiled functions call a function, which is compiled as a part of each of them."""
    _inner.append(function)
    return function


if os.path.lexists(".numba_config.yaml"):
    load_numba()  # before any other package imports it, and with it these settings


class _Compiled:
    """A function that numba makes when it is first called, by Python or by another compiled function."""

    def __init__(self, function: Function, make: Callable[[], Any]) -> None:
        update_wrapper(self, function)
        self._make = make

    def _made(self) -> Any:
        if "_of_numba" not in self.__dict__:  # without a lock, because numba locks while it compiles
            self.__dict__.setdefault("_of_numba", self._make())
        return self.__dict__["_of_numba"]

    def __call__(self, *arguments: Any) -> Any:
        return self._made()(*arguments)

    def __getattr__(self, name: str) -> Any:
        """Return an attribute of numba's function: other compiled functions call it by its `_numba_type_`."""
        return getattr(self._made(), name)


def njit(**options: Any) -> Callable[[Function], Any]:
    """Apply `numba.njit`, which compiles a function on its first call.

    Functions compile faster if they get their work arrays as arguments, and if they call `np.minimum` instead of `min`:
    numba compiles `np.empty` and `min` separately for each type.
    """
    return lambda function: _Compiled(function, lambda: _dispatcher(function, options))


def njit_late(signature: str, **options: Any) -> Callable[[Function], Any]:
    """Apply `njit` to a function whose argument types are fixed.

    >>> @njit_late("float64(float64)")
    ... def half(x):
    ...     return x / 2
    >>> half(3)
    1.5
    """

    def dispatcher(function: Function) -> Any:
        compiled = _dispatcher(function, options)
        compiled.compile(signature)
        compiled.disable_compile()
        return compiled

    return lambda function: _Compiled(function, lambda: dispatcher(function))


def intrinsic(function: Function) -> Any:
    """Apply `numba.extending.intrinsic`."""

    def made() -> Any:
        one = load_numba().extending.intrinsic(function)
        typing = load_numba().core.registry.cpu_target.typing_context
        typing.refresh()
        one._numba_type_ = typing.resolve_value_type(one)
        return one

    return _Compiled(function, made)


def code_tools() -> tuple[Any, Any, Any]:
    """Return llvmlite's module `ir` and numba's modules `cgutils` and `types`, for functions that generate code."""
    cgutils = load_numba().core.cgutils
    return cgutils.ir, cgutils, load_numba().types


def _dispatcher(function: Function, options: dict[str, Any]) -> Any:
    """Return numba's function, whose cache consists of sealed files."""
    compiled = load_numba().njit(no_cfunc_wrapper=True, **{"nogil": True, **options})(function)
    compiled.compile = _without_garbage_collection(compiled.compile)
    if options.get("cache"):
        _check_folder(Path(compiled.stats.cache_path))
        files = compiled._cache
        files._cache_file = _cache_files()(
            files.cache_path, files._impl.filename_base, files._impl.locator.get_source_stamp()
        )
    return compiled


def _without_garbage_collection(function: Function) -> Function:
    """Pause the search for garbage while the function runs; it takes a sixth of the time of a compilation."""

    def call(argument: Any) -> Any:
        enabled = gc.isenabled()
        gc.disable()
        try:
            return function(argument)
        finally:
            if enabled:
                gc.enable()

    return call


@cache
def _cache_files() -> Any:
    """Return the class that reads and writes the files of a function's cache."""

    class CacheFiles(load_numba().core.caching.IndexDataCacheFile):  # type: ignore[misc]
        """Files of compiled code, each sealed with a digest and named after its signature and target processor."""

        def save(self, key: Any, data: Any) -> None:
            name = self._name(key)
            with self._open_for_write(self._data_path(name)) as file:
                file.write(sealed_bytes(self._dump(data), self._description(key)))

        def load(self, key: Any) -> Any:
            try:
                data = unsealed_bytes(Path(self._data_path(self._name(key))).read_bytes(), self._description(key))
            except OSError:
                return None
            return None if data is None else pickle.loads(data)

        def _description(self, key: Any) -> str:
            return repr((self._version, key, self._source_stamp))

        def _name(self, key: Any) -> Any:
            digest = hashlib.sha256(repr((self._version, key)).encode()).hexdigest()
            return self._data_name(int(digest[:16], 16))

    return CacheFiles


@cache
def _check_folder(folder: Path) -> None:
    """Raise if other users could put compiled code into a folder."""
    if folder.name == "__pycache__":
        return
    folder, reached = folder.resolve(), True
    for part in (*reversed(folder.parents), folder):
        about = part.stat()
        fixed = part != folder and about.st_mode & stat.S_ISVTX  # sticky bit (/tmp): others cannot replace files
        group = reached and about.st_mode & stat.S_IWGRP and not _is_private(about.st_gid)
        foreign = part == folder and about.st_uid not in (0, os.geteuid())
        if foreign or (not fixed and (group or about.st_mode & stat.S_IWOTH)):
            raise UsageError(
                part,
                "other users can write to this folder, from which numba would load compiled code; remove their write "
                "permission (chmod go-w), or set NUMBA_CACHE_DIR to a folder that only you can write to",
            )
        reached = reached and bool(about.st_mode & (stat.S_IXOTH | stat.S_IXGRP))


def _is_private(group: int) -> bool:
    """Return whether a group is root's or the user's private group."""
    if group == 0:
        return True
    try:
        entry = grp.getgrgid(group)
        return entry.gr_name == pwd.getpwuid(os.geteuid()).pw_name and not entry.gr_mem
    except KeyError:
        return False


def contiguous(frame: Frame) -> Frame:
    """Return the frame as a C-contiguous, read-only array; copy it only if it is not contiguous."""
    return read_only(np.ascontiguousarray(frame))
