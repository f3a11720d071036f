"""Check a record's claims beyond the numbers: which rows it contains, and what its model was trained on."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import polars as pl

from ...attacks.registry import CONTROLS
from ...core.errors import UsageError
from ...core.text import plain
from ...corruptions.registry import CORRUPTIONS
from ...corruptions.stack import levels_of, split_stack
from ...data.benchmarks import benchmark_facts
from ...metrics.rows import CLEAN, ROW_KEY
from ...models.provenance import Training, parse_training_sets, training_of
from ..identity import Provenance
from ..manifest import Manifest
from ..plan import lacking_levels

_MOST_SHARED = 0.5
"""Largest fraction of a sample's rows whose digest may also occur under a different condition."""

if TYPE_CHECKING:
    from ..run import Run
    from .read import Reader


def cell_problems(run: Run, reader: Reader) -> tuple[list[str], str]:
    """Return the problems found (unknown corruptions, unplanned or missing rows, ...) and a summary."""
    plan = reader.plan
    problems = _unknown_corruptions({**dict.fromkeys(plan.corruptions), **plan.left_out}, plan)
    problems = problems or [*_severity_problems(plan), *_attack_problems(plan)]
    if problems:
        return problems, ""
    planned, present = set(run.planned()), set(reader.frame.select(ROW_KEY).iter_rows())
    planned |= {cell for part in plan.planned for cell in part.attacked()}
    extra, missing = present - planned, planned - present
    if extra:
        sample, corruption, severity = min(extra)
        where = f"sample '{plain(sample)}', {plain(corruption)} severity {severity}"
        problems.append(f"{len(extra)} rows were not planned; the first one is for {where}")
    if bool(missing) == reader.facts.complete:
        stated = "complete" if reader.facts.complete else "not complete"
        problems.append(f"stated as {stated}, but {len(missing)} of {len(planned)} rows are missing")
    without = {sample for sample, _, _ in present} - {sample for sample, name, _ in present if name == CLEAN}
    if without:
        problems.append(f"sample '{plain(min(without))}' has no row for its clean frames")
    problems += _digest_problems(reader.frame)
    if not plan.identity.measuring.allow_invalid and reader.frame["n_invalid"].sum():
        problems.append("the rows count NaN or infinite pixels, which the run did not allow")
    return problems, f"{len(present)} of {len(planned)} planned rows"


def _digest_problems(rows: pl.DataFrame) -> list[str]:
    """Find implausible frame digests."""
    if (rows["frames_digest"].str.strip_chars("0") == "").any():
        return ["a frames_digest consists of zeros"]
    of_sample = rows.group_by("sample").agg(pl.col("frames_digest").is_duplicated().mean().alias("shared"), pl.len())
    several = of_sample.filter(pl.col("len") > 1)
    shared = several.filter(pl.col("shared") > _MOST_SHARED).height
    if 2 * shared > several.height:
        return [f"{shared} of {of_sample.height} samples have the same frames_digest under different corruptions"]
    return []


def training_problems(plan: Manifest) -> list[str]:
    """Check that the setting (OOD, ID, LEAKED, ...) follows from the declared or catalogued training sets. A user's
    declaration is accepted, but cannot override the catalogue entry of a checkpoint's hash.
    """
    declared, frames = plan.provenance, plan.identity.frames
    known = training_of(plan.identity.model.settings)
    if known.basis == "undeclared" and declared.basis == "declared":
        try:
            known = Training(parse_training_sets("+".join(declared.trained_on or [])), "declared")
        except UsageError as error:
            return [f"the declared training sets cannot be read: {plain(str(error), 120)}"]
    due = Provenance.of(known, frames.benchmark, plan.samples, frames.protocol)
    if declared != due.model_copy(update={"note": declared.note}):
        return [f"the manifest states {_text(declared)}; for this model and benchmark, it should be {_text(due)}"]
    return []


def _text(training: Provenance) -> str:
    sets = "+".join(training.trained_on) if training.trained_on else "unknown data"
    backbone = f", with the backbone {training.backbone}" if training.backbone else ""
    return f"{training.setting} ({training.basis}), trained on {sets}{backbone}"


def _unknown_corruptions(names: Iterable[str], plan: Manifest) -> list[str]:
    """Find corruption names that are not from this package, an installed package, the identity's list of
    user-defined corruptions, or a benchmark that provides corrupted frames."""
    frames = plan.identity.frames
    of_benchmark = benchmark_facts(frames.benchmark).paper_corruptions
    known, out = {*CORRUPTIONS.names(), *frames.corruptions, *of_benchmark}, []
    for name in names:
        try:
            fits = all(part in known for part, _ in split_stack(name))
        except UsageError:
            fits = False
        if not fits:
            out.append(f"corruption '{plain(name, 60)}' is unknown; install the package that provides it")
    return out


def _attack_problems(plan: Manifest) -> list[str]:
    """Check that every attack was planned together with the random-noise baseline. Unknown attacks are already
    rejected when the manifest is read."""
    for part in plan.planned:
        levels = {level for of_attack in part.attacks.values() for level in of_attack}
        if any(not levels <= {*part.attacks.get(control, ())} for control in CONTROLS):
            return [f"the attacks lack {' or '.join(CONTROLS)}, which every run with attacks includes"]
    return []


def _severity_problems(plan: Manifest) -> list[str]:
    """Check that the planned severities exist on the severity scale, and that those left out do not."""
    scale = plan.identity.frames.scale
    for name, levels in (item for part in plan.planned for item in part.corruptions.items()):
        if levels_of(name, levels, scale) != levels:
            return [f"{plain(name, 60)} is planned at severities {list(levels)}, some of which the {scale} scale lacks"]
    for name, levels in plan.left_out.items():
        if lacking_levels(name, levels, scale) != levels:
            return [f"{plain(name, 60)} was left out at severities {list(levels)}, which the {scale} scale has"]
    return []
