"""Write a model's flows for RobustSpring in the layout that the server's tool expects."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..core.errors import DataError, ModelError, RunError, UsageError
from ..core.files import digest_of_value, make_folder, read_bounded, write_json
from ..core.types import Flow
from ..data.benchmarks.benchmark import spread
from ..data.datasets.robustspring import CLEAN, ConditionPairs
from ..media.flow import read_flow, write_flow
from ..metrics.error_maps import FL_PIXELS, FL_SHARE, epe_map, magnitude_map
from ..models import ModelRef
from .data_files import file_digests
from .identity import difference
from .plan import NamedModel, load_predictor
from .predict import flows_of
from .run import Run

MODEL_FILE = "model.json"
"""Name of the file in a submission's folder that records the model of its flows."""
_LARGEST = 1 << 20


class Robustness(NamedTuple):
    """The difference between a corrupted and the clean flow, over all pixels, as computed by RobustSpring's server
    (`compute_flow_errors` in springeval/management/commands/evaluation.py of cv-stuttgart/springwebsite at bbfabe8).
    """

    epe: float
    fl: float
    px1: float


@dataclass(frozen=True)
class Submitted:
    condition: str
    key: str
    fresh: bool
    frames: str
    moved: Robustness | None


def model_of(run: Run, ref: ModelRef | None) -> NamedModel:
    if ref is None:
        raise RunError(run.path, "does not record how to load its model; specify --model NAME and its options")
    named = load_predictor(ref)
    recorded = run.manifest.identity.model.settings
    if named.identity != recorded:
        differing = difference(named.identity, recorded)
        raise RunError(run.path, f"the loaded model differs in: {differing}; use the options of the run")
    return named


def condition_pairs(
    root: Path, corruptions: Sequence[str], limit: int | None = None
) -> tuple[dict[str, ConditionPairs], tuple[str, ...]]:
    """Return the conditions of a submission, clean first, and their pairs, which are the same in all."""
    if limit is not None and limit < 1:
        raise UsageError("--limit", f"must be at least 1; got {limit}")
    conditions = {name: ConditionPairs(root, name) for name in dict.fromkeys((CLEAN, *corruptions))}
    keys = spread(conditions[CLEAN].keys(), limit)
    for name, pairs in conditions.items():
        if gone := set(keys) - set(pairs.keys()):
            raise DataError(root, f"{name} lacks the pair {min(gone)}, which {CLEAN} has; unpack the complete archive")
    return conditions, keys


def write_submission(
    run: Run, model: NamedModel, conditions: Mapping[str, ConditionPairs], keys: Sequence[str], folder: Path
) -> Iterator[Submitted]:
    """Write FOLDER/CONDITION/test/0003/flow_FW_left/flow_FW_left_0001.flo5 etc., except existing files."""
    _claim(folder, run.manifest.identity.model.settings)
    for condition, pairs in conditions.items():
        targets = {key: folder / condition / "test" / f"{key}.flo5" for key in keys}
        missing = dict.fromkeys(key for key in keys if not targets[key].exists())
        frames = file_digests({key: pairs.files(key) for key in keys})
        predicted = flows_of(model, pairs, list(missing))
        for key, target in targets.items():
            if key in missing:
                _, flow = next(predicted)
                if not np.isfinite(flow).all():
                    raise ModelError(
                        f"{condition}, '{key}'", "some vectors are not finite; every pixel needs a finite vector"
                    )
                make_folder(target.parent)
                write_flow(target, flow)
            else:
                flow, _ = read_flow(target)
            moved = _flow_change(flow, folder, condition, key)
            yield Submitted(condition, key, key in missing, digest_of_value(frames[key]), moved)


def _claim(folder: Path, settings: dict[str, Any]) -> None:
    """Record in a folder whose flows it contains; raise if it contains flows of a different model."""
    record = folder / MODEL_FILE
    try:
        recorded = json.loads(read_bounded(record, _LARGEST, "restore it")) if record.is_file() else None
    except (DataError, ValueError, RecursionError):
        recorded = None
    if recorded != settings and next(folder.rglob("*.flo5"), None) is not None:
        raise UsageError(folder, "contains flows of a different model; choose another folder with --output")
    make_folder(folder)
    write_json(record, settings)


def _flow_change(flow: Flow, folder: Path, condition: str, key: str) -> Robustness | None:
    if condition == CLEAN:
        return None
    clean, _ = read_flow(folder / CLEAN / "test" / f"{key}.flo5")
    if clean.shape != flow.shape:
        raise UsageError(folder, f"the flows of '{key}' have different sizes; choose an empty folder with --output")
    moved = epe_map(flow, clean)
    outliers = (moved > FL_PIXELS) & (moved > FL_SHARE * magnitude_map(clean))
    return Robustness(float(moved.mean()), 100 * float(outliers.mean()), 100 * float((moved > 1).mean()))
