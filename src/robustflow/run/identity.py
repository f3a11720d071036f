"""What a manifest says about a run: its identity, which is everything that determines its results, and its environment.

A plan makes an `Identity`; manifests and records store it; it is used to resume, compare, group and repeat runs.
"""

from __future__ import annotations

import os
import platform
import sys
from collections.abc import Mapping
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from types import MappingProxyType
from typing import Annotated, Any, Self

from pydantic import Field, JsonValue

from ..core.errors import UsageError
from ..core.files import digest_of_value
from ..core.types import Untrusted
from ..corruptions.scale import calibration_digest
from ..data.benchmarks.facts import EXPORTED
from .config import FrameOptions, MeasuringOptions

IDENTITY_VERSION = 2

LONGEST_NAME = 80
"""Maximum length of a model's name in tables and figures."""

Text = Annotated[str, Field(min_length=1)]


class _IdentityPart(Untrusted):
    """Base of the parts."""

    def record(self) -> dict[str, Any]:
        """Return this part as stored in a manifest: JSON types only, without fields that have their default values."""
        return self.model_dump(mode="json", exclude_defaults=True)


class FrameIdentity(FrameOptions, _IdentityPart):
    """Everything that determines frames and ground truth, except which samples, corruptions and severities."""

    benchmark: Text
    dataset: Text
    protocol: dict[str, JsonValue]
    seed: int  # required, as in every earlier manifest: without a default it is always stored
    variant: Text
    streams: int
    attacks: int
    psf: Text | None = None
    depth: Text | None = None
    corruptions: dict[Text, Text] = {}
    attack_sources: dict[Text, Text] = {}

    @property
    def made_with(self) -> dict[str, JsonValue]:
        """Return the seed, the variant and the severity scale of the corrupted frames: those of the export if the
        frames are read from one."""
        made: dict[str, JsonValue] = {
            "seed": self.seed,
            "variant": self.variant,
            "severity_scale": self.severity_scale,
        }
        exported = self.protocol if EXPORTED.items() <= self.protocol.items() else {}
        return made | {name: value for name, value in exported.items() if type(value) is type(made.get(name))}

    @property
    def scale(self) -> str:
        """Return the name of the severity scale: "paper" or "calibrated"."""
        return self.severity_scale.partition(" ")[0]

    @property
    def options(self) -> FrameOptions:
        """Return the options of the run."""
        given = {name: getattr(self, name) for name in FrameOptions.model_fields}
        return FrameOptions(**given | {"severity_scale": self.scale})


class ModelIdentity(_IdentityPart):
    """The model's description of itself (`robustflow.models.protocols.model_identity`), and the window of frames
    around a pair that the model receives; None for a two-frame model."""

    settings: dict[str, JsonValue]
    window: dict[str, JsonValue] | None = None


class Measuring(MeasuringOptions, _IdentityPart):
    """Versions of identity and rows, and the options of measuring."""

    version: int
    rows: int
    allow_invalid: bool  # required, as the seed

    @property
    def options(self) -> MeasuringOptions:
        """Return the options of the run."""
        return MeasuringOptions(**{name: getattr(self, name) for name in MeasuringOptions.model_fields})


class Identity(_IdentityPart):
    """Exactly the settings that change the numbers in a row; the number of workers and the choice of samples are not
    included. Two runs with equal identities may share a folder."""

    frames: FrameIdentity
    model: ModelIdentity
    measuring: Measuring

    def digest(self) -> str:
        """Return a stable hash of 16 hexadecimal digits, the same for a plan and for its manifest."""
        return digest_of_value(self.record())


def recorded_scale(scale: str) -> str:
    """Return a severity scale as an identity names it: with the digest of the calibration."""
    return f"calibrated {calibration_digest()}" if scale == "calibrated" else scale


def difference(now: Identity | Mapping[str, Any], before: Identity | Mapping[str, Any]) -> str:
    """Name the fields in which two identities, or two descriptions of models, differ, and the entries of a field that
    has several; the settings of a model count as one field, "model".

    >>> difference({"seed": 1, "own": {"rain": "a", "hail": "b"}}, {"seed": 1, "own": {"rain": "c", "hail": "b"}})
    'own (rain)'
    """
    named = []
    for field in differing_fields(now, before):
        new, old = _fields(now).get(field, {}), _fields(before).get(field, {})
        both = isinstance(new, dict) and isinstance(old, dict) and field != "model"
        entries = differing_fields(new, old) if both else []
        named.append(f"{field} ({', '.join(entries)})" if entries else field)
    return ", ".join(named) or "identity"


def differing_fields(now: _IdentityPart | Mapping[str, Any], before: _IdentityPart | Mapping[str, Any]) -> list[str]:
    """Return the names of the fields in which two identities, or two of their parts, differ."""
    new, old = _fields(now), _fields(before)
    return sorted(key for key in new.keys() | old.keys() if new.get(key) != old.get(key))


def _fields(part: _IdentityPart | Mapping[str, Any]) -> Mapping[str, Any]:
    if isinstance(part, Identity):
        model = {"model": part.model.settings, "window": part.model.window}
        return {**dict(part.frames), **model, **dict(part.measuring)}
    return part if isinstance(part, Mapping) else dict(part)


def checked_name(name: str) -> str:
    """Check a model's name for tables and figures, and remove surrounding spaces.

    >>> checked_name(" My model ")
    'My model'
    """
    name = name.strip()
    if not name or len(name) > LONGEST_NAME or not name.isprintable():
        raise UsageError(f"{name[:100]!r}", f"the name of a model must be 1 to {LONGEST_NAME} printable characters")
    return name


_PACKAGES = ["robustflow", "numpy", "opencv-python-headless", "opencv-python", "scipy", "numba", "polars", "av"]
_PACKAGES += ["pillow", "scikit-image", "torch", "torchvision", "ptlflow", "onnxruntime"]
_OF_MODELS = ("torch", "torchvision", "ptlflow", "onnxruntime")
"""Packages that affect results only if they are imported."""


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

    def versions(self) -> dict[str, str]:
        """Return everything in it that can affect bytes of frames, or flows."""
        unused = {"polars", *(name for name in _OF_MODELS if name not in sys.modules)}
        packages = {name: version for name, version in self.packages.items() if name not in unused}
        return {**packages, "python": self.python, "processor": self.machine.processor}

    def shareable(self) -> Self:
        """Return it without the command line, and without facts about the machine except its kind."""
        kind = self.machine.model_copy(update={"system": self.machine.system.partition("-")[0]})
        return self.model_copy(update={"machine": kind, "command": ()})


def versions_in_words(before: Mapping[str, str], now: Mapping[str, str]) -> str:
    """Describe the differing versions of two environments.

    >>> versions_in_words({"numpy": "2.3", "scipy": "1.17"}, {"numpy": "2.4", "scipy": "1.17", "torch": "2.6"})
    'numpy 2.3, now 2.4; torch none, now 2.6'
    """
    names = differing_fields(now, before)
    return "; ".join(f"{name} {before.get(name, 'none')}, now {now.get(name, 'none')}" for name in names)


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


def environment(libraries: Mapping[str, str] = MappingProxyType({})) -> Environment:
    """Return the environment of this process, with the versions of further libraries."""
    return Environment(
        python=platform.python_version(),
        packages={**_versions(), **libraries},
        machine=Machine(system=platform.platform(), processor=platform.machine(), cores=os.cpu_count()),
        command=(os.path.basename(sys.argv[0]), *sys.argv[1:]),
    )
