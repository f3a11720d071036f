"""Import results written by other programs, as lines of results tables.

They are means without the underlying rows, so they cannot be verified; every imported line has the note `NOTE`.

**The paper's reference code** writes benchmark_results/PROJECT/results.json (models/RAFT/benchmark.py and
benchmark_gopro.py of ZhonghuaYi/optical_flow_robustness_benchmark, commit 445880d):

    {"fog": {"CRE": [5 values], "rCRE": [...], "clean_EPE": [...], "corrupt_EPE": [...], "result": "...", ...},
     "clean": {"clean_EPE": [1 value], "CRE": [[]], "CRE_mean": NaN, ...}, ...}

The values are for severities 1 to 5, averaged over pixels and then over images; without ground truth (GoPro-FC),
there is only rCRE. "brightness" is the corruption that the paper calls high light.

**FlowBench** writes outputs/validate/MODEL_CHECKPOINT/2dcc/CORRUPTION/metrics_DATASET.json (flowbench/attacks.py of
shashankskagnihotri/FlowBench, commit 4fb7263):

    {"experiments": [{"model": "raft", "checkpoint": "kitti", "attack": "common_corruptions", "name": "snow",
                      "severity": 3, "dataset": "kitti-2015", "metrics": {"epe": 4.1, ...}, ...},
                     {"model": "raft", "checkpoint": "kitti", "attack": "none", ..., "metrics": {"epe": 0.64}}, ...]}

A later experiment replaces an earlier one with the same settings, as in FlowBench's reader. Attacks, adversarial
weather and 3D corruptions are left out. The corruptions are those of the library imagecorruptions, drawn independently
for the two frames: they share names with this project's but differ from them, so the lines form a separate benchmark.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from math import fsum
from pathlib import Path
from typing import Annotated, Any, Literal

import polars as pl
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, TypeAdapter, ValidationError

from ..core.arguments import SEVERITIES
from ..core.errors import DataError, first_misfit, unknown_name
from ..core.files import read_bounded
from ..core.paths import user_path
from ..core.text import counted, plain
from ..corruptions.registry import PAPER_ORDER
from ..data.benchmarks import benchmark_facts
from ..data.benchmarks.setting import setting_of
from ..data.datasets.released import DISK_NAMES
from ..metrics.rows import CLEAN
from ..models.catalog import PTLFLOW, entries_of
from ..models.provenance import training_of_entry
from .frame import LINE, given_frame
from .results import AVERAGE
from .run_results import OWN_SETTING

NOTE = "imported, not verifiable: no seed, no rows"
"""The note on every imported line."""

FLOWBENCH_DATASETS = {"kitti-2015": "kitti2015", "sintel-clean": "sintel", "sintel-final": "sintel"}
"""FlowBench's name of a dataset -> this project's name."""
_FLOWBENCH_CORRUPTIONS = (
    "gaussian_noise",
    "shot_noise",
    "impulse_noise",
    "defocus_blur",
    "glass_blur",
    "motion_blur",
    "zoom_blur",
    "snow",
    "frost",
    "fog",
    "brightness",
    "contrast",
    "elastic_transform",
    "pixelate",
    "jpeg_compression",
)
"""The corruptions in `common_corruptions_2d` of flowbench/evals.py."""

_LARGEST_FILE = 16 * 2**20
_METRICS = {"corrupt_EPE": "epe", "CRE": "cre", "rCRE": "rcre"}
_PAPER_NAMES = {on_disk: name for name, on_disk in DISK_NAMES.items()}
_KNOWN = (*(DISK_NAMES.get(name, name) for name in PAPER_ORDER), "elastic_transform")


def _as_text(value: Any) -> Any:
    return str(value) if isinstance(value, int) and not isinstance(value, bool) else value


_Text = Annotated[str, BeforeValidator(_as_text), Field(min_length=1)]
_Length = Annotated[float, Field(ge=0, le=1e9, allow_inf_nan=False)]
"""A length in pixels."""
_Change = Annotated[float, Field(ge=-1e9, le=1e9, allow_inf_nan=False)]
_FIVE = Field(min_length=5, max_length=5)
_STRICT = ConfigDict(strict=True)
_FIVE_LENGTHS: TypeAdapter[list[float]] = TypeAdapter(Annotated[list[_Length], _FIVE], config=_STRICT)
_FIVE_CHANGES: TypeAdapter[list[float]] = TypeAdapter(Annotated[list[_Change], _FIVE], config=_STRICT)


class _Foreign(BaseModel):
    """A part of another program's file, whose further fields do not matter."""

    model_config = ConfigDict(strict=True, frozen=True)


class _Metrics(_Foreign):
    epe: _Length


class _Experiment(_Foreign):
    """An experiment of FlowBench on clean frames (without corruption and severity) or on corrupted ones."""

    model: _Text
    checkpoint: _Text
    dataset: Literal[tuple(FLOWBENCH_DATASETS)]  # type: ignore[valid-type]
    name: Literal[_FLOWBENCH_CORRUPTIONS] | None = None  # type: ignore[valid-type]
    severity: Annotated[int, Field(ge=1, le=5)] | None = None
    metrics: _Metrics

    @property
    def condition(self) -> tuple[str, int]:
        """The corruption and the severity."""
        return (CLEAN, 0) if self.name is None or self.severity is None else (self.name, self.severity)


def read_imported(paths: Sequence[Path]) -> pl.DataFrame:
    """Read JSON result files of the paper's reference code and of FlowBench, distinguished by their content."""
    numbers: list[dict[str, Any]] = []
    experiments: list[_Experiment] = []
    for path in paths:
        content = _read_json(path)
        entries = list(content.values()) if isinstance(content, dict) else []
        if entries and all(isinstance(entry, dict) for entry in entries) and any("rCRE" in entry for entry in entries):
            numbers += _reference_numbers(content, path)
        elif isinstance(content, dict) and isinstance(content.get("experiments"), list):
            experiments += _experiments(content["experiments"], path)
        else:
            raise DataError(
                path,
                "neither a results.json of the reference code nor a metrics_DATASET.json of FlowBench; give one of "
                "these, a CSV file of results, or a run's folder or record",
            )
    return given_frame([*numbers, *_flowbench_numbers(experiments)], ", ".join(map(str, paths)))


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
                five = _FIVE_CHANGES if metric == "cre" else _FIVE_LENGTHS
                severities = _valid(five, entry[of_file], f"{path}, '{written}', {of_file}")
                values[metric, _PAPER_NAMES.get(written, written)] = fsum(severities) / len(severities)
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
            values[metric, AVERAGE] = fsum(values[metric, name] for name in names) / len(names)
    frames = f"Reference code, {benchmark}, {_averaged_over(names, benchmark_facts(benchmark).paper_corruptions)}"
    model = user_path(path).resolve().parent.name if path.name == "results.json" else path.stem
    head = benchmark, frames, OWN_SETTING, plain(model) or "unnamed"
    return _rows(head, "results.json of the reference code", values)


def _rows(head: tuple[str, ...], origin: str, values: Mapping[tuple[str, str], float]) -> list[dict[str, Any]]:
    """Return the values of a line as rows of the results frame."""
    shared = dict(zip(LINE, head, strict=True)) | {"note": NOTE, "origin": origin}
    return [shared | {"measure": metric, "condition": of, "value": value} for (metric, of), value in values.items()]


def _valid(kind: TypeAdapter[Any], value: Any, where: str) -> Any:
    try:
        return kind.validate_python(value)
    except ValidationError as error:
        raise DataError(plain(where, None), first_misfit(error, "its values")) from None


def _experiments(entries: list[Any], path: Path) -> Iterator[_Experiment]:
    """Yield the experiments on clean and on corrupted frames in a file."""
    for number, entry in enumerate(entries, 1):
        if not isinstance(entry, dict) or entry.get("attack") in ("none", "common_corruptions"):
            clean = isinstance(entry, dict) and entry["attack"] == "none"
            given = {**entry, "name": None, "severity": None} if clean else entry
            one: _Experiment = _valid(TypeAdapter(_Experiment), given, f"{path}, experiment {number}")
            if not clean and None in (one.name, one.severity):
                raise DataError(f"{path}, experiment {number}", "it has no corruption or no severity")
            yield one


def _flowbench_numbers(experiments: Sequence[_Experiment]) -> Iterator[dict[str, Any]]:
    """Yield the numbers of each model, averaged over the severities that all its corruptions have. Models without
    corrupted frames are left out. CRE is the difference from the clean error over the same images and pixels. Models on
    one dataset under the same corruptions and severities form a sample set."""
    models: dict[tuple[str, str, str], dict[tuple[str, int], float]] = {}
    for one in experiments:
        models.setdefault((one.dataset, one.model, one.checkpoint), {})[one.condition] = one.metrics.epe
    for (dataset, model, checkpoint), errors in models.items():
        names = [name for name in _FLOWBENCH_CORRUPTIONS if any(of == name for of, _ in errors)]
        if not names:
            continue
        shown = plain(f"{model} {checkpoint}", 80)
        levels = [level for level in SEVERITIES if all((name, level) in errors for name in names)]
        if not levels:
            raise DataError(
                f"FlowBench, {shown} on {dataset}",
                "its corruptions have no severity in common, so their means cannot be compared; give only files with "
                "the same severity",
            )
        values = {name: fsum(errors[name, level] for level in levels) / len(levels) for name in names}
        values[AVERAGE] = fsum(values.values()) / len(names)
        given = {("epe", name): value for name, value in values.items()}
        if (clean := errors.get((CLEAN, 0))) is not None:
            given["epe", CLEAN] = clean
            given |= {("cre", name): value - clean for name, value in values.items()}
        averaged = _averaged_over(names, _FLOWBENCH_CORRUPTIONS)
        frames = f"FlowBench, {dataset}, severity {', '.join(map(str, levels))}, {averaged}"
        head = f"FlowBench {dataset}", frames, _setting(dataset, model, checkpoint), shown
        yield from _rows(head, "FlowBench metrics files", given)


def _setting(dataset: str, model: str, checkpoint: str) -> str:
    """Return the setting of the checkpoint with this name from the catalogue; FlowBench uses ptlflow's models."""
    for entry in entries_of(f"{PTLFLOW}{model}"):
        if entry.checkpoint == checkpoint:
            return setting_of(training_of_entry(entry), FLOWBENCH_DATASETS[dataset])
    return OWN_SETTING
