"""Does training with corruptions make flow robust, also against corruptions not used in training?

For each seed `tiny` is trained from random weights, without corruptions, until it can match; from there each arm
continues with its corruptions. Every network is measured as soon as it is trained, on held-out flying shapes and on
real pairs. A complete training or run is not repeated.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from filelock import FileLock, Timeout

from ..api import evaluate
from ..atomic import make_folder
from ..datasets import dataset_facts, load_dataset
from ..errors import RunError, UsageError
from ..models import ModelSpec
from ..runs.run import Run
from ..training.checkpoint import LAST, read_progress
from ..training.recipe import Recipe, load_recipe
from ..training.request import Checkpoints, DataPlan, Request
from ..training.session import run_training
from .arms import Arm, arms, measured
from .effects import Runs
from .hypotheses import DATASET

METHOD, START, STAGE = "tiny", "small", "small_robust"
"""The network, and the recipes of its training from random weights and of the arms'."""
_COMPLETE = "complete"
"""File in the folder of a training that has made all of its updates."""
_SEED_OF_ARMS = 1000
"""Added to a seed for the arms, so that their draws are not those of the first training again."""
_SAVE_EVERY = 20
"""Updates that a kill can cost."""
_POLL_S = 5.0
_BATCH = 8
"""Pairs of frames predicted together."""


@dataclass(frozen=True)
class EvaluationSet:
    """A set of pairs that every network is measured on.

    Attributes:
        dataset: its registered name.
        data: its folder; None for flying shapes.
        options: of the data set.
    """

    dataset: str
    data: Path | None = None
    options: tuple[tuple[str, str | int], ...] = ()


@dataclass(frozen=True)
class TrainingExperiment:
    """The experiment.

    Attributes:
        output: folder of everything it writes.
        evaluation_sets: to measure every network on.
        seeds: how many, from 0: of the initial weights, and of order, augmentation and corruption of the training.
        steps: of each training; None for the recipes'.
        severities: those to measure.
        loaders: processes that prepare batches in advance.
    """

    output: Path
    evaluation_sets: tuple[EvaluationSet, ...]
    seeds: int = 6
    steps: int | None = None
    severities: tuple[int, ...] = (3,)
    loaders: int = 1

    def training(self, seed: int, name: str) -> Path:
        """The folder of a training: "start", or that of an arm."""
        return self.output / "trainings" / f"seed-{seed}" / name


def evaluation_sets(data: Sequence[str], shapes: int, size: str) -> tuple[EvaluationSet, ...]:
    """Held-out flying shapes, and each NAME=FOLDER.

    Raises:
        UsageError: not NAME=FOLDER, a name that no data set has, or one without ground truth.
        DataError: another layout.
    """
    sets = [EvaluationSet(DATASET, options=(("pairs", shapes), ("size", size), ("split", "test")))]
    for entry in data:
        name, equals, folder = entry.partition("=")
        if not equals:
            raise UsageError(f"--data {entry}: say which data set it is: NAME=FOLDER, for example kitti2015={entry}")
        if not load_dataset(name, folder).has_flow:
            raise UsageError(
                f"--data {entry}: {dataset_facts(name).title} has no ground truth; give pairs with ground truth"
            )
        sets.append(EvaluationSet(name, Path(folder).expanduser().resolve()))
    return tuple(sets)


def run_experiment(
    experiment: TrainingExperiment, say: Callable[[str], None], stop: Callable[[], bool] = lambda: False
) -> Runs | None:
    """Train and measure what is still missing, all arms of a seed before the next seed.

    Several processes can share a folder: each takes the next network that no other works on, and at the end waits for
    the others.

    Args:
        experiment: what to train and measure.
        say: called with messages about the progress.
        stop: called after each update; True ends there, and a later call continues.

    Returns:
        Runs by (arm, data set, seed); None if it was stopped.

    Raises:
        RunError: the folder holds trainings with other steps.
        UsageError, DataError, ModelError, RunError: see `run_training` and `evaluate`.
    """
    runs: dict[tuple[str, str, int], Run] = {}
    todo = [(seed, arm) for seed in range(experiment.seeds) for arm in arms()]
    total = len(todo)
    while todo:
        for seed, arm in todo:
            if stop():
                return None
            start = _started(experiment, seed, say, stop)
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
            break  # the next one is the first that is missing, which may be free by now
        else:
            time.sleep(_POLL_S)
    return runs


@contextmanager
def claimed(folder: Path) -> Iterator[bool]:
    """Whether this process is the only one that works in a folder, until the block ends."""
    make_folder(folder)
    lock = FileLock(folder / ".lock", fallback_to_soft=False)  # released by the system when a process is killed
    try:
        lock.acquire(blocking=False)
    except Timeout:
        yield False
        return
    try:
        yield True
    finally:
        lock.release()


def _started(
    experiment: TrainingExperiment, seed: int, say: Callable[[str], None], stop: Callable[[], bool]
) -> Path | None:
    """The weights that the arms of a seed start from; None while another process trains them, or if it was stopped."""
    folder = experiment.training(seed, "start")
    if (folder / _COMPLETE).exists():
        return _trained(experiment, seed, None, None, stop)
    with claimed(folder) as mine:
        if not mine:
            return None
        say(f"seed {seed}: from random weights")
        return _trained(experiment, seed, None, None, stop)


def _trained(
    experiment: TrainingExperiment, seed: int, arm: Arm | None, start: Path | None, stop: Callable[[], bool]
) -> Path | None:
    """The weights of an arm, or without one those that the arms start from; None if the training was stopped."""
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
        start_trained_on=None if start is None else "FS",
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
            f"{experiment.output} holds an experiment with different --steps; give those it was started with, or a "
            "different --output"
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
