"""Location of the user's cache on this platform."""

from __future__ import annotations

import os
from pathlib import Path

from platformdirs import user_cache_path

from .errors import DataError
from .layout import user_path

CACHE_VARIABLE = "ROBUSTFLOW_CACHE"
"""Environment variable that overrides the folder of the whole cache."""


def cache_folder(part: str) -> Path:
    """Return the folder of one part of the cache, inside `ROBUSTFLOW_CACHE` or the platform's cache folder."""
    if named := os.environ.get(CACHE_VARIABLE):
        return user_path(named) / part
    try:
        folder = user_cache_path("robustflow", appauthor=False)
    except RuntimeError:
        folder = Path("~")
    if folder.parts[0] == "~":  # older versions of platformdirs do not raise
        raise DataError(f"this user has no home folder for cached files; set {CACHE_VARIABLE} to a folder")
    return folder / part
