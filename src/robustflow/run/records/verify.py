"""Verify that a record is consistent, as far as possible without the model and the data; state what it is about, and
what no check of the file can prove.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from types import MappingProxyType
from typing import Literal

from ...core.errors import RobustFlowError, RunError
from ...core.paths import user_path
from ...core.text import counted, plain
from ...core.types import Frozen
from ...data.benchmarks.facts import truth_remark
from ..cells import UNEVEN
from ..run import Run
from .claims import check_cells, check_measurements, check_training
from .container import read_file
from .contents import Record
from .read import Reader


class Subject(Frozen):
    """The model, data and scores of a record."""

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

DataCheck = Callable[[Reader], str]
"""A function that compares a record with data, with data and a model, or with exported files. It returns a one-sentence
summary, and raises if something differs."""

_CHECKS: dict[str, DataCheck] = {
    "container": Reader.container,
    "record": Reader.record,
    "hashes": Reader.hashes,
    "manifest": Reader.manifest,
    "rows": Reader.rows,
    "training": check_training,
    "cells": check_cells,
    "measurements": check_measurements,
}


class Check(Frozen):
    """One line of a verification: the name of the check, whether it passed, and a reason or number."""

    name: str
    status: Literal["ok", "failed", "not checked"]
    message: str = ""


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
        others = [Check(name=name, status="not checked") for name in (*_CHECKS, *later)][1:]
        unreadable = Check(name="container", status="failed", message=plain(str(error), 600))
        return Verification(file=str(path), sha256="", facts=None, checks=(unreadable, *others))
    return verify_read(Reader(data, str(path)), later)


def verify_read(reader: Reader, later: Mapping[str, DataCheck] = MappingProxyType({})) -> Verification:
    """Verify a record in memory, up to the first check that fails; those in `later` come last."""
    checks: list[Check] = []
    for name, check in {**_CHECKS, **later}.items():
        if checks and checks[-1].status != "ok":
            checks.append(Check(name=name, status="not checked"))
            continue
        try:
            checks.append(Check(name=name, status="ok", message=plain(check(reader), 600)))
        except RobustFlowError as error:
            checks.append(Check(name=name, status="failed", message=plain(str(error), 600)))
    claims = [
        *(() if "frames" in later else (_UNPROVEN["frames"],)),
        *(() if "predictions" in later else (_UNPROVEN["predictions"],)),
        *((_UNPROVEN["attacks"],) if reader.attacks else ()),
        _UNPROVEN["training"],
    ]
    return Verification(
        file=reader.name,
        sha256=reader.sha256,
        facts=getattr(reader, "facts", None),
        checks=tuple(checks),
        subject=_subject(reader) if checks[-1].status == "ok" else None,
        unproven=tuple(claims),
    )


_UNPROVEN = {
    "frames": "that the rows were measured on these data: --data FOLDER recomputes the frames of some rows",
    "predictions": "that this model made the predictions: --data FOLDER --model NAME predicts some rows again",
    "attacks": "that the attacks were run on this model: no check repeats them; run them again",
    "training": "what the model was trained on, if that is only declared and not known from a checkpoint's hash",
}


def _subject(reader: Reader) -> Subject:
    plan = reader.plan
    with TemporaryDirectory(prefix="robustflow-") as folder:
        reader.extract(Path(folder))
        run = Run(folder)
        return Subject(
            model=plain(run.name),
            benchmark=plain(run.benchmark),
            truth=truth_remark(plan.identity.frames.protocol),
            pairs=run.measured.samples,
            corruptions=len(plan.corruptions),
            severities=len(plan.severities),
            uneven=plan.uneven,
            setting=run.setting,
            **{name: getattr(run, name) for name in ("epe_clean", "epe", "cre", "crer", "rcre")},
        )


def verified(reader: Reader) -> Subject:
    """Verify a record in memory and return its subject."""
    verification = verify_read(reader)
    if verification.subject is None:
        raise RunError(
            reader.name,
            f"does not verify: {verification.first_failure()}; for details run: robustflow record verify {reader.name}",
        )
    return verification.subject
