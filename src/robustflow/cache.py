"""Location of the user's cache on this platform."""

from __future__ import annotations

import os
from pathlib import Path

from platformdirs import user_cache_path

CACHE_VARIABLE = "ROBUSTFLOW_CACHE"
"""Environment variable that overrides the folder of the whole cache."""


def cache_folder(part: str) -> Path:
    """Return the folder of one part of the cache, inside `ROBUSTFLOW_CACHE` or the platform's cache folder.

    >>> cache_folder("frost").name
    'frost'
    """
    named = os.environ.get(CACHE_VARIABLE)
    return (Path(named).expanduser() if named else user_cache_path("robustflow", appauthor=False)) / part
