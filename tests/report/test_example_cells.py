"""The cells chosen for drawing match those found by a plain loop over made-up rows."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from robustflow.report.gallery.examples import example_cells
from tests.made_rows import rows_frame

from ..run.mean_rows import NO_TRUTH, row

CELLS = [("fog", 1), ("fog", 2), ("fog", 3), ("snow", 1)]


def _rows(errors: dict[str, list[float]], truth: bool = True):
    """Rows of samples with clean error 1 and the given errors under corruption, in order."""
    return rows_frame(
        row(key, *cell, n=2, epe=value, rcre=value + 3, rcre_all_sum=4 * value) | ({} if truth else NO_TRUTH)
        for key, values in errors.items()
        for cell, value in zip([("clean", 0), *CELLS], [1.0, *values], strict=True)
    )


def _expected(errors: dict[str, list[float]]):
    order = sorted(
        (value, key, cell) for key, values in errors.items() for value, cell in zip(values, CELLS, strict=True)
    )
    worst = min((key, cell) for value, key, cell in order if value == order[-1][0])
    return worst, order[(len(order) - 1) // 2][1:]


# Integers divided by 4 have exact sums and means, so that ties do not depend on the order of computation.
errors_of_samples = st.dictionaries(
    st.text("abc0/", min_size=1, max_size=3),
    st.lists(st.integers(4, 40).map(lambda n: n / 4 * 3), min_size=4, max_size=4),
    min_size=1,
    max_size=6,
)


@given(errors_of_samples, st.booleans())
def test_example_cells_are_the_worst_and_the_median(errors, truth):
    worst, median = example_cells(_rows(errors, truth))
    assert tuple((one.key, (one.corruption, one.severity)) for one in (worst, median)) == _expected(errors)
    assert (worst.kind, median.kind) == ("worst", "median")
    value = errors[worst.key][CELLS.index((worst.corruption, worst.severity))]
    scores = (worst.epe, worst.cre, worst.rcre)
    assert scores == ((value, value - 1, value + 3) if truth else (None, None, value))


def test_cre_of_a_cell_is_over_the_pixels_that_both_flows_have():
    rows = rows_frame([row("a", n=4, epe=2.0), row("a", "fog", 1, n=2, epe=3.0, rcre=4.0, clean_epe_sum=1.0)])
    assert [one.cre for one in example_cells(rows)] == [2.5, 2.5], "the clean error at these two pixels is 0.5"


def test_empty_rows_have_no_example_cells():
    assert example_cells(rows_frame([])) == []
