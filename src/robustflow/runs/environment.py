"""The environment of a run, for its manifest."""

from __future__ import annotations

import os
import platform
import sys
from importlib.metadata import PackageNotFoundError, version
from typing import Any

_PACKAGES = (
    "robustflow",
    "numpy",
    "opencv-python-headless",
    "opencv-python",
    "scipy",
    "numba",
    "polars",
    "av",
    "torch",
    "torchvision",
    "ptlflow",
)


def environment() -> dict[str, Any]:
    """Versions of everything that can change a number, and the machine."""
    versions = {}
    for name in _PACKAGES:
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            continue
    return {
        "python": platform.python_version(),
        "packages": versions,
        "machine": {"system": platform.platform(), "processor": platform.machine(), "cores": os.cpu_count()},
        "command": [os.path.basename(sys.argv[0]), *sys.argv[1:]],
    }
