"""Experiment: does training with corruptions make flow estimation robust, including to corruptions not used in
training?

For each seed, `tiny` is trained from random weights without corruptions until it can match pixels; each arm then
continues the training with its corruptions. Every network is evaluated as soon as it is trained, on held-out flying
shapes and on real pairs. Completed training and evaluation runs are not repeated.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from filelock import FileLock, Timeout

from ...api import evaluate
from ...core.errors import RunError, UsageError
from ...core.files import make_folder
from ...core.paths import user_path
from ...data.datasets import dataset_facts, load_dataset
from ...models import ModelSpec
from ...run.run import Run
from ...training.checkpoint import LAST, read_progress
from ...training.recipe import Recipe, load_recipe
from ...training.request import Checkpoints, DataPlan, Request
from ...training.session import run_training
from .effects import Arm, Runs, arms, measured
from .findings import DATASET

METHOD, START, STAGE = "tiny", "small", "small_robust"
"""The network, the recipe for training from random weights, and the recipe of the arms."""
_COMPLETE = "complete"
"""File that marks the training run in its folder as complete."""
_SEED_OF_ARMS = 1000
"""Offset added to the seed of the arms, so that they do not repeat the random draws of the initial training."""
_SAVE_EVERY = 20
"""Number of updates between checkpoints, and thus the maximum number lost if the process is killed."""
_POLL_S = 5.0
_BATCH = 8
"""Number of pairs predicted in one batch."""


@dataclass(frozen=True)
class EvaluationSet:
    """A set of pairs on which every network is evaluated."""

    dataset: str
    data: Path | None = None
    options: tuple[tuple[str, str | int], ...] = ()


@dataclass(frozen=True)
class TrainingExperiment:
    """The settings of the experiment."""

    output: Path
    evaluation_sets: tuple[EvaluationSet, ...]
    seeds: int = 6
    steps: int | None = None
    severities: tuple[int, ...] = (3,)
    loaders: int = 1

    def training(self, seed: int, name: str) -> Path:
        """Return the folder of a training run: "start", or an arm's folder."""
        return self.output / "trainings" / f"seed-{seed}" / name


def evaluation_sets(data: Sequence[str], shapes: int, size: str) -> tuple[EvaluationSet, ...]:
    """Return the held-out flying shapes, followed by the dataset for each NAME=FOLDER."""
    load_dataset(DATASET, size=size)  # otherwise a wrong size would be noticed only after the first training
    sets = [EvaluationSet(DATASET, options=(("pairs", shapes), ("size", size), ("split", "test")))]
    for entry in data:
        name, equals, folder = entry.partition("=")
        if not equals:
            raise UsageError("--data", f"{entry}: specify the dataset as NAME=FOLDER, for example kitti2015={entry}")
        if [other.partition("=")[0] for other in data].count(name) > 1:
            raise UsageError(
                "--data", f"{entry}: {name} is given twice; an experiment evaluates one folder per dataset"
            )
        if not load_dataset(name, folder).has_flow:
            raise UsageError(
                "--data",
                f"{entry}: {dataset_facts(name).title} has no ground truth; choose a dataset with ground truth",
            )
        sets.append(EvaluationSet(name, user_path(folder).resolve()))
    return tuple(sets)


def run_experiment(
    experiment: TrainingExperiment, say: Callable[[str], None], stop: Callable[[], bool] = lambda: False
) -> Runs | None:
    """Train and evaluate the missing networks, completing all arms of one seed before starting the next seed."""
    runs: dict[tuple[str, str, int], Run] = {}
    todo = [(seed, arm) for seed in range(experiment.seeds) for arm in arms()]
    total = len(todo)
    while todo:
        for seed, arm in todo:
            if stop():
                return None
            start = _initial_weights(experiment, seed, say, stop)
            with claimed(experiment.training(seed, arm.name)) as mine:
                if start is None or not mine:
                    continue
                say(f"{1 + seed * len(arms()) + arms().index(arm)} of {total}: seed {seed}, {arm.name}")
                checkpoint = _trained(experiment, seed, arm, start, stop)
                if checkpoint is None:
                    return None
                for one in experiment.evaluation_sets:
                    runs[arm.name, one.dataset, seed] = _measured(experiment, arm, seed, checkpoint, one)
            todo.remove((seed, arm))
            break  # continue with the first missing network, which may no longer be claimed
        else:
            time.sleep(_POLL_S)
    return runs


@contextmanager
def claimed(folder: Path) -> Iterator[bool]:
    """Lock a folder within the block; yield whether this process holds the lock."""
    make_folder(folder)
    lock = FileLock(folder / ".claim", fallback_to_soft=False)  # released when the process is killed
    try:
        lock.acquire(blocking=False)
    except Timeout:
        yield False
        return
    try:
        yield True
    finally:
        lock.release()


def _initial_weights(
    experiment: TrainingExperiment, seed: int, say: Callable[[str], None], stop: Callable[[], bool]
) -> Path | None:
    """Return the initial weights of a seed's arms; None if training was stopped or a different process is training
    them."""
    folder = experiment.training(seed, "start")
    if (folder / _COMPLETE).exists():
        return _trained(experiment, seed, None, None, stop)
    with claimed(folder) as mine:
        if not mine:
            return None
        say(f"seed {seed}: training from random weights")
        return _trained(experiment, seed, None, None, stop)


def _trained(
    experiment: TrainingExperiment, seed: int, arm: Arm | None, start: Path | None, stop: Callable[[], bool]
) -> Path | None:
    """Return the weights of an arm, or the initial weights of all arms if no arm is given; None if the training was
    stopped."""
    folder = experiment.training(seed, "start" if arm is None else arm.name)
    recipe = load_recipe(METHOD, START if arm is None else STAGE).changed(steps=experiment.steps)
    resume = (folder / LAST).exists()
    if resume:
        _check_same(experiment, recipe, folder / LAST)
    if (folder / _COMPLETE).exists():
        return folder / LAST
    request = Request(
        recipe=recipe,
        data=DataPlan(corruptions=[] if arm is None else arm.corruptions, loaders=experiment.loaders),
        output=folder,
        start=None if start is None else str(start),
        start_trained_on=None if start is None else "FS:train",
        resume=resume,
        seed=seed if arm is None else seed + _SEED_OF_ARMS,
        device="auto",
        checkpoints=Checkpoints(_SAVE_EVERY),
    )
    checkpoint = run_training(request, stop)
    if stop():
        return None
    (folder / _COMPLETE).touch()
    return checkpoint


def _check_same(experiment: TrainingExperiment, recipe: Recipe, checkpoint: Path) -> None:
    _, about = read_progress(checkpoint)
    if about.identity.get("recipe") != recipe.digest():
        raise RunError(
            experiment.output,
            "contains an experiment with different --steps; use the same --steps, or a different --output",
        )


def _measured(
    experiment: TrainingExperiment, arm: Arm, seed: int, checkpoint: Path, evaluation_set: EvaluationSet
) -> Run:
    return evaluate(
        ModelSpec(METHOD, (("checkpoint", str(checkpoint)),)),
        evaluation_set.dataset,
        evaluation_set.data,
        experiment.output / "runs" / evaluation_set.dataset / f"seed-{seed}" / arm.name,
        corruptions=measured(),
        severities=experiment.severities,
        data_options=dict(evaluation_set.options) or None,
        name=f"{METHOD} {arm.name} {seed}",
        engine="serial",
        batch_size=_BATCH,
    )
