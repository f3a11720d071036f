"""Flows of a model on RobustSpring, in the layout that its server's tool takes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..atomic import make_folder
from ..benchmarks.base import spread
from ..datasets.robustspring_condition import CLEAN, DIRECTIONS, Condition
from ..digest import digest_of_value
from ..errors import DataError, ModelError, RunError, UsageError
from ..flowio import read_flow, write_flow
from ..metrics.outliers import FL_PIXELS, FL_SHARE
from ..models import ModelSpec
from ..models.base import AnyModel, FlowLookup
from ..runs.file_digests import file_digests
from ..runs.identity import differing_fields
from ..runs.run import Run
from ..sample import Flow
from .named_model import name_model
from .predict import flows_of


@dataclass(frozen=True)
class ConditionPairs:
    """The pairs of one condition in one direction.

    Attributes:
        condition: "clean" or a corruption of RobustSpring.
        pairs: its frames.
        keys: which of them.
    """

    condition: str
    pairs: Condition
    keys: tuple[str, ...]


class Robustness(NamedTuple):
    """How a corrupted flow differs from the clean one, over all pixels, as RobustSpring's server computes it
    (`compute_flow_errors` in springeval/management/commands/evaluation.py of cv-stuttgart/springwebsite at bbfabe8).

    Attributes:
        epe: mean distance, pixels: what RobustSpring calls R_EPE and this project RCRE.
        fl: pixels that moved by more than 3 px and more than 5 % of the clean flow's length, percent.
        px1: pixels that moved by more than 1 px, percent.
    """

    epe: float
    fl: float
    px1: float


@dataclass(frozen=True)
class Submitted:
    """One flow that is there.

    Attributes:
        condition: "clean" or a corruption of RobustSpring.
        key: of the pair.
        fresh: whether it was predicted now, and not by an earlier call.
        frames: the digest of the files of its two frames.
        moved: how it differs from the pair's clean flow; None of the clean flow itself.
    """

    condition: str
    key: str
    fresh: bool
    frames: str
    moved: Robustness | None


def model_of(run: Run, spec: ModelSpec | None) -> AnyModel:
    """The model of a run, loaded again.

    Raises:
        RunError: it was a Python object, or the model loaded now is not the run's.
        UsageError: the run has flows from files, which say nothing of other frames.
        ModelError: it cannot be loaded.
    """
    if spec is None:
        raise RunError(f"{run.path} does not say how its model is loaded; give --model NAME, and its options")
    named = name_model(spec)
    if isinstance(named.model, FlowLookup):
        raise UsageError("a folder of flow files predicts nothing on other frames; name a model")
    recorded = run.manifest.identity.model.settings
    if named.identity != recorded:
        raise RunError(
            f"the model that is loaded now is not the one of {run.path} (it differs in: "
            f"{differing_fields(named.identity, recorded)}); give the options that the run was given"
        )
    return named.model


def condition_pairs(root: Path, corruptions: Sequence[str], limit: int | None = None) -> list[ConditionPairs]:
    """What a submission consists of, the clean frames first; every condition has the same pairs.

    Args:
        root: of RobustSpring's frames.
        corruptions: which; the clean frames come in any case.
        limit: use only so many pairs, spread evenly, to try it.

    Raises:
        UsageError: an unknown corruption, a limit below 1.
        DataError: frames that are not there.
    """
    if limit is not None and limit < 1:
        raise UsageError(f"limit {limit} leaves no pairs: give 1 or more")
    clean = {direction: Condition(root, CLEAN, direction) for direction in DIRECTIONS}
    wanted = {*spread(sorted(key for pairs in clean.values() for key in pairs.keys()), limit)}  # noqa: SIM118
    conditions = []
    for condition in dict.fromkeys((CLEAN, *corruptions)):
        for direction in DIRECTIONS:
            pairs = clean[direction] if condition == CLEAN else Condition(root, condition, direction)
            keys = [key for key in clean[direction].keys() if key in wanted]  # noqa: SIM118
            if gone := set(keys) - set(pairs.keys()):
                raise DataError(f"{root}: {condition} lacks the pair {min(gone)}, which {CLEAN} has; unpack it whole")
            conditions.append(ConditionPairs(condition, pairs, tuple(keys)))
    return conditions


def write_submission(model: AnyModel, conditions: Sequence[ConditionPairs], folder: Path) -> Iterator[Submitted]:
    """Predict FOLDER/CONDITION/test/0003/flow_FW_left/flow_FW_left_0001.flo5 and so on; flows that are there stay.

    Args:
        model: from `model_of`.
        conditions: from `condition_pairs`.
        folder: made where it is not there.

    Yields:
        Each flow, when its file is whole.

    Raises:
        UsageError: flows of another size are there.
        DataError: a frame cannot be read, or a file cannot be written.
        ModelError: the model does not answer with a flow at every pixel.
    """
    for each in conditions:
        targets = {key: folder / each.condition / "test" / f"{key}.flo5" for key in each.keys}
        written = {key for key in each.keys if targets[key].exists()}
        frames = file_digests({key: each.pairs.files(key) for key in each.keys})
        for key in sorted(written, key=each.keys.index):
            moved = _moved(read_flow(targets[key])[0], folder, each.condition, key)
            yield Submitted(each.condition, key, False, digest_of_value(frames[key]), moved)
        for key, flow in flows_of(model, each.pairs, [key for key in each.keys if key not in written]):
            if not np.isfinite(flow).all():
                raise ModelError(
                    f"{each.condition}, '{key}': some vectors are not finite; a submission needs one at every pixel"
                )
            make_folder(targets[key].parent)
            write_flow(targets[key], flow)
            moved = _moved(flow, folder, each.condition, key)
            yield Submitted(each.condition, key, True, digest_of_value(frames[key]), moved)


def _moved(flow: Flow, folder: Path, condition: str, key: str) -> Robustness | None:
    if condition == CLEAN:
        return None
    clean, _ = read_flow(folder / CLEAN / "test" / f"{key}.flo5")
    if clean.shape != flow.shape:
        raise UsageError(f"{folder}: the flows of '{key}' are of different sizes; choose an empty folder with --output")
    moved, length = (
        np.linalg.norm(each, axis=2) for each in (flow.astype(np.float64) - clean, clean.astype(np.float64))
    )
    outliers = (moved > FL_PIXELS) & (moved > FL_SHARE * length)
    return Robustness(float(moved.mean()), 100 * float(outliers.mean()), 100 * float((moved > 1).mean()))
