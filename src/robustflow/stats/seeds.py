"""Group the runs of one model that differ only in the seed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import mean, stdev

import polars as pl

from ..core.files import digest_of_value
from ..core.text import joined
from ..metrics.rows import CLEAN
from ..run.comparable import common_cells, measured_cells, omitted_rows, run_names, sample_set_of
from ..run.run import Run


@dataclass(frozen=True)
class BySeed:
    """The rows of one model by seed, with the same cells, clean frames and ground truth; `remark` describes what was
    left out."""

    rows: Mapping[int, pl.DataFrame]
    remark: str


def seeds_of(runs: Sequence[Run]) -> BySeed | None:
    """Group runs of one model whose frames differ only in the seed; None if the runs differ in anything else."""
    seeds = [run.manifest.identity.frames.seed for run in runs]
    every = [run.rows for run in runs]
    rows = common_cells(every)
    clean = [sample_set_of("", measured_cells(one.filter(corruption=CLEAN))) for one in rows]
    if any(len(set(each)) > 1 for each in (list(map(_settings, runs)), clean)) or len(set(seeds)) < len(runs):
        return None
    return BySeed(dict(zip(seeds, rows, strict=True)), omitted_rows(every, rows, run_names(runs)))


def seed_groups(runs: Sequence[Run]) -> dict[str, list[Run]]:
    """Find the groups of runs that differ only in the seed and have all rows in common, by the name of their model."""
    alike: dict[tuple[str, str], list[Run]] = {}
    for run in runs:
        alike.setdefault(_settings(run), []).append(run)
    members = list(alike.values())
    names = run_names([group[0] for group in members])
    known = {name: seeds_of(group) if len(group) > 1 else None for name, group in zip(names, members, strict=True)}
    return {
        name: group
        for (name, by_seed), group in zip(known.items(), members, strict=True)
        if by_seed is not None and not by_seed.remark
    }


def with_seeds(frame: pl.DataFrame, runs: Sequence[Run]) -> pl.DataFrame:
    """Add a line for each group of runs that differ only in the seed, after the last of them: the means over the seeds
    of what all of them have, with their standard `deviation`. Runs of one group in different settings have none."""
    for name, group in seed_groups(runs).items():
        of_group = pl.col("origin").is_in([run.manifest.identity_digest for run in group])
        members = frame.filter(of_group & pl.col("against").is_null()).group_by(
            *("benchmark", "setting", "measure", "condition", "severity"), maintain_order=True
        )
        each = members.agg(
            pl.col("sample_set", "excluded", "pairs", "origin").last(),
            *("value", pl.col("decimals").first()),
        ).filter(pl.col("value").list.len() == len(group))
        if each.is_empty():
            continue
        values = each["value"].to_list()
        seeds = joined([str(run.manifest.identity.frames.seed) for run in group])
        means = each.with_columns(
            model=pl.lit(f"{name}, {len(group)} seeds"),
            source=pl.lit("seeds"),
            note=pl.lit(f"mean ± standard deviation over the seeds {seeds}"),
            value=pl.Series(map(mean, values), dtype=pl.Float64),
            deviation=pl.Series(map(stdev, values), dtype=pl.Float64),
        )
        last = 1 + (frame["origin"] == group[-1].manifest.identity_digest).arg_true().max()  # type: ignore[operator]
        frame = pl.concat([frame[:last], means, frame[last:]], how="diagonal")
    return frame


def _settings(run: Run) -> tuple[str, str]:
    """Identify the model and everything except the seed that affects the frames."""
    recipe = run.manifest.identity.frames.record()
    del recipe["seed"]
    return digest_of_value(run.manifest.identity.model.record()), digest_of_value(recipe)
