"""Warn if data are not all of a benchmark of the paper, because its name is the title of the results. A released
benchmark, read from disk.
"""

from __future__ import annotations

import json
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ...core.errors import DataError
from ...core.files import read_bounded
from ...core.text import first_of, plain
from ...corruptions import PAPER_ORDER, SEVERITIES
from ...corruptions.registry import SHIPPED
from ...corruptions.stack import needs_depth
from ..datasets.released import ReleasedPairs
from .base import Benchmark
from .facts import EXPORTED, BenchmarkFacts

_MOST_NAMED = 20


def warn_unless_whole(title: str, noun: str, wanted: Sequence[str], evaluated: Sequence[str], remedy: str = "") -> None:
    """Warn if the evaluated pairs or sequences are not those of a benchmark."""
    missing = [name for name in wanted if name not in set(evaluated)]
    others = len(set(evaluated) - set(wanted))
    remarks = []
    if missing:
        remarks.append(
            f"{len(missing)} of {title}'s {len(wanted)} {noun}s are missing ({first_of(missing, _MOST_NAMED)})"
        )
    if others:
        remarks.append(
            f"{others} of the {len(evaluated)} evaluated {'is' if others == 1 else 'are'} not part of {title}"
        )
    if remarks:
        warn_incomplete(title, ", and ".join(remarks), remedy)


def warn_incomplete(title: str, what: str, remedy: str = "") -> None:
    """Warn that results on these data are not results on a benchmark."""
    warnings.warn(f"{what}; the result is not a {title} result{remedy}", stacklevel=5)


EXPORT_FILE = "export.json"
"""Name of the file in which `export` records the settings of the frames that it wrote."""
_LARGEST = 1 << 20
_RECORDED = ("seed", "variant", "severity_scale", "common_draws")


def released(name: str, dataset: ReleasedPairs, keys: list[str], facts: BenchmarkFacts) -> Benchmark:
    """Return a benchmark with only the corruptions and severities in the folder; no corruption is computed on the fly.
    Its protocol distinguishes the authors' frames, of which only the paper's corruptions are read, from an export by
    this package.
    """
    settings = export_settings(dataset.root)
    source = (settings or {}).get("benchmark", name)
    if source != name:
        raise DataError(
            dataset.root,
            f"frames exported from {plain(str(source))}, so a result on them is not a {name} result; "
            f"run that benchmark on its own data, or export {name}",
        )
    flat = [corruption for corruption in SHIPPED if not needs_depth(corruption)]  # an export does not contain depth
    by_corruption = {
        corruption: dataset.severities(corruption) for corruption in (PAPER_ORDER if settings is None else flat)
    }
    by_corruption = {corruption: levels for corruption, levels in by_corruption.items() if levels}
    severities = tuple(level for level in SEVERITIES if all(level in levels for levels in by_corruption.values()))
    if not by_corruption or not severities:
        raise DataError(
            dataset.root,
            "contains clean frames, but no severity that all corruptions share; expected folders "
            "such as fog_3 next to clean",
        )
    protocol: dict[str, Any] = {"frames": "released"}
    if settings is not None:
        protocol = {
            **EXPORTED,
            **{key: settings[key] for key in _RECORDED if isinstance(settings.get(key), str | int)},
        }
    return Benchmark(
        name, dataset, tuple(keys), tuple(by_corruption), severities, protocol=protocol, closed=True, facts=facts
    )


def export_settings(folder: Path) -> dict[str, Any] | None:
    """Return the settings with which this package wrote the frames in a folder: empty if they cannot be read, None for
    a folder that was written by others."""
    record = folder / EXPORT_FILE
    if not record.is_file():
        return None
    try:
        settings = json.loads(read_bounded(record, _LARGEST, "restore it"))
    except (DataError, ValueError, RecursionError):
        return {}
    return settings if isinstance(settings, dict) else {}
