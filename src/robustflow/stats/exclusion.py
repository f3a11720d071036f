"""Reasons not to rank a model by robustness, whatever its CRE: random weights, a flow hardly better than zero flow, or
a flow that hardly depends on the frames. What runs without ground truth or on still scenes cannot show.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from statistics import median_low

import polars as pl

from ..core.text import plain
from ..data.benchmarks import benchmark_facts
from ..data.benchmarks.facts import is_still
from ..metrics.cube import Cube, averaged_rows
from ..metrics.measures import CLEAN_MEASURES, MEASURES, exact_mean
from ..metrics.rows import CLEAN
from ..run.comparable import sample_set
from ..run.run import Run
from .estimate import joint_clusters
from .inference import FEWEST
from .results import NEVER_RANKED

PHANTOM = (
    "Nothing moves in these frames, so EPE measures phantom motion: bias on clean frames, flicker under corruption. "
    "A model that always predicts zero flow has none; its error on moving scenes shows the cost."
)
"""The explanation shown with errors on still scenes."""

CAVEAT = (
    "RCRE measures how much the flow changes, not whether it is wrong: a model that ignores its frames has the lowest "
    "RCRE, and only its photometric error, close to that of zero flow, distinguishes it from a robust model."
)


def without_truth(run: Run) -> bool:
    """Whether a run used frames without ground truth for which the paper has no results, such as the user's own
    frames."""
    benchmark = run.benchmark
    return not benchmark_facts(benchmark).published and run.epe_clean is None and run.rcre is not None


def enough_to_compare(run: Run) -> bool:
    """Whether a run has enough independent pairs to generalise a difference to other frames."""
    return joint_clusters([Cube.of(run.rows.filter(corruption=CLEAN))])[0] >= FEWEST


ACCURATE_BELOW = 0.5
"""Upper bound on the clean EPE of a sound model, as a fraction of the EPE of zero flow. Above this bound,
a model is hardly better than zero flow, so a small change under corruption is not evidence of robustness."""
SMALL_MOTION = 1.0
"""Mean length of the ground-truth flow in pixels below which even sound models may exceed `ACCURATE_BELOW`: on
Middlebury's RubberWhale (1.26 px), the EPE of the package's models is 0.23 to 0.40 px."""
BLIND_BELOW = 0.001
"""RCRE, as a fraction of the length of the clean flow, below which a flow hardly depends on the frames. For DIS,
Farneback and `tiny` at the lowest severity of a single corruption, the fraction is 0.010 to 0.15."""
EXPLAINED_BELOW = 0.9
"""Upper bound on the clean photometric error of a sound model, as a fraction of that of zero flow. On 61 real pairs,
the fraction is 0.08 to 0.82 for DIS, and at least 0.91 for a tenth of its flow."""
FOLLOWED_BELOW = 0.5
"""Clean photometric error, as a fraction of that of zero flow, below which a flow follows the motion, whatever its EPE.
On 23 real pairs, half of the true flow has a fraction of 0.56 to 0.86."""
OUTLIERS_BELOW = 0.5
"""Share of wrong pixels (Fl) below which a large mean error is that of outliers, if these are over 100 px wrong and ten
times as much as the motion."""
COVERED_FROM = 0.99
"""Lower bound on the share of the pixels that a model predicted. Below it, a low EPE can be due to easy pixels."""


def exclusion_reasons(run: Run) -> list[str]:
    """List the reasons not to rank a run's model by robustness, each as a clause; empty for a sound model."""
    reasons = [reason] if (reason := NEVER_RANKED.get(run.setting)) else []
    if is_still(run.benchmark):
        return reasons  # zero flow is correct, so a model may ignore its frames
    return reasons + run.derived.value("exclusion reasons", list[str], lambda: reasons_from_rows(run.rows))


def exclusions(runs: Sequence[Run]) -> list[str]:
    """State why each run should not be ranked; "" for a run that should be ranked."""
    reasons = [list(exclusion_reasons(run)) for run in runs]
    lengths: dict[str, dict[int, float]] = {}
    for index, run in enumerate(runs):
        length = run.mean("flow_length", CLEAN)
        if length is not None and run.epe_clean is None and not reasons[index]:
            lengths.setdefault(sample_set(run), {})[index] = length
    for of_frames in lengths.values():
        for index, length in of_frames.items():
            others = [other for key, other in of_frames.items() if key != index]
            if others and length < ACCURATE_BELOW * median_low(others):
                reasons[index].append(
                    f"its clean flow is {length:.2f} px long on average, less than half of the "
                    f"{median_low(others):.2f} px median of the other models"
                )
    return list(map(" and ".join, reasons))


def not_ranked(reasons: Mapping[str, str]) -> list[str]:
    """Return "<name>, because <reason>" for each model that is not ranked, from the reasons by name ("" for none)."""
    return [f"{plain(name)}, because {reason}" for name, reason in reasons.items() if reason]


def reasons_from_rows(rows: pl.DataFrame) -> list[str]:
    """List the reasons that follow from the rows (columns of `ROW_SCHEMA`) of a run on moving scenes."""
    reasons = []
    clean = _clean_means(rows)
    error, of_still = clean.get("photometric"), clean.get("photometric_still")
    outlying = False
    if (missed := missed_motion(rows)) is not None:
        epe, still = missed
        why = "a flow that misses the motion can hardly get worse"
        wrong = clean.get("fl", 100.0) / 100
        others = epe - (1 - wrong) * (3 + 0.05 * still)  # the most that pixels that are not wrong can add
        outlying = 0 < wrong < OUTLIERS_BELOW and others > max(100, 10 * still) * wrong
        if outlying:
            pixels = f"{100 * wrong:.1f} % of the pixels"
            why = f"made by outliers among {pixels}, which are {others / wrong:.3g} px wrong on average"
        elif still < SMALL_MOTION:
            why = "motion this small does not distinguish a sound model from zero flow: measure it on larger motion"
        elif error is not None and of_still and error < FOLLOWED_BELOW * of_still:
            why = "but it explains the frames, so the ground truth may be in a wrong format: check the dataset"
        number = f"{epe:.2f}" if epe < 1e6 else f"{epe:.3g}"
        reasons.append(f"its clean EPE of {number} px is at least half of the {still:.2f} px of zero flow ({why})")
    length, moved = clean.get("flow_length"), _mean_change(rows)
    if "zero_flow_epe" not in clean and error is not None and of_still and error > EXPLAINED_BELOW * of_still:
        how = "worse" if error > of_still else "hardly better"
        reasons.append(
            f"its clean flow explains the frames {how} than zero flow: its photometric error is {error:.2f} grey "
            f"levels, that of zero flow {of_still:.2f}"
        )
    (covered,) = MEASURES["coverage"].parts
    share = rows.filter(covered.count > 0).select((covered.total / covered.count).mean()).item()
    if share is not None and share < COVERED_FROM:
        most = 100 * (1 - COVERED_FROM)
        reasons.append(f"it predicted no flow at more than {most:.0f} % of the pixels; its errors may be of easy ones")
    if not outlying and length is not None and moved is not None and moved <= BLIND_BELOW * length:
        reasons.append(
            f"its flow hardly depends on the frames: corruption changes it by {moved:.3f} px (length {length:.2f} px)"
        )
    return reasons


def missed_motion(rows: pl.DataFrame) -> tuple[float, float] | None:
    """Return the clean EPE and the EPE of zero flow, in pixels, if their ratio is at least `ACCURATE_BELOW`; None for a
    smaller ratio or without ground truth."""
    clean = _clean_means(rows)
    epe, still = clean.get("epe"), clean.get("zero_flow_epe")
    if epe is None or still is None or epe < ACCURATE_BELOW * still:
        return None
    return epe, still


def _clean_means(rows: pl.DataFrame) -> dict[str, float]:
    """Return the known means on the clean frames by measure; `zero_flow_epe`, the EPE of a model that predicts zero
    flow, is the mean length of the ground-truth flow."""
    means = Cube.of(rows.filter(corruption=CLEAN)).means(MEASURES | CLEAN_MEASURES, [(CLEAN, None)])
    return {name: value for (name, *_), value in means.items()}


def _mean_change(rows: pl.DataFrame) -> float | None:
    """Return the mean RCRE over all pixels of the pairs that the corruption changed."""
    clean = rows.filter(pl.col("corruption") == CLEAN).select("sample", _clean="frames_digest")
    corrupted = averaged_rows(rows).filter(pl.col("corruption") != CLEAN).join(clean, on="sample")
    changed = corrupted.filter(pl.col("frames_digest") != pl.col("_clean"), pl.col("n_all") > 0)
    return exact_mean((changed["rcre_all_sum"] / changed["n_all"]).to_list()) if changed.height else None
