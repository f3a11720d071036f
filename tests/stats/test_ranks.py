"""Ranks match SciPy's; the package itself does not import scipy.stats, because that takes a second."""

import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import rankdata

from robustflow.stats.ranking import average_ranks, competition_ranks, middle_ranks

VALUES = st.lists(st.integers(-4, 4) | st.floats(allow_nan=False), max_size=30)


@given(VALUES)
def test_ranks_are_those_of_scipy_bit_for_bit(values):
    numbered = dict(enumerate(values))
    assert list(competition_ranks(numbered).items()) == list(enumerate(rankdata(values, method="min").tolist()))
    assert middle_ranks(values) == rankdata(values).tolist()


def test_ranks_of_nan_are_nan():
    with pytest.raises(ValueError):
        competition_ranks({"a": 1.0, "b": float("nan")})
    assert np.isnan(middle_ranks([1.0, float("nan")])).tolist() == [True, True]


def test_average_ranks_rank_the_sum_over_names_in_all_rankings():
    """Rank sums are a: 1 + 3, b: 2 + 2, c: 3 + 4; d appears in only one ranking."""
    assert average_ranks({"a": 1, "b": 2, "c": 3, "d": 1}, {"a": 3, "b": 2, "c": 4}) == {"a": 1, "b": 1, "c": 3}


def test_a_run_and_its_report_do_without_scipy_stats():
    code = "import sys, robustflow.api, robustflow.report.site; sys.exit('scipy.stats' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
