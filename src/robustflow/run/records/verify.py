"""Verify that a record is consistent, as far as possible without the model and the data; state what it is about, and
what no check of the file can prove.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from types import MappingProxyType
from typing import TYPE_CHECKING, Literal

from ...core.errors import RobustFlowError, RunError
from ...core.paths import user_path
from ...core.text import counted, plain
from ...core.types import Frozen
from ...data.benchmarks.facts import truth_remark
from ..cells import UNEVEN
from ..run import Run
from .claims import cell_problems, training_problems
from .container import read_file
from .contents import Record
from .read import STEPS, Reader
from .row_rules import row_problems

if TYPE_CHECKING:
    from ..manifest import Manifest


class Subject(Frozen):
    """The model, data and scores of a record. Scores are recomputed from the rows, never read from the stored means."""

    model: str
    benchmark: str
    truth: str = ""
    pairs: int
    corruptions: int
    severities: int
    uneven: bool = False
    setting: str
    epe_clean: float | None
    epe: float | None
    cre: float | None
    crer: float | None
    rcre: float | None

    def sentence(self) -> str:
        """Return all fields in one line."""
        named = {"clean EPE": self.epe_clean, "EPE": self.epe, "CRE": self.cre, "CREr": self.crer, "RCRE": self.rcre}
        scores = ", ".join(f"{name} {value:.2f}" for name, value in named.items() if value is not None)
        on = f"{self.benchmark}, {self.truth}" if self.truth else self.benchmark
        pairs, corruptions = counted(self.pairs, "pair"), counted(self.corruptions, "corruption")
        extent = f"{pairs} x {corruptions} x {counted(self.severities, 'severity', 'severities')}"
        extent += f" ({UNEVEN})" if self.uneven else ""
        return f"{self.model} on {on} ({self.setting}), {extent}: {scores or 'nothing could be measured'}"


def subject_of(run: Run, plan: Manifest) -> Subject:
    """Return the subject of a record whose rows and plan were checked."""
    return Subject(
        model=plain(run.name),
        benchmark=plain(run.benchmark),
        truth=truth_remark(plan.identity.frames.protocol),
        pairs=run.measured.samples,
        corruptions=len(plan.corruptions),
        severities=len(plan.severities),
        uneven=plan.uneven,
        setting=run.setting,
        epe_clean=run.epe_clean,
        epe=run.epe,
        cre=run.cre,
        crer=run.crer,
        rcre=run.rcre,
    )


def unproven(frames_compared: bool, predictions_compared: bool, attacked: bool) -> list[str]:
    """Return the unproven claims as sentences; each names a way to prove the claim."""
    out = []
    if not frames_compared:
        out.append("that the rows were measured on these data: --data FOLDER recomputes the frames of some rows")
    if not predictions_compared:
        out.append("that this model made the predictions: --data FOLDER --model NAME predicts some rows again")
    if attacked:
        out.append("that the attacks were run on this model: no check repeats them; run them again")
    out.append("what the model was trained on, if that is only declared and not known from a checkpoint's hash")
    return out


VERIFICATION_CHECKS = {
    "container": "the file contains exactly the entries of a record",
    "record": "this version can read the format",
    "hashes": "every entry matches its SHA-256",
    "manifest": "the description of the run is complete, and matches its digest",
    "rows": "rows have the right columns and are unique, finite and in range",
    "training": "the setting matches the training sets",
    "cells": "all rows were planned, and their corruptions are known",
    "measurements": "rows are plausible and consistent with each other",
    "frames": "corrupted frames computed locally match the digests in the rows",
    "predictions": "predictions of the local model match the rows",
    "exported": "files exported from the run match the record",
}
"""Every check, in order, with a description of what it asserts."""

_ON_REQUEST = ("frames", "predictions", "exported")
_SHOWN = 3
_Outcome = tuple[Literal["ok", "failed"], str]


class Check(Frozen):
    """One line of a verification: the name of the check, whether it passed, and a reason or number."""

    name: str
    status: Literal["ok", "failed", "not checked"]
    message: str


class Verification(Frozen):
    """The outcome of the checks of a record."""

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


DataCheck = Callable[[Reader], str]
"""A function that compares a record with data, with data and a model, or with exported files. It returns a one-sentence
summary, and raises if something differs."""


def verify(
    path: str | Path,
    *,
    frames: DataCheck | None = None,
    predictions: DataCheck | None = None,
    exported: DataCheck | None = None,
) -> Verification:
    """Verify a record file. Its contents are never executed, written under a name from the file, or trusted before they
    are checked.
    """
    given = zip(_ON_REQUEST, (frames, predictions, exported), strict=True)
    later = {name: compare for name, compare in given if compare is not None}
    try:
        data = read_file(user_path(path))
    except RobustFlowError as error:
        checks = _checks({"container": ("failed", str(error))}, later)
        return Verification(file=str(path), sha256="", facts=None, checks=checks)
    return verify_read(Reader(data, str(path)), later)


def verified(reader: Reader) -> Subject:
    """Verify a record in memory and return its subject."""
    verification = verify_read(reader)
    if not verification.ok or verification.subject is None:
        raise RunError(
            reader.name,
            f"does not verify: {verification.first_failure()}; for details run: robustflow record verify {reader.name}",
        )
    return verification.subject


def verify_read(reader: Reader, later: Mapping[str, DataCheck] = MappingProxyType({})) -> Verification:
    """Verify a record in memory. If all other checks pass, the comparisons in `later` are made, in order."""
    outcomes: dict[str, _Outcome] = {}
    subject = None
    try:
        for step in STEPS:
            outcomes[step] = ("failed", "")
            outcomes[step] = ("ok", getattr(reader, step)())
    except RobustFlowError as error:
        outcomes[step] = ("failed", str(error))
    else:
        claims, subject = _check_claims(reader)
        outcomes |= claims
    for name, compare in later.items():
        if any(status == "failed" for status, _ in outcomes.values()):
            break
        try:
            outcomes[name] = ("ok", compare(reader))
        except RobustFlowError as error:
            outcomes[name] = ("failed", str(error))
    return Verification(
        file=reader.name,
        sha256=reader.sha256,
        facts=getattr(reader, "facts", None),
        checks=_checks(outcomes, later),
        subject=subject,
        unproven=tuple(unproven("frames" in later, "predictions" in later, bool(reader.attacks))),
    )


def _check_claims(reader: Reader) -> tuple[dict[str, _Outcome], Subject | None]:
    """Check a record's claims; return the results by check, and its subject if everything could be read."""
    problems = training_problems(reader.plan)
    out = {"training": _outcome(problems, reader.plan.judged().provenance.setting)}
    with TemporaryDirectory(prefix="robustflow-") as folder:
        reader.extract(Path(folder))
        run = Run(folder)
        problems, message = cell_problems(run, reader)
        out["cells"] = _outcome(problems, message)
        if problems:
            return out, None  # sums over unplanned cells are meaningless
        problems, count = row_problems(run)
        out["measurements"] = _outcome(problems, f"{count} comparisons")
        try:
            return out, subject_of(run, reader.plan)
        except RobustFlowError as error:
            return out | {"measurements": ("failed", str(error))}, None


def _outcome(problems: list[str], message: str) -> _Outcome:
    more = len(problems) - _SHOWN
    listed = "; ".join(problems[:_SHOWN]) + (f"; and {more} more" if more > 0 else "")
    return ("failed", listed) if problems else ("ok", message)


def _checks(outcomes: dict[str, _Outcome], later: Collection[str]) -> tuple[Check, ...]:
    return tuple(
        Check(name=check, status=outcomes[check][0], message=plain(outcomes[check][1], 600))
        if check in outcomes
        else Check(name=check, status="not checked", message="")
        for check in VERIFICATION_CHECKS
        if check not in _ON_REQUEST or check in later
    )
