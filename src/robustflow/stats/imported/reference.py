"""Read `results.json` of the paper's reference code.

The file is written by models/RAFT/benchmark.py (KITTI-FC) and benchmark_gopro.py (GoPro-FC) of the public repository
ZhonghuaYi/optical_flow_robustness_benchmark, commit 445880d, to benchmark_results/PROJECT/results.json:

    {"fog": {"CRE": [5 values], "rCRE": [...], "clean_EPE": [...], "corrupt_EPE": [...],
             "CRE_mean": ..., "rCRE_mean": ..., "clean_EPE_mean": ..., "corrupt_EPE_mean": ..., "result": "..."},
     "clean": {"clean_EPE": [1 value], "CRE": [[]], "CRE_mean": NaN, ...}, ...}

On GoPro-FC, which has no ground truth, there is only rCRE. The values are for severities 1 to 5 in this order, averaged
over pixels and then over images. "brightness" is the corruption that the paper calls high light.
"""

from __future__ import annotations

from math import fsum
from pathlib import Path
from typing import Any

from ...core.arguments import SEVERITIES
from ...core.errors import DataError, unknown_name
from ...core.paths import user_path
from ...core.text import plain
from ...corruptions.registry import PAPER_ORDER
from ...data.benchmarks import benchmark_facts
from ...data.datasets.released import DISK_NAMES
from ...metrics.rows import CLEAN
from ..model_result import ModelResult, Value
from ..results import AVERAGE
from ..run_results import OWN_SETTING
from .flowbench import NOTE, averaged_over, finite_number

_METRICS = {"corrupt_EPE": "epe", "CRE": "cre", "rCRE": "rcre"}
_PAPER_NAMES = {on_disk: name for name, on_disk in DISK_NAMES.items()}
_KNOWN = (*(DISK_NAMES.get(name, name) for name in PAPER_ORDER), "elastic_transform")
_SOURCE = "results.json of the reference code"


def is_reference(content: Any) -> bool:
    """Whether a file's content has the structure of the reference code's `results.json`.

    >>> is_reference({"fog": {"rCRE": [1, 2, 3, 4, 5]}}), is_reference({"experiments": []})
    (True, False)
    """
    return (
        isinstance(content, dict)
        and bool(content)
        and all(isinstance(entry, dict) for entry in content.values())
        and any("rCRE" in entry for entry in content.values())
    )


def parse(content: dict[str, dict[str, Any]], path: Path) -> ModelResult:
    """Parse the content of a file, whose folder the reference code names after the model, the setting and the time.
    Files of one benchmark with the same corruptions form a sample set, because the release has only one set of
    frames.
    """
    values: dict[tuple[str, str], float] = {}
    for written, entry in content.items():
        where = f"{path}, '{plain(written, 40)}'"
        if written == CLEAN:
            continue
        if written not in _KNOWN:
            raise DataError(path, f"{unknown_name('corruption', plain(written, 40), _KNOWN)}")
        name = _PAPER_NAMES.get(written, written)
        for written_metric, metric in _METRICS.items():
            if written_metric in entry:
                values[metric, name] = _mean(entry[written_metric], f"{where}, {written_metric}", metric == "cre")
    if not values:
        raise DataError(f"{path} contains no corruptions, so robustness cannot be measured")
    clean = _clean(content, path)
    if clean is not None:
        values["epe", CLEAN] = clean
    benchmark = "kitti-fc" if any(metric == "epe" for metric, _ in values) else "gopro-fc"
    names = [name for name in PAPER_ORDER if any(corruption == name for _, corruption in values)]
    for metric in _METRICS.values():
        if names and all((metric, name) in values for name in names):
            values[metric, AVERAGE] = fsum(values[metric, name] for name in names) / len(names)
    frames = f"Reference code, {benchmark}, {averaged_over(names, benchmark_facts(benchmark).paper_corruptions)}"
    model = user_path(path).resolve().parent.name if path.name == "results.json" else path.stem
    cells = {key: Value(value, source=_SOURCE) for key, value in values.items()}
    return ModelResult(benchmark, frames, OWN_SETTING, plain(model) or "unnamed", NOTE, cells)


def _mean(written: Any, where: str, signed: bool) -> float:
    if not isinstance(written, list) or len(written) != len(SEVERITIES):
        raise DataError(where, f"expected {len(SEVERITIES)} values, one for each severity")
    return fsum(finite_number(value, where, signed=signed) for value in written) / len(SEVERITIES)


def _clean(content: dict[str, dict[str, Any]], path: Path) -> float | None:
    """Return the clean EPE from the entry "clean" or else from any corruption; all contain the same value."""
    for written in (CLEAN, *content):
        values = content.get(written, {}).get("clean_EPE")
        if isinstance(values, list) and values:
            return finite_number(values[0], f"{path}, '{plain(written, 40)}', clean_EPE")
    return None
