"""Robustness metrics that depend less on accuracy than the paper's, one line per run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple
from typing import TYPE_CHECKING

from ..analysis.model_result import ModelResult
from ..analysis.results import AVERAGE
from ..analysis.uncoupled import Coupling, Uncoupled, coupling, uncoupled
from ..errors import UsageError
from .table import Column, Line, Section, Table, full_note

if TYPE_CHECKING:
    from ..runs.run import Run

_COLUMNS = (
    "clean EPE (px)",
    "CRE (px)",
    "log ratio",
    "median log ratio",
    "median CRE (px)",
    "Fl increase (points)",
    "rank correlation",
    "given the motion",
)
_REMARK = (
    "log ratio: ln(EPE / clean EPE), averaged over images; 0.69 if errors double. Medians are over images. "
    "Fl increase: percentage points of Fl-all. Rank correlation: between corrupted and clean EPE over images, first "
    "uncontrolled, then controlled for the true flow magnitude. CRE is EPE - clean EPE, so it depends on accuracy."
)


def uncoupled_table(results: Sequence[ModelResult]) -> Table:
    """Tabulate `uncoupled` for runs. With five or more ranked models on the same frames, add the correlations of CRE
    and log ratio with accuracy.
    """
    lines = []
    same_frames: dict[str, list[tuple[float, float, float]]] = {}
    for result in results:
        if (run := result.run) is None:
            continue
        measured = uncoupled(run.rows)
        if measured.overall.log_ratio is None and measured.overall.median_cre is None:
            continue
        lines.append(Line.of_numbers(result.name, _numbers(run, measured), full_note(result)))
        clean, cre, ratio = run.epe_clean, run.cre, measured.overall.log_ratio
        if clean is not None and cre is not None and ratio is not None and not result.excluded:
            same_frames.setdefault(result.frames, []).append((clean, cre, ratio))
    if not lines:
        raise UsageError("the table 'uncoupled' needs ground truth, which none of these runs has")
    couplings = (coupling(*map(list, zip(*models, strict=True))) for models in same_frames.values())
    remarks = tuple(_sentence(one) for one in couplings if one is not None)
    columns = tuple(map(Column, _COLUMNS))
    return Table(
        "uncoupled", "Robustness beside accuracy", columns, (Section("Runs", tuple(lines)),), (_REMARK, *remarks)
    )


def _numbers(run: Run, measured: Uncoupled) -> tuple[float | None, ...]:
    related = measured.correlation.get(AVERAGE)
    correlations = (related.rho, related.given_motion) if related else (None, None)
    return run.epe_clean, run.cre, *astuple(measured.overall), *correlations


def _sentence(coupling: Coupling) -> str:
    cre, ratio = ("cannot be computed" if v is None else f"{v:+.2f}" for v in (coupling.cre, coupling.log_ratio))
    return (
        f"Over {coupling.models} models on the same frames, the rank correlation with the clean EPE is {cre} for CRE "
        f"and {ratio} for the log ratio."
    )
