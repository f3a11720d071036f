"""The user's cache: where it is on this platform."""

from __future__ import annotations

import os
from pathlib import Path

from platformdirs import user_cache_path

CACHE_VARIABLE = "ROBUSTFLOW_CACHE"
"""Environment variable that names another folder for the whole cache."""


def cache_folder(part: str) -> Path:
    """Where a part of the cache is kept: in `ROBUSTFLOW_CACHE`, otherwise in the platform's folder for caches.

    >>> cache_folder("frost").name
    'frost'
    """
    named = os.environ.get(CACHE_VARIABLE)
    return (Path(named).expanduser() if named else user_cache_path("robustflow", appauthor=False)) / part
