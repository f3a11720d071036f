"""Verify that a record is consistent, as far as possible without the model and the data; state what it is about, and
what no check of the file can prove.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Literal

import polars as pl

from ...attacks.registry import CONTROLS
from ...core.errors import DataError, RobustFlowError, RunError, UsageError
from ...core.paths import user_path
from ...core.text import counted, plain
from ...core.types import Frozen
from ...corruptions.condition import condition_of
from ...corruptions.registry import CORRUPTIONS
from ...data.benchmarks import benchmark_facts
from ...metrics.rows import CLEAN, ROW_KEY
from ...models.provenance import UNDECLARED, Training, parse_training_sets, training_of
from ..manifest import Manifest
from ..run import Run
from .format import Record
from .read import Reader
from .row_rules import cell_in_words

_MOST_SHARED = 0.5
"""Largest fraction of a sample's rows whose digest may also occur under a different condition."""

DataCheck = Callable[[Reader], str]
"""A check of a record, possibly against data, data and a model, or exported files. It returns a one-sentence summary,
and raises if something differs."""


class Subject(Frozen):
    """The model, data and scores of a record."""

    model: str
    benchmark: str
    setting: str
    pairs: int
    epe_clean: float | None
    epe: float | None
    cre: float | None
    crer: float | None
    rcre: float | None
    sentence: str

    @classmethod
    def of(cls, reader: Reader) -> Subject:
        """Return the subject of a verified record."""
        run = reader.open(Run)
        return cls(
            model=plain(run.name),
            benchmark=plain(run.benchmark),
            setting=run.setting,
            pairs=run.measured.samples,
            **{name: getattr(run, name) for name in ("epe_clean", "epe", "cre", "crer", "rcre")},
            sentence=": ".join(str(run).splitlines()[:-1]),  # the last line is its folder
        )


def check_training(reader: Reader) -> str:
    """Check that the training sets are those of the checkpoint's hash, which a declaration cannot override."""
    plan = reader.plan
    declared = plan.training
    known = training_of(plan.identity.model.settings)
    if known == UNDECLARED and declared.basis == "declared":
        known = Training(sets=parse_training_sets("+".join(declared.sets or [])), basis="declared")
    if declared != known.model_copy(update={"note": declared.note}):
        stated, expected = (plain(str(one.model_dump(exclude={"note"})), 200) for one in (declared, known))
        raise DataError("training", f"the manifest states {stated}; it should be {expected}")
    return plan.provenance.setting


def check_cells(reader: Reader) -> str:
    """Check that exactly the planned rows exist, that their conditions do, and that their frames can differ."""
    plan, rows = reader.plan, reader.frame
    _check_conditions(plan)
    part_of = {key: part for part in plan.planned for key in part.samples}
    present = set(rows.select(ROW_KEY).iter_rows())
    if extra := {cell for cell in present if cell[0] not in part_of or not part_of[cell[0]].has(*cell[1:])}:
        raise DataError(cell_in_words(min(extra)), f"not planned, the first of {counted(len(extra), 'row')}")
    planned = sum(part.count() for part in plan.planned)
    missing = planned - len(present)
    if bool(missing) == reader.facts.complete:
        stated = "complete" if reader.facts.complete else "not complete"
        raise DataError("record.json", f"stated as {stated}, but {missing} of {planned} rows are missing")
    if without := {sample for sample, _, _ in present} - {sample for sample, name, _ in present if name == CLEAN}:
        raise DataError(f"sample '{plain(min(without))}'", "has no row for its clean frames")
    of_sample = rows.group_by("sample").agg(pl.col("frames_digest").is_duplicated().mean().alias("shared"), pl.len())
    several = of_sample.filter(pl.col("len") > 1)
    if 2 * (shared := several.filter(pl.col("shared") > _MOST_SHARED).height) > several.height:
        raise DataError("frames_digest", f"equal under different corruptions in {shared} of {several.height} samples")
    if not plan.identity.measuring.allow_invalid and rows["n_invalid"].sum():
        raise DataError("n_invalid", "the rows count NaN or infinite pixels, which the run did not allow")
    return f"{len(present)} of {planned} planned rows"


def _check_conditions(plan: Manifest) -> None:
    """Check that corruptions are from this package, an installed package, the identity's list of user-defined
    corruptions, or a benchmark that provides corrupted frames, that the planned severities exist on the severity scale,
    and that those left out do not. The attacks, which are known once the manifest is read, have to include their
    random-noise baseline."""
    frames = plan.identity.frames
    known = {*CORRUPTIONS.names(), *frames.corruptions, *benchmark_facts(frames.benchmark).paper_corruptions}
    for name in {**dict.fromkeys(plan.corruptions), **plan.left_out}:
        try:
            fits = known.issuperset(condition_of(name).names)
        except UsageError:
            fits = False
        if not fits:
            raise DataError(plain(name, 60), "unknown corruption; install the package that provides it")
    for part in plan.planned:
        attacked = {level for levels in part.attacks.values() for level in levels}
        if missing := [name for name in CONTROLS if not attacked <= {*part.attacks.get(name, ())}]:
            raise DataError(missing[0], "not among the attacks, but every run with attacks includes it")
    planned = [item for part in plan.planned for item in part.corruptions.items()]
    wrong = [name for name, levels in planned if condition_of(name).levels(levels, frames.scale) != levels]
    wrong += [name for name, at in plan.left_out.items() if {*condition_of(name).levels(at, frames.scale)} & {*at}]
    if wrong:
        raise DataError(plain(wrong[0], 60), f"planned, or left out, at wrong severities of the {frames.scale} scale")


CHECKS: dict[str, tuple[str, DataCheck]] = {
    "container": (
        "the file contains exactly the entries of a record",
        lambda reader: f"{len(reader.entries)} entries",
    ),
    "record": ("this version can read the format", lambda reader: f"version {reader.facts.version}"),
    "manifest": (
        "the description of the run is complete, and matches its digest",
        lambda reader: f"run {reader.plan.identity_digest}",
    ),
    "rows": (
        "rows are unique and have the right columns, whose values are in range",
        lambda reader: (
            f"{counted(reader.frame.height, 'row')} of {counted(reader.frame['sample'].n_unique(), 'sample')}"
        ),
    ),
    "training": ("the training sets are those of a known checkpoint, or declared", check_training),
    "cells": ("all rows were planned, and their corruptions are known", check_cells),
}
"""Every check of the file, in order, with a description of what it asserts."""
CHECKS_ON_REQUEST = {
    "frames": "corrupted frames computed locally match the digests in the rows",
    "predictions": "predictions of the local model match the rows",
    "exported": "files exported from the run match the record",
}
_UNPROVEN = {
    "frames": "that the rows were measured on these data: --data FOLDER recomputes the frames of some rows",
    "predictions": "that this model made the predictions: --data FOLDER --model NAME predicts some rows again",
    "attacks": "that the attacks were run on this model: no check repeats them; run them again",
    "training": "what the model was trained on, if that is only declared and not known from a checkpoint's hash",
}


class Check(Frozen):
    """One line of a verification: the name of the check, whether it passed, and a reason or number."""

    name: str
    status: Literal["ok", "failed", "not checked"]
    message: str = ""


class Verification(Frozen):
    """The outcome of the checks of a record; `unproven` is what they cannot show."""

    file: str
    sha256: str
    facts: Record | None
    checks: tuple[Check, ...]
    subject: Subject | None = None
    unproven: tuple[str, ...] = ()

    @property
    def ok(self) -> bool:
        """Return whether every check ran and passed."""
        return all(check.status == "ok" for check in self.checks)

    def first_failure(self) -> str:
        """Describe the first failed check; "" if all passed."""
        return next((f"{check.name}: {check.message}" for check in self.checks if check.status == "failed"), "")


def verify(path: str | Path, **on_request: DataCheck | None) -> Verification:
    """Verify a record file, and compare it with data, predictions or exported files (`CHECKS_ON_REQUEST`). Its contents
    are never executed, written under a name from the file, or trusted before they are checked.
    """
    wanted = {name: check for name in CHECKS_ON_REQUEST if (check := on_request.get(name)) is not None}
    return verify_read(Reader(user_path(path)), wanted)


def verify_read(reader: Reader, on_request: Mapping[str, DataCheck] = MappingProxyType({})) -> Verification:
    """Verify a record up to the first check that fails."""
    checks: list[Check] = []
    for name, check in {**{name: check for name, (_, check) in CHECKS.items()}, **on_request}.items():
        if checks and checks[-1].status != "ok":
            checks.append(Check(name=name, status="not checked"))
            continue
        try:
            checks.append(Check(name=name, status="ok", message=plain(check(reader), 600)))
        except RobustFlowError as error:
            checks.append(Check(name=name, status="failed", message=plain(str(error), 600)))
    ok = checks[-1].status == "ok"
    proven = {*on_request, *(() if ok and reader.attacks else ("attacks",))}
    read = vars(reader)
    return Verification(
        file=reader.name,
        sha256=reader.sha256 if "data" in read else "",
        facts=read.get("facts"),
        checks=tuple(checks),
        subject=Subject.of(reader) if ok else None,
        unproven=tuple(words for name, words in _UNPROVEN.items() if name not in proven),
    )


def verified(reader: Reader) -> Subject:
    """Verify a record and return its subject."""
    verification = verify_read(reader)
    if verification.subject is None:
        raise RunError(
            reader.name,
            f"does not verify: {verification.first_failure()}; for details run: robustflow record verify {reader.name}",
        )
    return verification.subject
