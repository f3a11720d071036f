"""Describe the environment of a run, for its manifest."""

from __future__ import annotations

import os
import platform
import sys
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from typing import Annotated

from pydantic import Field

from ..validated import Untrusted
from .identity import Text

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


class Machine(Untrusted):
    """The machine; a record contains only its kind, without the version of the operating system."""

    system: str
    processor: str
    cores: int | None


class Environment(Untrusted):
    """Versions of all software that can change results, the machine, and the command line, which a record omits."""

    python: str
    packages: Annotated[dict[Text, Text], Field(max_length=100)]
    machine: Machine
    command: tuple[str, ...] = ()


@cache
def _versions() -> dict[str, str]:
    """Return the versions of the installed packages. Parsing takes a tenth of a second, so the result is cached."""
    versions = {}
    for name in _PACKAGES:
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            continue
    return versions


def environment() -> Environment:
    """Return the environment of this process."""
    return Environment(
        python=platform.python_version(),
        packages=_versions(),
        machine=Machine(system=platform.platform(), processor=platform.machine(), cores=os.cpu_count()),
        command=(os.path.basename(sys.argv[0]), *sys.argv[1:]),
    )
