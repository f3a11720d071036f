"""Import results of the paper's reference code, as lines of results tables.

They are means without the underlying rows, so they cannot be verified; every imported line has the note `NOTE`.

**The paper's reference code** writes benchmark_results/PROJECT/results.json (models/RAFT/benchmark.py and
benchmark_gopro.py of ZhonghuaYi/optical_flow_robustness_benchmark, commit 445880d):

    {"fog": {"CRE": [5 values], "rCRE": [...], "clean_EPE": [...], "corrupt_EPE": [...], "result": "...", ...},
     "clean": {"clean_EPE": [1 value], "CRE": [[]], "CRE_mean": NaN, ...}, ...}

The values are for severities 1 to 5, averaged over pixels and then over images; without ground truth (GoPro-FC),
there is only rCRE. "brightness" is the corruption that the paper calls high light.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import polars as pl
from pydantic import ConfigDict, Field, TypeAdapter, ValidationError

from ..core.errors import DataError, first_misfit, unknown_name
from ..core.files import read_bounded
from ..core.paths import user_path
from ..core.text import counted, plain
from ..corruptions.registry import PAPER_ORDER
from ..data.benchmarks import benchmark_facts
from ..data.datasets.released import DISK_NAMES
from ..metrics.measures import MEASURES, exact_mean
from ..metrics.rows import CLEAN
from .frame import LINE, given_frame
from .results import AVERAGE

NOTE = "imported, not verifiable: no seed, no rows"
"""The note on every imported line."""

_LARGEST_FILE = 16 * 2**20
_METRICS = {"corrupt_EPE": "epe", "CRE": "cre", "rCRE": "rcre"}
_PAPER_NAMES = {on_disk: name for name, on_disk in DISK_NAMES.items()}
_KNOWN = (*(DISK_NAMES.get(name, name) for name in PAPER_ORDER), "elastic_transform")


_Length = Annotated[float, Field(ge=0, le=1e9, allow_inf_nan=False)]
"""A length in pixels."""
_Change = Annotated[float, Field(ge=-1e9, le=1e9, allow_inf_nan=False)]
_FIVE = Field(min_length=5, max_length=5)
_STRICT = ConfigDict(strict=True)
_FIVE_LENGTHS: TypeAdapter[list[float]] = TypeAdapter(Annotated[list[_Length], _FIVE], config=_STRICT)
_FIVE_CHANGES: TypeAdapter[list[float]] = TypeAdapter(Annotated[list[_Change], _FIVE], config=_STRICT)


def read_imported(paths: Sequence[Path]) -> pl.DataFrame:
    """Read JSON result files of the paper's reference code."""
    numbers: list[dict[str, Any]] = []
    for path in paths:
        content = _read_json(path)
        entries = list(content.values()) if isinstance(content, dict) else []
        if (
            not entries
            or not all(isinstance(entry, dict) for entry in entries)
            or not any("rCRE" in e for e in entries)
        ):
            raise DataError(
                path,
                "not a results.json of the reference code; give one, a CSV file of results, or a run or record",
            )
        numbers += _reference_numbers(content, path)
    return given_frame(numbers, ", ".join(map(str, paths)))


def _read_json(path: Path) -> Any:
    """Read a JSON file; NaN, which Python's `json.dump` writes, is refused only where the number is used."""
    data = read_bounded(user_path(path), _LARGEST_FILE, "give a results file")
    try:
        return json.loads(data.decode(), object_pairs_hook=_without_repeated)
    except (ValueError, RecursionError) as error:
        raise DataError(path, f"not valid JSON ({plain(str(error))}); give the original file") from error


def _without_repeated(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    repeated = [name for name, count in Counter(name for name, _ in pairs).items() if count > 1]
    if repeated:
        raise ValueError(f"'{plain(repeated[0], 40)}' appears twice")
    return dict(pairs)


def _averaged_over(names: Sequence[str], wanted: Sequence[str]) -> str:
    """Name the corruptions in an average, or those left out if these are fewer."""
    text = f"average over {counted(len(names), 'corruption')}"
    missing, further = [name for name in wanted if name not in names], [name for name in names if name not in wanted]
    if not missing and not further:
        return text
    if not further and len(missing) < len(names):
        return f"{text}, without {', '.join(missing)}"
    return f"{text}: {', '.join(names)}"


def _reference_numbers(content: dict[str, dict[str, Any]], path: Path) -> list[dict[str, Any]]:
    """Return the numbers of a file; the reference code names its folder after the model, the setting and the time.
    Files of one benchmark with the same corruptions form a sample set, because there is only one set of frames."""
    values: dict[tuple[str, str], float] = {}
    for written, entry in content.items():
        if written == CLEAN:
            continue
        if written not in _KNOWN:
            raise DataError(path, f"{unknown_name('corruption', plain(written, 40), _KNOWN)}")
        for of_file, metric in _METRICS.items():
            if of_file in entry:
                five = _FIVE_LENGTHS if MEASURES[metric].bounds[0] == 0 else _FIVE_CHANGES
                severities = _valid(five, entry[of_file], f"{path}, '{written}', {of_file}")
                values[metric, _PAPER_NAMES.get(written, written)] = exact_mean(severities)
    if not values:
        raise DataError(path, "no corruptions, so robustness cannot be measured")
    for written in (CLEAN, *content):  # all of them state the same clean error
        stated = content.get(written, {}).get("clean_EPE")
        if isinstance(stated, list) and stated:
            values["epe", CLEAN] = _valid(TypeAdapter(_Length), stated[0], f"{path}, '{written}', clean_EPE")
            break
    benchmark = "kitti-fc" if any(metric == "epe" for metric, _ in values) else "gopro-fc"
    names = [name for name in PAPER_ORDER if any(corruption == name for _, corruption in values)]
    for metric in _METRICS.values():
        if names and all((metric, name) in values for name in names):
            values[metric, AVERAGE] = exact_mean([values[metric, name] for name in names])
    frames = f"Reference code, {benchmark}, {_averaged_over(names, benchmark_facts(benchmark).paper_corruptions)}"
    model = user_path(path).resolve().parent.name if path.name == "results.json" else path.stem
    head = benchmark, frames, "UNKNOWN", plain(model) or "unnamed"
    shared = dict(zip(LINE, head, strict=True)) | {"note": NOTE, "origin": "results.json of the reference code"}
    return [shared | {"measure": metric, "condition": of, "value": value} for (metric, of), value in values.items()]


def _valid(kind: TypeAdapter[Any], value: Any, where: str) -> Any:
    try:
        return kind.validate_python(value)
    except ValidationError as error:
        raise DataError(plain(where, None), first_misfit(error, "its values")) from None
