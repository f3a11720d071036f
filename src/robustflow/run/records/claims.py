"""Check what a record claims: which rows it contains, what its model was trained on, and that its rows are possible."""

from __future__ import annotations

from itertools import chain

import polars as pl

from ...attacks.registry import CONTROLS
from ...core.errors import DataError, UsageError
from ...core.text import plain
from ...corruptions.registry import CORRUPTIONS
from ...corruptions.stack import levels_of, split_stack
from ...data.benchmarks import benchmark_facts
from ...metrics.rows import CLEAN, ROW_KEY
from ...models.provenance import Training, parse_training_sets, training_of
from ..identity import Provenance
from ..manifest import Manifest
from ..plan import lacking_levels
from .read import Reader
from .row_rules import RULES, broken_rules

_MOST_SHARED = 0.5
"""Largest fraction of a sample's rows whose digest may also occur under a different condition."""


def check_training(reader: Reader) -> str:
    """Check that the setting follows from the training sets; a declaration cannot override a checkpoint's hash."""
    plan = reader.plan
    declared, frames = plan.provenance, plan.identity.frames
    known = training_of(plan.identity.model.settings)
    if known.basis == "undeclared" and declared.basis == "declared":
        known = Training(parse_training_sets("+".join(declared.trained_on or [])), "declared")
    due = Provenance.of(known, frames.benchmark, plan.samples, frames.protocol)
    if declared != due.model_copy(update={"note": declared.note}):
        raise DataError("provenance", f"the manifest states {_text(declared)}; it should be {_text(due)}")
    return plan.judged().provenance.setting


def _text(training: Provenance) -> str:
    sets = "+".join(training.trained_on) if training.trained_on else "unknown data"
    backbone = f", with the backbone {training.backbone}" if training.backbone else ""
    return f"{training.setting} ({training.basis}), trained on {sets}{backbone}"


def check_cells(reader: Reader) -> str:
    """Check that exactly the planned rows exist, that their conditions do, and that their frames can differ."""
    plan, rows = reader.plan, reader.frame
    _check_names(plan)
    _check_severities(plan)
    planned = set(chain.from_iterable(chain(part.corrupted(), part.attacked()) for part in plan.planned))
    present = set(rows.select(ROW_KEY).iter_rows())
    if extra := present - planned:
        raise DataError(_named(min(extra)), f"{len(extra)} rows were not planned, of which this is the first")
    missing = planned - present
    if bool(missing) == reader.facts.complete:
        stated = "complete" if reader.facts.complete else "not complete"
        raise DataError("record.json", f"stated as {stated}, but {len(missing)} of {len(planned)} rows are missing")
    if without := {sample for sample, _, _ in present} - {sample for sample, name, _ in present if name == CLEAN}:
        raise DataError(f"sample '{plain(min(without))}'", "has no row for its clean frames")
    if (rows["frames_digest"].str.strip_chars("0") == "").any():
        raise DataError("frames_digest", "consists of zeros in a row")
    of_sample = rows.group_by("sample").agg(pl.col("frames_digest").is_duplicated().mean().alias("shared"), pl.len())
    several = of_sample.filter(pl.col("len") > 1)
    if 2 * (shared := several.filter(pl.col("shared") > _MOST_SHARED).height) > several.height:
        raise DataError("frames_digest", f"equal under different corruptions in {shared} of {several.height} samples")
    if not plan.identity.measuring.allow_invalid and rows["n_invalid"].sum():
        raise DataError("n_invalid", "the rows count NaN or infinite pixels, which the run did not allow")
    return f"{len(present)} of {len(planned)} planned rows"


def check_measurements(reader: Reader) -> str:
    """Check that no row breaks a rule of `row_rules`."""
    broken = {rule: rows for rule, rows in broken_rules(reader.frame, reader.attacks) if rows.height}
    for rule, rows in broken.items():
        more = f"; {rows.height - 1} more rows, {len(broken) - 1} more rules"
        raise DataError(_named(rows.select(ROW_KEY).row(0)), f"breaks the rule: {rule}{more}")
    return f"{reader.frame.height * len(RULES)} comparisons"


def _named(cell: tuple[str, str, int]) -> str:
    return f"sample '{plain(cell[0])}', {plain(cell[1])} severity {cell[2]}"


def _check_names(plan: Manifest) -> None:
    """Check that corruptions are from this package, an installed package, the identity's list of user-defined
    corruptions, or a benchmark that provides corrupted frames. The attacks, which are known once the manifest is read,
    have to include their random-noise baseline."""
    frames = plan.identity.frames
    known = {*CORRUPTIONS.names(), *frames.corruptions, *benchmark_facts(frames.benchmark).paper_corruptions}
    for name in {**dict.fromkeys(plan.corruptions), **plan.left_out}:
        try:
            fits = all(part in known for part, _ in split_stack(name))
        except UsageError:
            fits = False
        if not fits:
            raise DataError(plain(name, 60), "unknown corruption; install the package that provides it")
    for part in plan.planned:
        levels = {level for of_attack in part.attacks.values() for level in of_attack}
        for control in CONTROLS:
            if not levels <= {*part.attacks.get(control, ())}:
                raise DataError(control, "not among the attacks, but every run with attacks includes it")


def _check_severities(plan: Manifest) -> None:
    """Check that the planned severities exist on the severity scale, and that those left out do not."""
    scale = plan.identity.frames.scale
    for name, levels in (item for part in plan.planned for item in part.corruptions.items()):
        if levels_of(name, levels, scale) != levels:
            raise DataError(plain(name, 60), f"planned at {list(levels)}, some of which the {scale} scale lacks")
    for name, levels in plan.left_out.items():
        if lacking_levels(name, levels, scale) != levels:
            raise DataError(plain(name, 60), f"left out at {list(levels)}, which the {scale} scale has")
