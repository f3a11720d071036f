"""Describe in one sentence what can be claimed about a difference."""

from __future__ import annotations

from ...text import counted
from ..labels import METRIC_LABELS, UNITS, long_label
from .bootstrap import Interval


def difference_sentence(
    names: tuple[str, str],
    metric: str,
    corruption: str,
    interval: Interval,
    p_holm: float | None,
    comparisons: int,
    images: int,
    clusters: int,
    level: float,
    clean_gap: float | None = None,
    flow_gap: float | None = None,
    *,
    equal: int = 0,
    blow_ups: tuple[int, int] = (0, 0),
) -> str:
    """Describe whether two models differ, by how much, with what certainty, and based on how many independent
    observations.

    >>> sure = Interval(-0.42, 0.1, -0.7, -0.1, 0.001)
    >>> sentence = difference_sentence(("A", "B"), "cre", "average", sure, 0.02, 1, 80, 80, 0.95, 18.0)
    >>> sentence.partition(" (")[0]
    'The average CRE of A is lower than that of B by 0.42 px'
    >>> sentence.partition("): ")[2]
    'the error of A grows less under corruption, but A is less accurate: EPE +18.00 px.'
    """
    what = {"average": "average ", "clean": "clean "}.get(corruption, f"{long_label(corruption)} ") + METRIC_LABELS[
        metric
    ]
    unit = f" {UNITS[metric]}" if UNITS[metric] else ""
    observed = f"{images} images" if clusters == images else f"{images} images in {clusters} sequences"
    size = abs(interval.estimate)
    if p_holm is None:
        units = ("image" if clusters == images else "sequence") + (" is" if clusters == 1 else "s are")
        outcome = f"differs by {size:.2f}{unit}, but" if size else "is the same, but"
        chance = "to tell whether this is chance" if size else "to say more"
        return f"The {what} of {names[0]} and {names[1]} {outcome} {clusters} {units} too few {chance}."
    percent = f"{100 * level:g} %"
    corrected = f" corrected for {comparisons} comparisons" if comparisons > 1 else ""
    evidence = f"p {p_text(p_holm)}{corrected}; {observed}"
    blown = "".join(
        f" On {counted(count, 'image')}, the error of {model} is more than ten times that of {other}."
        for count, model, other in zip(blow_ups, names, reversed(names), strict=True)
        if count
    )
    ends = "no finite interval"
    if interval.low is not None and interval.high is not None:
        ends = f"{percent} interval {interval.low:+.2f} to {interval.high:+.2f}"
    elif equal:
        ends += f", because {equal} of {counted(images, 'image')} are equal"
    if p_holm >= 1 - level or interval.low is None or interval.high is None:
        return (
            f"No difference in {what} between {names[0]} and {names[1]} can be claimed: {interval.estimate:+.2f}{unit} "
            f"({ends}; {evidence}).{blown}"
        )
    lower = interval.estimate < 0
    low, high = sorted((abs(interval.low), abs(interval.high)))
    gaps = [gap if lower or gap is None else -gap for gap in (clean_gap, flow_gap)]
    verdict = _verdict(metric, names[0] if lower else names[1], *gaps)
    return (
        f"The {what} of {names[0]} is {'lower' if lower else 'higher'} than that of {names[1]} by {size:.2f}{unit} "
        f"({percent} interval {low:.2f} to {high:.2f}; {evidence}): {verdict}.{blown}"
    )


def _verdict(metric: str, lower: str, clean_gap: float | None, flow_gap: float | None) -> str:
    """Explain what the lower value means. Each gap is the value of the model that `lower` names minus that of the other
    model. Only RCRE measures how much a flow changes."""
    if metric == "epe":
        return f"{lower} is more accurate"
    if metric == "rcre":
        clause = f"the flow of {lower} changes less under corruption"
    else:
        relative = " relative to its error on clean frames" if metric == "crer" else ""
        clause = f"the error of {lower} grows less under corruption{relative}"
        if flow_gap is not None and flow_gap >= 0.005:
            clause += f", although its flow changes more (RCRE {flow_gap:+.2f} px)"
    if clean_gap is None:
        return clause
    if abs(clean_gap) < 0.005:
        return f"{clause}, and {lower} is as accurate on clean frames"
    how = f"but {lower} is less" if clean_gap > 0 else f"and {lower} is more"
    return f"{clause}, {how} accurate: EPE {clean_gap:+.2f} px"


def p_text(value: float) -> str:
    """Format a p-value as written after the letter p; values below 0.001 are written as "< 0.001".

    >>> p_text(0.0204), p_text(0.0004)
    ('= 0.020', '< 0.001')
    """
    return "< 0.001" if value < 0.001 else f"= {value:.3f}"
