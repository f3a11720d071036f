"""Group the runs of one model that differ only in the seed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import polars as pl

from ..core.files import digest_of_value
from ..core.text import joined
from ..metrics.rows import CLEAN
from ..run.comparable import common_cells, measured_cells, omitted_rows, run_names, sample_set, sample_set_of
from ..run.run import Run


@dataclass(frozen=True)
class BySeed:
    """The rows of one model by seed, with the same cells, clean frames and ground truth; `remark` describes what was
    left out."""

    rows: Mapping[int, pl.DataFrame]
    remark: str


@dataclass(frozen=True)
class SeedGroup:
    """A group of runs that differ only in the seed."""

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


def seeds_of(runs: Sequence[Run]) -> BySeed | None:
    """Group runs of one model whose frames differ only in the seed; None if the runs differ in anything else."""
    seeds = [run.manifest.identity.frames.seed for run in runs]
    every = [run.rows for run in runs]
    rows = common_cells(every)
    clean = [sample_set_of("", measured_cells(one.filter(corruption=CLEAN))) for one in rows]
    if any(len(set(each)) > 1 for each in (list(map(_settings, runs)), clean)) or len(set(seeds)) < len(runs):
        return None
    return BySeed(dict(zip(seeds, rows, strict=True)), omitted_rows(every, rows, run_names(runs)))


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


def _settings(run: Run) -> tuple[str, str]:
    """Identify the model and everything except the seed that affects the frames."""
    recipe = run.manifest.identity.frames.record()
    del recipe["seed"]
    return digest_of_value(run.manifest.identity.model.record()), digest_of_value(recipe)
