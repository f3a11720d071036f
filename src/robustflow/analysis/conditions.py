"""Group runs for comparison: one model with several seeds, or several models under several conditions."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import reduce

import polars as pl

from ..digest import digest_of_value
from ..errors import RunError
from ..metrics.rows import CLEAN, ROW_KEY
from ..runs.aggregate import summarize
from ..runs.comparable import (
    SELECTION,
    differences,
    differing_parts,
    measured_cells,
    measured_in_words,
    sample_set,
    sample_set_of,
)
from ..runs.run import Run
from ..text import joined, plain
from .exclusion import exclusion_reasons
from .run_names import named_runs, run_names


@dataclass(frozen=True)
class BySeed:
    """The rows of one model by seed, with the same cells, clean frames and ground truth; `remark` describes what was
    left out."""

    rows: Mapping[int, pl.DataFrame]
    remark: str


@dataclass(frozen=True)
class SeedGroup:
    """A group of runs that differ only in the seed.

    Attributes:
        name: unique name of the model, including what distinguishes it from other models with the same name.
        seeds: seeds in the order of the runs.
        runs: (sample set, name) of each run, with the name from `run_names`.
    """

    name: str
    seeds: tuple[int, ...]
    runs: tuple[tuple[str, str], ...]

    @property
    def label(self) -> str:
        """The heading for the group's means, for example "DIS, 3 seeds"."""
        return f"{self.name}, {len(self.seeds)} seeds"

    @property
    def note(self) -> str:
        """A note that explains the group's numbers."""
        return f"mean ± standard deviation over the seeds {joined(list(map(str, self.seeds)))}"


@dataclass(frozen=True)
class Orders:
    """Scores by condition and model. All models in a condition are scored on the same rows, and all conditions on the
    same cells if they have any in common. `remark` describes what was left out."""

    scores: Mapping[str, Mapping[str, float]]
    remark: str


def seeds_of(runs: Sequence[Run]) -> BySeed | None:
    """Group runs of one model whose frames differ only in the seed; None if the runs differ in anything else."""
    seeds = [run.manifest.identity.frames.seed for run in runs]
    rows, remark = _common_rows(runs)
    clean = [sample_set_of("", measured_cells(one.filter(corruption=CLEAN))) for one in rows]
    if any(len(set(each)) > 1 for each in (list(map(_settings, runs)), clean)) or len(set(seeds)) < len(runs):
        return None
    return BySeed(dict(zip(seeds, rows, strict=True)), remark)


def seed_groups(runs: Sequence[Run]) -> list[SeedGroup]:
    """Find the groups of runs that differ only in the seed and have all rows in common."""
    alike: dict[tuple[str, str], list[int]] = {}
    for index, run in enumerate(runs):
        alike.setdefault(_settings(run), []).append(index)
    members = list(alike.values())
    known = [seeds_of([runs[index] for index in one]) if len(one) > 1 else None for one in members]
    names, models = run_names(runs), run_names([runs[one[0]] for one in members])
    return [
        SeedGroup(model, tuple(by_seed.rows), tuple((sample_set(runs[index]), names[index]) for index in one))
        for one, model, by_seed in zip(members, models, known, strict=True)
        if by_seed is not None and not by_seed.remark
    ]


def orders(runs: Sequence[Run], metric: str) -> Orders | None:
    """Compute the scores of several models under several conditions; None unless at least two models were run under at
    least two conditions.

    Runs that measured the same rows belong to one condition. Two presets or checkpoints of a model count as two models.

    Args:
        runs: runs of any models.
        metric: "epe", "cre", "crer" or "rcre".

    Raises:
        RunError: if fewer than two of the models can be ranked.
    """
    rows, remark = _common_rows(runs)
    parts = [dict(one) for one in measured_in_words(runs)]
    if any((one["corruption"] != CLEAN).any() for one in rows):
        parts = [{name: words for name, words in one.items() if name not in SELECTION} for one in parts]
    else:
        rows, remark = [run.rows for run in runs], ""
    keys = [sample_set_of("", measured_cells(one)) for one in rows]
    conditions = _named(parts, keys)
    models = _model_names(runs)
    scores: dict[str, dict[str, float]] = {condition: {} for condition in conditions.values()}
    why: dict[str, str] = {}
    for run, one, key in zip(runs, rows, keys, strict=True):
        value = getattr(summarize(one), metric)
        if value is not None:
            of_condition = scores[conditions[key]]
            name = models[_model(run)]
            repeats = sum(known == name or known.startswith(f"{name} #") for known in of_condition)
            name = f"{name} #{repeats + 1}" if repeats else name
            of_condition[name] = value
            if reasons := exclusion_reasons(run):
                why[name] = reasons[0]
    everywhere = set.intersection(*map(set, scores.values()))
    if len(scores) < 2 or len(everywhere) < 2:
        return None
    unranked = "; ".join(f"{plain(name)}, because {why[name]}" for name in sorted(everywhere & why.keys()))
    if len(everywhere - why.keys()) < 2:
        raise RunError(
            f"a ranking needs at least two models that can be ranked; not ranked: {unranked}; add runs of other models"
        )
    if unranked:
        remark = " ".join(filter(None, (remark, f"Not ranked: {unranked}.")))
        everywhere -= why.keys()
        scores = {key: {name: one[name] for name in one if name not in why} for key, one in scores.items()}
    if others := sorted({name for one in scores.values() for name in one} - everywhere):
        remark = " ".join(filter(None, (remark, f"Left out (not run under every condition): {joined(others)}.")))
    return Orders(scores, remark)


def _settings(run: Run) -> tuple[str, str]:
    """Identify the model and everything except the seed that affects the frames."""
    recipe = run.manifest.identity.frames.record()
    del recipe["seed"]
    return _model(run), digest_of_value(recipe)


def _model(run: Run) -> str:
    return digest_of_value(run.manifest.identity.model.record())


def _model_names(runs: Sequence[Run]) -> dict[str, str]:
    first = {_model(run): run for run in reversed(runs)}
    return dict(zip(first, named_runs(list(first.values())), strict=True))


def _common_rows(runs: Sequence[Run]) -> tuple[list[pl.DataFrame], str]:
    """Select the rows for the (sample, corruption, severity) cells that all runs have in common, and describe in a
    remark what was left out."""
    keys = list(ROW_KEY)
    shared = reduce(lambda one, other: one.join(other, on=keys, how="semi"), (run.rows.select(keys) for run in runs))
    if all(run.rows.height == shared.height for run in runs):
        return [run.rows for run in runs], ""
    remark = f"Only the {shared.height} rows (clean or corrupted pairs) that all runs have in common are compared"
    words = differences(named_runs(runs), SELECTION)
    return [run.rows.join(shared, on=keys, how="semi") for run in runs], f"{remark}: {words}."


def _named(parts: Sequence[Mapping[str, str]], keys: Sequence[str]) -> dict[str, str]:
    """Name each condition after what its runs share and the runs of other conditions lack."""
    shared: dict[str, dict[str, str]] = {}
    for one, key in zip(parts, keys, strict=True):
        known = shared.setdefault(key, dict(one))
        shared[key] = {name: words for name, words in known.items() if one.get(name) == words}
    differing = differing_parts(list(shared.values()))
    names = {key: ", ".join(one[part] for part in differing if part in one) for key, one in shared.items()}
    count = Counter(names.values())
    return {
        key: name if name and count[name] == 1 else ", ".join(filter(None, (name, f"frames {key[:6]}")))
        for key, name in names.items()
    }
