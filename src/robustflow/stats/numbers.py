"""The parts of the results frame of one run: its means, its measures of confidence, of robustness beside accuracy and
of attacks, and facts that tables need beside them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any

import polars as pl

from ..corruptions.registry import MEMBERS
from ..metrics.cube import AVERAGE, PAPER, Cube, MeanKey, Means
from ..metrics.measures import CONFIDENCE, UNCOUPLED
from ..metrics.rows import CLEAN
from ..run.costs import RunCost
from ..run.run import Run
from .attacks import attack_numbers
from .intervals import paper_rows
from .ranking import partial_spearman, spearman

LEAST_IMAGES = 5
"""Minimum number of images for a correlation."""

Number = dict[str, Any]
"""A row of the frame: measure, condition, severity, value, and further columns."""


def numbered(means: Mapping[MeanKey, float]) -> list[Number]:
    """Return means as rows of the frame."""
    return [{"measure": m, "condition": of, "severity": at, "value": value} for (m, of, at), value in means.items()]


def run_means(run: Run, beside_published: bool = False) -> Means:
    """Return the means of a run. With `beside_published`, the average is over the paper's corruptions where all of them
    were run."""
    if not (beside_published and run.measured.paper_over):
        return run.means
    whole = {PAPER: AVERAGE}
    return {(m, whole.get(of, of), at): value for (m, of, at), value in run.means.items() if of != AVERAGE}


def covered(run: Run) -> float | None:
    """Return the fraction of pixels included in the errors; None for all pixels. Pixels without a predicted flow and
    planned rows that are missing are not included."""
    predicted = run.mean("coverage") if run.averages.has_gaps else None
    if not run.measured.missing:
        return predicted
    missing = sum(cells.count for cells in run.measured.missing)
    planned = sum(part.count(attacks=False) for part in run.manifest.planned)
    return (1.0 if predicted is None else predicted) * (1 - missing / planned)


def confidence_means(rows: pl.DataFrame) -> Means:
    """Return how well the confidence predicts errors, also by family and severity; empty if the run has none."""
    known = rows.filter(pl.col("ause").is_not_null() | pl.col("rejected_count").is_not_null())
    return Cube.of(known, MEMBERS).means(CONFIDENCE) if known.height else {}


def uncoupled_means(rows: pl.DataFrame) -> Means:
    """Return measures of robustness that depend less on accuracy than CRE (`UNCOUPLED`), and the rank correlation over
    images of the corrupted and the clean EPE, also given the motion."""
    return Cube.of(rows, MEMBERS).means(UNCOUPLED) | dict(_correlations(rows))


def _correlations(rows: pl.DataFrame) -> Iterator[tuple[MeanKey, float]]:
    n = pl.col("n_valid")
    known = rows.filter(n > 0)
    images = known.filter(pl.col("corruption") != CLEAN).join(known.filter(corruption=CLEAN), on="sample", how="semi")
    for condition in (AVERAGE, *images["corruption"].unique().sort()):
        part = images if condition == AVERAGE else images.filter(corruption=condition)
        per_image = (pl.col(total) / n for total in ("epe_sum", "clean_epe_sum", "magnitude_sum"))
        each = part.group_by("sample", maintain_order=True).agg(value.mean() for value in per_image)
        if each.height < LEAST_IMAGES:
            continue
        epe, before, motion = (each[name].to_list() for name in each.columns[1:])
        found = {"rank_correlation": spearman(epe, before)}
        found["rank_correlation_given_motion"] = partial_spearman(epe, before, motion)
        yield from (((name, condition, None), value) for name, value in found.items() if value is not None)


def confidence_of(run: Run) -> str:
    """Return where the confidence of a run is from; "" if it has none."""
    return run.manifest.identity.measuring.confidence or ""


def _uncoupled(run: Run, beside_published: bool) -> list[Number]:
    kind = "paper " if beside_published and run.measured.paper_over else ""
    stored = list[tuple[str, str, int | None, float]]
    means = run.derived.value(
        f"{kind}uncoupled",
        stored,
        lambda: [(*key, value) for key, value in uncoupled_means(paper_rows(run) if kind else run.rows).items()],
    )
    return numbered({(measure, of, at): value for measure, of, at, value in means})


def _facts(run: Run, beside_published: bool) -> Iterator[Number]:
    """Yield the cost of the model and how it was counted, the corruptions of averages, and what a run lacks."""
    measured, cost, share = run.measured, RunCost.read(run), covered(run)
    known: dict[str, float | None] = {"coverage": share}
    known["missing"] = sum(cells.count for part in (measured.missing, measured.unmeasured) for cells in part) or None
    known["invalid_pixels"] = measured.n_invalid or None
    if cost is not None:
        known |= {"parameters": cost.parameters_m, "counted_iterations": cost.iterations}
        known |= {"counted_height": cost.height, "counted_width": cost.width}
        yield {"measure": "flops", "condition": "", "value": cost.flops_g, "decimals": 1}
    averaged = (beside_published and measured.paper_over) or measured.averaged_over
    yield from numbered({(name, "", None): float(value) for name, value in known.items() if value is not None})
    yield from numbered(dict.fromkeys((("averaged", name, None) for name in averaged), 1.0))


NUMBERS: dict[str, Callable[[Run, bool], Iterable[Number]]] = {
    "means": lambda run, beside_published: numbered(run_means(run, beside_published)),
    "confidence": lambda run, _: numbered(confidence_means(run.rows)) if confidence_of(run) else [],
    "uncoupled": _uncoupled,
    "attacks": lambda run, _: attack_numbers(run),
    "facts": _facts,
}
"""The rows of each part of the frame; the flag says whether averages are shown beside published ones."""
