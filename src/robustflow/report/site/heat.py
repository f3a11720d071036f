"""How strongly a cell of a table is coloured: eleven steps, so that a class says it and a page stays small."""

from __future__ import annotations

from collections.abc import Iterable

STEPS = 10


def heat_class(value: float | None, top: float) -> str:
    """The class of a cell: "h0" to "h10" by its share of `top`, "c1" to "c10" below zero, "" for no value.

    >>> heat_class(5.0, 10.0), heat_class(-5.0, 10.0), heat_class(0.0, 10.0), heat_class(99.0, 10.0)
    ('h5', 'c5', 'h0', 'h10')
    """
    if value is None:
        return ""
    step = min(STEPS, round(STEPS * abs(value) / top)) if top > 0 else 0
    return f"c{step}" if value < 0 and step else f"h{step}"


def scale_top(values: Iterable[float | None]) -> float:
    """The value of the strongest colour: the 95th percentile, so that one outlier does not pale all others.

    >>> scale_top([1.0, None, 2.0, -3.0])
    3.0
    """
    found = sorted(abs(value) for value in values if value is not None)
    return found[min(len(found) - 1, int(0.95 * len(found)))] if found else 0.0
