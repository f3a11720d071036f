"""Compile functions with numba; the only file that imports numba.

By default numba reads settings from `.numba_config.yaml` in the working folder before every compilation, and unpickles
compiled code from whatever folder the settings name. This module prevents both. `_CacheFiles` replaces the part of a
function's cache that reads and writes files, which numba has no documented hook for: each file is sealed with a digest,
so that damaged code is compiled again instead of run, and named so that several processes can write at the same time.
The version of numba is bounded in pyproject.toml, because `_cache`, `_cache_file` and `_impl` are internal.
"""

from __future__ import annotations

import grp
import hashlib
import os
import pickle
import pwd
import stat
import sys
import warnings
from collections.abc import Callable
from functools import cache, wraps
from pathlib import Path
from typing import Any

import numpy as np

from .errors import UsageError
from .files import sealed_bytes, unsealed_bytes
from .types import Frame

_yaml = sys.modules.get("yaml")
sys.modules["yaml"] = None  # type: ignore[assignment]  # without yaml, numba cannot read settings
try:
    warnings.filterwarnings("ignore", "A Numba config file is found")
    import numba.core.caching
    import numba.extending
finally:
    if _yaml is None:
        del sys.modules["yaml"]
    else:
        sys.modules["yaml"] = _yaml

intrinsic, types = numba.extending.intrinsic, numba.types

Function = Callable[..., Any]


def njit(**options: Any) -> Callable[[Function], Any]:
    """Apply `numba.njit`, which compiles a function on its first call."""

    def decorate(function: Function) -> Any:
        compiled = numba.njit(no_cfunc_wrapper=True, **options)(function)
        if options.get("cache"):
            _check_folder(Path(compiled.stats.cache_path))
            files = compiled._cache
            files._cache_file = _CacheFiles(
                files.cache_path, files._impl.filename_base, files._impl.locator.get_source_stamp()
            )
        return compiled

    return decorate


def inner(function: Function) -> Function:
    """Let compiled functions call a function, which is compiled as a part of each of them."""
    registered: Function = numba.extending.register_jitable(function)
    return registered


def njit_late(signature: Any, **options: Any) -> Callable[[Function], Function]:
    """Apply `njit` to a function whose argument types are fixed; it is compiled on its first call.

    >>> @njit_late("float64(float64)")
    ... def half(x):
    ...     return x / 2
    >>> half(3)
    1.5
    """

    def decorate(function: Function) -> Function:
        @cache
        def compiled() -> Any:
            compiled = njit(**options)(function)
            compiled.compile(signature)
            compiled.disable_compile()
            return compiled

        @wraps(function)
        def call(*arguments: Any) -> Any:
            return compiled()(*arguments)

        return call

    return decorate


class _CacheFiles(numba.core.caching.IndexDataCacheFile):
    """Cache files of compiled code, each sealed with a digest and named after its signature and target processor."""

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
    view = np.ascontiguousarray(frame).view()
    view.flags.writeable = False
    return view
