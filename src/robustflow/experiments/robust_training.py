"""Does training with corruptions make flow robust, also against corruptions not used in training?

From one set of weights, training of `tiny` is continued with each arm's corruptions, once for each seed, and every
result is measured on held-out flying shapes and on real pairs. A complete training or run is not repeated.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from ..api import evaluate
from ..atomic import make_folder
from ..corruptions import IMAGE_PAIR
from ..datasets import dataset_facts, load_dataset
from ..errors import RunError, UsageError
from ..models import ModelSpec
from ..models.model_file import opened
from ..runs.run import Run
from ..training.checkpoint import LAST, read_progress
from ..training.recipe import Recipe, load_recipe
from ..training.session import Request, run_training
from .arms import Arm, arms

METHOD, STAGE = "tiny", "robust"
SHAPES = "shapes"


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
        start: weights that every arm starts from: a file of `train tiny`.
        evaluation_sets: to measure every network on.
        seeds: how many, from 0: of order, augmentation and corruption of the training.
        steps: of each training; None for the recipe's.
        severities: those to measure.
        loaders: processes that prepare batches in advance.
    """

    output: Path
    start: str
    evaluation_sets: tuple[EvaluationSet, ...]
    seeds: int = 3
    steps: int | None = None
    severities: tuple[int, ...] = (3,)
    loaders: int = 1


def evaluation_sets(data: Sequence[str], shapes: int, size: str) -> tuple[EvaluationSet, ...]:
    """Held-out flying shapes, and each NAME=FOLDER.

    Raises:
        UsageError: not NAME=FOLDER, a name that no data set has, or one without ground truth.
        DataError: another layout.
    """
    sets = [EvaluationSet(SHAPES, options=(("pairs", shapes), ("size", size), ("split", "test")))]
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
) -> dict[tuple[str, str, int], Run] | None:
    """Train and measure what is still missing.

    Args:
        experiment: what to train and measure.
        say: called with messages about the progress.
        stop: called after each update; True ends there, and a later call continues.

    Returns:
        Runs by (arm, data set, seed); None if it was stopped.

    Raises:
        RunError: the folder holds trainings from another start or with other steps.
        UsageError, DataError, ModelError, RunError: see `run_training` and `evaluate`.
    """
    make_folder(experiment.output)
    runs: dict[tuple[str, str, int], Run] = {}
    todo = [(seed, arm) for seed in range(experiment.seeds) for arm in arms()]
    for number, (seed, arm) in enumerate(todo, 1):
        say(f"{number} of {len(todo)}: seed {seed}, {arm.name}")
        checkpoint = _trained(experiment, arm, seed, stop)
        if checkpoint is None:
            return None
        for evaluation_set in experiment.evaluation_sets:
            runs[arm.name, evaluation_set.dataset, seed] = _measured(experiment, arm, seed, checkpoint, evaluation_set)
    return runs


def _trained(experiment: TrainingExperiment, arm: Arm, seed: int, stop: Callable[[], bool]) -> Path | None:
    """The weights of an arm; None if its training was stopped."""
    folder = experiment.output / "trainings" / f"seed-{seed}" / arm.name
    done = folder / "complete"
    recipe = load_recipe(METHOD, STAGE).changed(steps=experiment.steps)
    if (folder / LAST).exists():
        _check_same(experiment, recipe, folder / LAST)
    if done.exists():
        return folder / LAST
    request = Request(
        recipe=recipe,
        data=[],
        output=folder,
        start=experiment.start,
        start_trained_on="FS",
        resume=(folder / LAST).exists(),
        seed=seed,
        device="auto",
        loaders=experiment.loaders,
        corrupt=arm.corruptions,
    )
    checkpoint = run_training(request, stop)
    if stop():
        return None
    done.touch()
    return checkpoint


def _check_same(experiment: TrainingExperiment, recipe: Recipe, checkpoint: Path) -> None:
    with opened(Path(experiment.start)) as (_, start):
        asked = {"--init": start, "--steps": recipe.digest()}
    _, about = read_progress(checkpoint)
    held = {"--init": about.identity.get("start"), "--steps": about.identity.get("recipe")}
    differing = " and ".join(option for option in asked if asked[option] != held[option])
    if differing:
        raise RunError(
            f"{experiment.output} holds an experiment with another {differing}; give what it was begun with, or "
            "another --output"
        )


def _measured(
    experiment: TrainingExperiment, arm: Arm, seed: int, checkpoint: Path, evaluation_set: EvaluationSet
) -> Run:
    return evaluate(
        ModelSpec(METHOD, (("checkpoint", str(checkpoint)),)),
        evaluation_set.dataset,
        evaluation_set.data,
        experiment.output / "runs" / evaluation_set.dataset / f"seed-{seed}" / arm.name,
        corruptions=IMAGE_PAIR,
        severities=experiment.severities,
        data_options=dict(evaluation_set.options) or None,
        name=f"{METHOD} {arm.name} {seed}",
    )
