"""Describe imported lines: the note on each of them, and the corruptions in an average. Read JSON files from other
programs, with a size limit and checks for repeated names and invalid numbers. Read the image-corruption results
in FlowBench's `metrics_DATASET.json`.

These files are written by `attack` in flowbench/attacks.py of the public repository shashankskagnihotri/FlowBench,
commit 4fb7263, to outputs/validate/MODEL_CHECKPOINT/2dcc/CORRUPTION/metrics_DATASET.json. Older files, with all results
in one file, are in the repository under outputs/validate:

    {"experiments": [{"model": "raft", "checkpoint": "kitti", "attack": "common_corruptions", "name": "snow",
                      "severity": 3, "targeted": false, "dataset": "kitti-2015", "metrics": {"epe": 4.1, ...}, ...},
                     {"model": "raft", "checkpoint": "kitti", "attack": "none", ..., "metrics": {"epe": 0.64}}, ...]}

A later experiment replaces an earlier one with the same settings, as in FlowBench's reader (flowbench/utils.py).
Attacks, adversarial weather and 3D corruptions are left out. `epe` is a mean over images, in pixels. The corruptions
are those of the library imagecorruptions, drawn independently for the two frames of a pair. They share names with this
project's corruptions but differ from them, so the lines form a separate benchmark.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import fsum
from pathlib import Path
from typing import Any

from ...core.arguments import SEVERITIES
from ...core.errors import DataError
from ...core.files import read_bounded
from ...core.paths import user_path
from ...core.text import counted, plain
from ...data.benchmarks.setting import setting_of
from ...metrics.rows import CLEAN
from ...models.catalog import PTLFLOW, entries_of
from ...models.provenance import training_of_entry
from ..model_result import ModelResult, Value
from ..results import AVERAGE
from ..run_results import OWN_SETTING

NOTE = "imported, not verifiable: no seed, no rows"
"""The note on every imported line."""


def averaged_over(names: Sequence[str], wanted: Sequence[str]) -> str:
    """Name the corruptions in an average, or those left out if these are fewer."""
    text = f"average over {counted(len(names), 'corruption')}"
    missing, further = [name for name in wanted if name not in names], [name for name in names if name not in wanted]
    if not missing and not further:
        return text
    if not further and len(missing) < len(names):
        return f"{text}, without {', '.join(missing)}"
    return f"{text}: {', '.join(names)}"


_LARGEST_FILE = 16 * 2**20
_LARGEST_NUMBER = 1e9


def read_json_file(path: Path) -> Any:
    """Read a JSON file. NaN, which Python's `json.dump` can write, is accepted here and rejected where the number is
    used.
    """
    data = read_bounded(user_path(path), _LARGEST_FILE, "give a results file")
    try:
        return json.loads(data.decode(), object_pairs_hook=_dict_without_duplicates)
    except (ValueError, RecursionError) as error:
        raise DataError(f"{path} is not valid JSON ({plain(str(error))}); give the original file") from error


def finite_number(value: Any, where: str, *, signed: bool = False) -> float:
    """Return a finite number: a length in pixels or, if `signed`, a difference of lengths.

    >>> finite_number(2, "r.json, fog"), finite_number(-0.5, "r.json, fog", signed=True)
    (2.0, -0.5)
    """
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise DataError(where, f"{plain(repr(value), 40)} is not a number")
    if not abs(value) <= _LARGEST_NUMBER:  # comparisons with NaN are false
        raise DataError(where, f"{plain(repr(value), 40)} is not a finite number of pixels")
    if value < 0 and not signed:
        raise DataError(where, f"{float(value):g}: a length in pixels cannot be negative")
    return float(value)


def _dict_without_duplicates(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    duplicates = [name for name, count in Counter(name for name, _ in pairs).items() if count > 1]
    if duplicates:
        raise ValueError(f"'{plain(duplicates[0], 40)}' appears twice")
    return dict(pairs)


FLOWBENCH_CORRUPTIONS = (
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

FLOWBENCH_DATASETS = {"kitti-2015": "kitti2015", "sintel-clean": "sintel", "sintel-final": "sintel"}
"""FlowBench's name of a dataset -> this project's name."""

_SOURCE = "FlowBench metrics files"
_ATTACK, _NONE = "common_corruptions", "none"


@dataclass(frozen=True)
class Experiment:
    """One experiment in a file."""

    model: str
    checkpoint: str
    dataset: str
    corruption: str
    severity: int
    epe: float


def is_flowbench(content: Any) -> bool:
    """Whether a file's content has the structure of a FlowBench file.

    >>> is_flowbench({"experiments": []}), is_flowbench({"fog": {"rCRE": [1, 2, 3, 4, 5]}})
    (True, False)
    """
    return isinstance(content, dict) and isinstance(content.get("experiments"), list)


def parse(content: dict[str, Any], path: Path) -> list[Experiment]:
    """Return the experiments on clean and on corrupted frames in a file."""
    experiments = []
    for index, entry in enumerate(content["experiments"], 1):
        where = f"{path}, experiment {index}"
        if not isinstance(entry, dict):
            raise DataError(where, "not an object")
        if entry.get("attack") in (_ATTACK, _NONE):
            experiments.append(_experiment(entry, where))
    return experiments


def lines(experiments: Sequence[Experiment]) -> Iterator[ModelResult]:
    """Yield a line for each model, averaged over the severities that all of the model's corruptions have. Models
    without corrupted frames are left out. CRE is the difference from the clean error over the same images and
    pixels. Models on one dataset under the same corruptions and severities form a sample set.
    """
    models: dict[tuple[str, str, str], dict[tuple[str, int], float]] = {}
    for one in experiments:
        models.setdefault((one.dataset, one.model, one.checkpoint), {})[one.corruption, one.severity] = one.epe
    for (dataset, model, checkpoint), errors in models.items():
        names = [name for name in FLOWBENCH_CORRUPTIONS if any(of == name for of, _ in errors)]
        if not names:
            continue
        levels = [level for level in SEVERITIES if all((name, level) in errors for name in names)]
        if not levels:
            raise DataError(
                f"FlowBench, {model} {checkpoint} on {dataset}: its corruptions have no severity in common, so their "
                "means cannot be compared; give only files with the same severity"
            )
        values = {name: fsum(errors[name, level] for level in levels) / len(levels) for name in names}
        values[AVERAGE] = fsum(values.values()) / len(names)
        clean = errors.get((CLEAN, 0))
        conditions = f"severity {', '.join(map(str, levels))}, {averaged_over(names, FLOWBENCH_CORRUPTIONS)}"
        given = {("epe", name): value for name, value in values.items()}
        if clean is not None:
            given["epe", CLEAN] = clean
            given |= {("cre", name): value - clean for name, value in values.items()}
        yield ModelResult(
            *(f"FlowBench {dataset}", f"FlowBench, {dataset}, {conditions}"),
            *(_setting(dataset, model, checkpoint), f"{model} {checkpoint}", NOTE),
            {key: Value(value, source=_SOURCE) for key, value in given.items()},
        )


def _experiment(entry: dict[str, Any], where: str) -> Experiment:
    dataset = entry.get("dataset")
    if dataset not in tuple(FLOWBENCH_DATASETS):
        raise DataError(
            where, f"unknown dataset '{plain(str(dataset), 40)}'; known datasets: {', '.join(FLOWBENCH_DATASETS)}"
        )
    corruption: Any = CLEAN
    severity: Any = 0
    if entry["attack"] == _ATTACK:
        corruption, severity = entry.get("name"), entry.get("severity")
        if corruption not in FLOWBENCH_CORRUPTIONS:
            known = ", ".join(FLOWBENCH_CORRUPTIONS)
            raise DataError(where, f"unknown corruption '{plain(str(corruption), 40)}'; FlowBench has {known}")
        if isinstance(severity, bool) or severity not in SEVERITIES:
            raise DataError(where, f"severity {plain(repr(severity), 40)}; expected 1 to 5")
    metrics, *names = (entry.get(part) for part in ("metrics", "model", "checkpoint"))
    if not isinstance(metrics, dict) or "epe" not in metrics:
        raise DataError(where, "'epe' is missing from its metrics")
    if not all(isinstance(name, str | int) and not isinstance(name, bool) and str(name) for name in names):
        raise DataError(where, "the model or the checkpoint is missing")
    model, checkpoint = (plain(str(name), 40) for name in names)
    epe = finite_number(metrics["epe"], f"{where}, epe")
    return Experiment(model, checkpoint, dataset, corruption, int(severity), epe)


def _setting(dataset: str, model: str, checkpoint: str) -> str:
    """Return the setting of the checkpoint with this name from the catalogue; FlowBench uses ptlflow's models."""
    for entry in entries_of(f"{PTLFLOW}{model}"):
        if entry.checkpoint == checkpoint:
            return setting_of(training_of_entry(entry), FLOWBENCH_DATASETS[dataset])
    return OWN_SETTING
