"""`metrics_DATASET.json` of FlowBench, as far as it is about image corruptions.

Written by `attack` in flowbench/attacks.py of the public repository shashankskagnihotri/FlowBench, commit 4fb7263, to
outputs/validate/MODEL_CHECKPOINT/2dcc/CORRUPTION/metrics_DATASET.json; older ones, with everything in one file, are in
the repository under outputs/validate:

    {"experiments": [{"model": "raft", "checkpoint": "kitti", "attack": "common_corruptions", "name": "snow",
                      "severity": 3, "targeted": false, "dataset": "kitti-2015", "metrics": {"epe": 4.1, ...}, ...},
                     {"model": "raft", "checkpoint": "kitti", "attack": "none", ..., "metrics": {"epe": 0.64}}, ...]}

A later experiment replaces an equal earlier one, as its own reader (flowbench/utils.py) has it. Attacks, adversarial
weather and 3D corruptions are other questions and are left out. `epe` is a mean over images, in pixels. The
corruptions are those of the library imagecorruptions, drawn for each frame of a pair apart: they have names in common
with this project's and are other corruptions, so the lines form a separate benchmark.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import fsum
from pathlib import Path
from typing import Any

from ...benchmarks.setting import setting_of
from ...errors import DataError
from ...metrics.rows import CLEAN
from ...models.catalog import PTLFLOW, entries_of
from ...models.provenance import training_of_entry
from ...severity import SEVERITIES
from ...text import plain
from ..model_result import ModelResult, Value
from ..results import AVERAGE
from ..run_results import OWN_SETTING
from .averaged import averaged_over
from .json_file import finite_number

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
"""`common_corruptions_2d` of flowbench/evals.py."""

FLOWBENCH_DATASETS = {"kitti-2015": "kitti2015", "sintel-clean": "sintel", "sintel-final": "sintel"}
"""What it evaluates on -> the data set as this project calls it."""

_SOURCE = "metrics files of FlowBench"
_ATTACK, _NONE = "common_corruptions", "none"


@dataclass(frozen=True)
class Experiment:
    """One experiment of a file.

    Attributes:
        model, checkpoint, dataset: as FlowBench calls them.
        corruption: one of `FLOWBENCH_CORRUPTIONS`, or "clean".
        severity: 1 to 5; 0 of clean frames.
        epe: mean over images, pixels.
    """

    model: str
    checkpoint: str
    dataset: str
    corruption: str
    severity: int
    epe: float


def is_flowbench(content: Any) -> bool:
    """Whether a file's content has the shape of these.

    >>> is_flowbench({"experiments": []}), is_flowbench({"fog": {"rCRE": [1, 2, 3, 4, 5]}})
    (True, False)
    """
    return isinstance(content, dict) and isinstance(content.get("experiments"), list)


def parse(content: dict[str, Any], path: Path) -> list[Experiment]:
    """The experiments of a file on clean and on corrupted frames.

    Raises:
        DataError: an unknown corruption or data set, a severity outside 1 to 5, an error that is not a finite number.
    """
    experiments = []
    for index, entry in enumerate(content["experiments"], 1):
        where = f"{path}, experiment {index}"
        if not isinstance(entry, dict):
            raise DataError(f"{where}: not an object")
        if entry.get("attack") in (_ATTACK, _NONE):
            experiments.append(_experiment(entry, where))
    return experiments


def lines(experiments: Sequence[Experiment], note: str) -> Iterator[ModelResult]:
    """A line for each model. A model's means are over the severities that all of its corruptions have; one
    without a corrupted frame is left out. CRE is the difference from the clean error, which is over the same images and
    pixels. Models on one data set under the same corruptions and severities are one sample set.

    Raises:
        DataError: a model whose corruptions have no severity in common.
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
                "means are of different things; give the files of one severity"
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
            *(_setting(dataset, model, checkpoint), f"{model} {checkpoint}", note),
            {key: Value(value, source=_SOURCE) for key, value in given.items()},
        )


def _experiment(entry: dict[str, Any], where: str) -> Experiment:
    dataset = entry.get("dataset")
    if dataset not in tuple(FLOWBENCH_DATASETS):
        raise DataError(
            f"{where}: unknown data set '{plain(str(dataset), 40)}'; known: {', '.join(FLOWBENCH_DATASETS)}"
        )
    corruption: Any = CLEAN
    severity: Any = 0
    if entry["attack"] == _ATTACK:
        corruption, severity = entry.get("name"), entry.get("severity")
        if corruption not in FLOWBENCH_CORRUPTIONS:
            known = ", ".join(FLOWBENCH_CORRUPTIONS)
            raise DataError(f"{where}: unknown corruption '{plain(str(corruption), 40)}'; FlowBench has {known}")
        if isinstance(severity, bool) or severity not in SEVERITIES:
            raise DataError(f"{where}: severity {plain(repr(severity), 40)}; there are 1 to 5")
    metrics = entry.get("metrics")
    if not isinstance(metrics, dict) or "epe" not in metrics:
        raise DataError(f"{where}: no 'epe' among its metrics")
    names = [entry.get(part) for part in ("model", "checkpoint")]
    if not all(isinstance(name, str) and name for name in names):
        raise DataError(f"{where}: no model and checkpoint in it")
    model, checkpoint = (plain(str(name), 40) for name in names)
    return Experiment(
        model, checkpoint, dataset, corruption, int(severity), finite_number(metrics["epe"], f"{where}, epe")
    )


def _setting(dataset: str, model: str, checkpoint: str) -> str:
    """What the catalogue says about the checkpoint of this name: FlowBench takes its models from ptlflow."""
    for entry in entries_of(f"{PTLFLOW}{model}"):
        if entry.checkpoint == checkpoint:
            return setting_of(training_of_entry(entry), FLOWBENCH_DATASETS[dataset])
    return OWN_SETTING
