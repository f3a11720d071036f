"""How strongly cells are coloured: the page's script turns a share of `scale_top` into one of its steps."""

from __future__ import annotations

from collections.abc import Iterable


def scale_top(values: Iterable[float | None]) -> float:
    """The value of the strongest colour: the 95th percentile, so that one outlier does not make all others pale.

    >>> scale_top([1.0, None, 2.0, -3.0])
    3.0
    """
    known = sorted(abs(value) for value in values if value is not None)
    return known[min(len(known) - 1, int(0.95 * len(known)))] if known else 0.0
