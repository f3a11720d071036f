"""Where a run's model and data are, which `report --examples` needs to repeat cells of a finished run, and where a run
is stored by default.

The file is stored next to the manifest, not in it: paths on one machine are not part of a result and are not shared
with it.

A run's folder is untrusted, so this file can only load models that its author cannot have written: models registered by
this package or by an installed one (an entry point), and those of ptlflow. Code (`module:attribute`) and files
(exported networks, folders of flows, checkpoints by path) have to be named again by the user.
"""

from __future__ import annotations

import json
import math
import re
import warnings
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..core.errors import RunError, UsageError
from ..core.files import write_json
from ..core.paths import user_path
from ..core.text import file_name, plain
from ..data.benchmarks.facts import moving_name
from ..data.datasets.dataset import OWN_FRAMES
from ..models.catalog import PTLFLOW, is_in_ptlflow
from ..models.loading import ModelRef
from ..models.registered import MODELS
from .identity import differing_fields
from .plan import Plan
from .store import RunFolder

FILE = "source.json"


@dataclass(frozen=True)
class RunSource:
    """The model and data needed to set up a run again."""

    model: ModelRef | None = None
    data: Path | None = None
    data_options: dict[str, Any] = field(default_factory=dict)
    unread: str = ""
    """Name of a recorded model that is code or a file, which is not loaded."""

    def write(self, folder: Path) -> None:
        model = None
        if self.model is not None:
            model = {"name": self.model.name, "options": _plain(self.model.keywords.items())}
        data = None if self.data is None else str(user_path(self.data).absolute())
        options = _plain(self.data_options.items())
        write_json(folder / FILE, {"schema": 1, "model": model, "data": data, "data_options": options})

    @classmethod
    def read(cls, folder: Path) -> RunSource:
        """Read the source of a run; return an empty source if there is no file."""
        try:
            source = json.loads((folder / FILE).read_text(encoding="utf-8"))
            model, data = source["model"], source["data"]
            name, options = ("", {}) if model is None else (str(model["name"]), _scalars(model["options"]))
            registered = name.removeprefix(PTLFLOW) in MODELS.names() or is_in_ptlflow(name)
            loadable = registered and name not in _OF_FILES
            ref = ModelRef.parse(name, options) if loadable else None
            unread = "" if loadable else name
            return cls(ref, None if data is None else Path(data), _scalars(source["data_options"]), unread)
        except FileNotFoundError:
            return cls()
        except (OSError, ValueError, KeyError, TypeError, RecursionError, UsageError) as error:
            raise RunError(folder / FILE, "damaged; delete it, and give --model and --data instead") from error

    def model_to_reuse(self, given: Mapping[str, Any]) -> ModelRef | None:
        """Return the recorded model with the options that the user gives now; None for a Python object."""
        if self.unread:
            raise RunError(plain(self.unread), f"{FILE} names code or a file, which is not loaded; give --model")
        if self.model is None:
            return None
        for key, value in self.model.keywords.items():
            if key not in given and isinstance(value, str) and _LIKE_A_PATH.search(value):
                raise RunError(
                    plain(value, 200), f"{FILE} names a file, which is not opened; give -O {plain(key)}=VALUE"
                )
        return self.model.with_options(given)


_OF_FILES = ("precomputed", "onnx")
"""Registered models that consist entirely of the user's files."""
_LIKE_A_PATH = re.compile(r"[/\\:~]|\.[A-Za-z]\w*$")


def _scalars(options: dict[str, Any]) -> dict[str, Any]:
    """Return the options read from a file; raise a TypeError for a list or an object, which could contain paths."""
    if any(isinstance(value, list | dict) for value in dict(options).values()):
        raise TypeError("an option is not a scalar")
    return dict(options)


def _plain(options: Iterable[tuple[str, Any]]) -> dict[str, Any]:
    """Convert options to JSON types; a Python object, possible only with `evaluate`, is converted to a string.

    >>> _plain([("step", 2), ("root", Path("a")), ("limit", float("inf"))])
    {'step': 2, 'root': 'a', 'limit': 'inf'}
    """
    types = (str, int, type(None))
    return {
        name: value if isinstance(value, types) or (isinstance(value, float) and math.isfinite(value)) else str(value)
        for name, value in options
    }


def default_folder(plan: Plan, data: str | Path | None = None) -> Path:
    """Return the default folder of a run: `runs/<benchmark>_<model>_<identity>`, followed by the name of the data
    for a user's own frames, because the identity does not depend on which frames they are."""
    ref = plan.model.ref
    name = ref.name if ref is not None else plan.model.identity.get("name", "model")
    benchmark = plan.benchmark.name
    if moving_name(benchmark) == OWN_FRAMES and data is not None:
        benchmark += f"-{file_name(user_path(data).absolute().stem)[-40:]}"
    return Path("runs") / f"{benchmark}_{file_name(str(name))[-40:]}_{plan.identity.digest()[:8]}"


def warn_of_a_fresh_start(folder: Path, plan: Plan) -> None:
    """Warn that a run starts in a new folder because the source of one of the user's corruptions was edited."""
    identity = plan.identity
    if folder.exists() or not identity.frames.corruptions:
        return
    for other in sorted(folder.parent.glob(f"{folder.name.rpartition('_')[0]}_*")):
        try:
            manifest = RunFolder(other).manifest()
        except RunError:
            continue
        if manifest is not None and differing_fields(identity, manifest.identity) == ["corruptions"]:
            edited = differing_fields(identity.frames.corruptions, manifest.identity.frames.corruptions)
            warnings.warn(f"{', '.join(edited)} has changed since {other}; a new run starts in {folder}", stacklevel=3)
            return
