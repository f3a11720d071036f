"""What a record claims beyond its numbers: which rows there should be, and what its model was trained on."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from ..corruptions.base import SEVERITIES
from ..corruptions.registry import CORRUPTIONS
from ..corruptions.stack import is_stack, levels_of, parse_stack
from ..errors import UsageError
from ..metrics.rows import CLEAN, ROW_KEY
from ..models.provenance import Training, parse_training_sets, training_of
from ..text import plain
from .contents import Manifest

if TYPE_CHECKING:
    from ..runs.run import Run
    from .read import Reader


def cell_problems(run: Run, reader: Reader) -> tuple[list[str], str]:
    """Corruptions nobody knows, rows that were not planned or are missing; and a sentence where there are none."""
    plan = reader.plan
    problems = [*_unknown(plan.selection.corruptions), *_left_out(plan)]
    if not set(plan.selection.severities) <= set(SEVERITIES):
        problems.append(f"severities {plan.selection.severities}: they are 1 to 5")
    if problems:
        return problems, ""
    planned, found = set(run.planned()), set(reader.frame.select(ROW_KEY).iter_rows())
    extra, missing = found - planned, planned - found
    if extra:
        sample, corruption, severity = min(extra)
        problems.append(
            f"{len(extra)} rows were not planned, the first of sample '{plain(sample)}', {plain(corruption)} severity "
            f"{severity}"
        )
    if bool(missing) == reader.facts.complete:
        says = "complete" if reader.facts.complete else "not complete"
        problems.append(
            f"record.json says that the run is {says}, but {len(missing)} of {len(planned)} rows are missing"
        )
    without = {sample for sample, _, _ in found} - {sample for sample, name, _ in found if name == CLEAN}
    if without:
        problems.append(f"sample '{plain(min(without))}' has no row of its clean frames")
    if not plan.identity.allow_invalid and reader.frame["n_invalid"].sum():
        problems.append("pixels that are no numbers were counted, but the run did not allow them")
    return problems, f"{len(found)} of {len(planned)} planned rows"


def training_problems(plan: Manifest, raw: dict[str, Any]) -> list[str]:
    """Whether the setting (OOD, ID, LEAKED, ...) is what the declared or catalogued training sets make it.

    What a user declares is believed; what the package knows better by a checkpoint's hash is not up to declaration.
    """
    said, benchmark = plan.provenance, plan.identity.benchmark
    known = training_of(raw["identity"]["model"])
    if known.basis == "undeclared" and said.basis == "declared":
        try:
            known = Training(parse_training_sets("+".join(said.trained_on or [])), "declared")
        except UsageError as error:
            return [f"the declared training sets say nothing: {plain(str(error), 120)}"]
    record = known.record(benchmark)
    if (said.setting, said.basis, said.trained_on) != (record["setting"], record["basis"], record["trained_on"]):
        return [
            f"the manifest says {said.setting} by {said.basis}, trained on {_sets(said.trained_on)}; for this model "
            f"and benchmark it is {record['setting']} by {record['basis']}, trained on {_sets(record['trained_on'])}"
        ]
    return []


def _sets(names: list[str] | None) -> str:
    return "+".join(names) if names else "nothing it names"


def _unknown(names: list[str]) -> list[str]:
    known, out = set(CORRUPTIONS.names()), []
    for name in names:
        try:
            fits = bool(parse_stack(name)) if is_stack(name) else name in known
        except UsageError:
            fits = False
        if not fits:
            out.append(f"corruption '{plain(name, 60)}' is not known here; install the package that brings it")
    if len(set(names)) != len(names):
        out.append("a corruption is selected twice")
    return out


def _left_out(plan: Manifest) -> list[str]:
    """Severities that were left out are those the calibrated scale lacks, and no others."""
    scale = "calibrated" if plan.identity.severity_scale else "paper"
    severities = tuple(plan.selection.severities)
    for name in dict.fromkeys((*plan.selection.corruptions, *plan.left_out)):
        if name not in plan.selection.corruptions or _unknown([name]):
            return [f"left_out names '{plain(name, 60)}', which was not selected"]
        lacking = sorted({*levels_of(name, severities)} - {*levels_of(name, severities, scale)})
        if plan.left_out.get(name, []) != lacking:
            return [
                f"{name} was left out at severities {plan.left_out.get(name, [])}; the {scale} scale lacks {lacking}"
            ]
    return []
