"""The environment of a run, for its manifest."""

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
    """The machine; a record holds only its kind, without the version of the system."""

    system: str
    processor: str
    cores: int | None


class Environment(Untrusted):
    """Versions of everything that can change a number, the machine, and the command line, which a record leaves out."""

    python: str
    packages: Annotated[dict[Text, Text], Field(max_length=100)]
    machine: Machine
    command: tuple[str, ...] = ()


@cache
def _versions() -> dict[str, str]:
    """Versions of the installed packages: a tenth of a second of parsing, and the same for every run of a process."""
    versions = {}
    for name in _PACKAGES:
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            continue
    return versions


def environment() -> Environment:
    """The environment of this process."""
    return Environment(
        python=platform.python_version(),
        packages=_versions(),
        machine=Machine(system=platform.platform(), processor=platform.machine(), cores=os.cpu_count()),
        command=(os.path.basename(sys.argv[0]), *sys.argv[1:]),
    )
