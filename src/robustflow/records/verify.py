"""Whether a record holds together: everything that can be checked without the model and the data."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal

from pydantic import BaseModel, ConfigDict

from ..analysis.audit.run_folder import audit_run
from ..errors import RobustFlowError
from ..runs.run import Run
from ..text import plain
from .container import read_file
from .contents import Record
from .read import STEPS, Reader
from .truths import cell_problems, training_problems

CHECKS = {
    "container": "a plain file of a record's entries, nothing else in it",
    "record": "its format is read by this version",
    "hashes": "every entry has its SHA-256",
    "manifest": "what ran is complete, and its digest follows from it",
    "rows": "rows have the right columns, each once, finite, in range",
    "training": "the setting follows from the training sets",
    "cells": "rows are those that were planned, under known corruptions",
    "measurements": "rows are possible measurements, and fit each other",
    "summary": "means follow from the rows",
    "frames": "corrupted frames made here are those the rows were made from",
}
"""Each check, in order, and what it holds to be true."""

_SHOWN = 3
_Told = tuple[Literal["ok", "failed"], str]


class Check(BaseModel):
    """One line of a verification: what was checked, whether it holds, and a reason or figure in one line."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: str
    status: Literal["ok", "failed", "not checked"]
    says: str


class Verification(BaseModel):
    """What the checks of a record said.

    Attributes:
        file: the path, as given.
        sha256: of the file, by which a record can be cited; "" where it could not be read.
        facts: `record.json` with author, link and description, nobody's but the submitter's words; None where it could
            not be read.
        checks: in the order of `CHECKS`; "frames" only where data were given.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    file: str
    sha256: str
    facts: Record | None
    checks: tuple[Check, ...]

    @property
    def ok(self) -> bool:
        """Whether every check was made and holds."""
        return all(check.status == "ok" for check in self.checks)

    def first_failure(self) -> str:
        """The first check that does not hold, in words; "" where all do."""
        return next((f"{check.name}: {check.says}" for check in self.checks if check.status == "failed"), "")


def verify(path: str | Path, *, frames: Callable[[Reader], str] | None = None) -> Verification:
    """Check a record file. Nothing in it is run, written under its own name, or believed before it is checked.

    Args:
        path: the file; whatever is wrong with it becomes a failed check.
        frames: compares frames with data that are here (`robustflow.runner.recheck`); it is called when all else
            holds, returns what it did in a sentence, and raises where frames differ.

    Returns:
        The `Verification`.
    """
    try:
        data = read_file(Path(path).expanduser())
    except RobustFlowError as error:
        return Verification(
            file=str(path), sha256="", facts=None, checks=_checks({"container": ("failed", str(error))})
        )
    return verify_read(Reader(data, str(path)), frames=frames)


def verify_read(reader: Reader, *, frames: Callable[[Reader], str] | None = None) -> Verification:
    """As `verify`, of a file in memory; a reader whose record is verified holds what it read."""
    found: dict[str, _Told] = {}
    for step in STEPS:
        try:
            found[step] = ("ok", getattr(reader, step)())
        except RobustFlowError as error:
            found[step] = ("failed", str(error))
            return _verification(reader, found, frames is not None)
    for check, (problems, says) in _truths(reader).items():
        found[check] = ("failed", _listed(problems)) if problems else ("ok", says)
    if frames is not None and all(status == "ok" for status, _ in found.values()):
        try:
            found["frames"] = ("ok", frames(reader))
        except RobustFlowError as error:
            found["frames"] = ("failed", str(error))
    return _verification(reader, found, frames is not None)


def _truths(reader: Reader) -> dict[str, tuple[list[str], str]]:
    """The checks of what a record says, by name: problems, and what to say where there are none."""
    problems = training_problems(reader.plan, reader.raw_manifest)
    out: dict[str, tuple[list[str], str]] = {"training": (problems, reader.plan.provenance.setting)}
    with TemporaryDirectory(prefix="robustflow-") as folder:
        reader.unfold(Path(folder))
        run = Run(folder)
        problems, says = cell_problems(run, reader)
        out["cells"] = (problems, says)
        if problems:
            return out  # sums over cells that nobody planned mean nothing
        try:
            audited = audit_run(run)
        except RobustFlowError as error:
            return out | {"summary": ([str(error)], "")}
    for check, name in (("measurements", "rows"), ("summary", "summary")):
        told = [finding.says for finding in audited.findings if finding.check == name]
        out[check] = (told, f"{audited.checked.get(name, 0)} comparisons")
    return out


def _listed(problems: list[str]) -> str:
    more = len(problems) - _SHOWN
    return "; ".join(problems[:_SHOWN]) + (f"; and {more} more" if more > 0 else "")


def _verification(reader: Reader, found: dict[str, _Told], with_frames: bool) -> Verification:
    facts = getattr(reader, "facts", None)
    return Verification(file=reader.name, sha256=reader.sha256, facts=facts, checks=_checks(found, with_frames))


def _checks(found: dict[str, _Told], with_frames: bool = False) -> tuple[Check, ...]:
    return tuple(
        Check(name=check, status=found[check][0], says=plain(found[check][1], 600))
        if check in found
        else Check(name=check, status="not checked", says="")
        for check in CHECKS
        if check != "frames" or with_frames
    )
