"""The cells chosen for drawing match those found by a plain loop over made-up rows."""

from __future__ import annotations

from statistics import fmean

from hypothesis import given
from hypothesis import strategies as st

from robustflow.metrics.rows import ROW_SCHEMA, rows_frame
from robustflow.runs.example_cells import example_cells

CORRUPTIONS, SEVERITIES = ("fog", "snow"), (1, 2, 3)


def _rows(errors: dict[str, list[float]], truth: bool = True):
    """Rows of samples with clean error 1 and the given errors under corruption, in order."""
    rows = []
    for key, values in errors.items():
        cells = [("clean", 0, 1.0)]
        settings = [(name, severity) for name in CORRUPTIONS for severity in SEVERITIES]
        cells += [(*setting, value) for setting, value in zip(settings, values, strict=True)]
        for corruption, severity, value in cells:
            row = dict.fromkeys(ROW_SCHEMA)
            row |= {
                "sample": key,
                "corruption": corruption,
                "severity": severity,
                "n_all": 4,
                "rcre_all_sum": 4 * value,
            }
            if truth:
                row |= {"n_valid": 2, "epe_sum": 2 * value, "rcre_sum": 2 * value + 6}
            rows.append(row)
    return rows_frame(rows)


def _expected(errors: dict[str, list[float]]):
    scores = sorted((fmean([fmean(values[:3]), fmean(values[3:])]), key) for key, values in errors.items())
    top = max(score for score, _ in scores)
    worst = min(key for score, key in scores if score == top)
    median = scores[(len(scores) - 1) // 2][1]
    settings = [(name, severity) for name in CORRUPTIONS for severity in SEVERITIES]
    cells = sorted(zip(errors[median], settings, strict=True))
    peak = max(errors[worst])
    return (worst, settings[errors[worst].index(peak)]), (median, cells[2][1])


# Integers divided by 4 have exact sums and means, so that ties do not depend on the order of computation.
errors_of_samples = st.dictionaries(
    st.text("abc0/", min_size=1, max_size=3),
    st.lists(st.integers(4, 40).map(lambda n: n / 4 * 3), min_size=6, max_size=6),
    min_size=1,
    max_size=6,
)


@given(errors_of_samples, st.booleans())
def test_worst_and_median(errors, truth):
    worst, median = example_cells(_rows(errors, truth))
    assert ((worst.key, (worst.corruption, worst.severity)), (median.key, (median.corruption, median.severity))) == (
        _expected(errors)
    )
    assert (worst.kind, median.kind) == ("worst", "median")
    value = errors[worst.key][CORRUPTIONS.index(worst.corruption) * 3 + worst.severity - 1]
    if truth:
        assert (worst.scores.epe, worst.scores.cre, worst.scores.rcre) == (value, value - 1, value + 3)
    else:
        assert (worst.scores.epe, worst.scores.cre, worst.scores.rcre) == (None, None, value)


def test_nothing_measured_nothing_chosen():
    assert example_cells(rows_frame([])) == []
