import pytest
from hypothesis import given
from hypothesis import strategies as st

from robustflow.metrics import cre, crer, epe, rcre
from robustflow.metrics.error_maps import LEAST_CLEAN

from .strategies import cases

errors = st.floats(0, 1e4)


@given(st.floats(LEAST_CLEAN, 1e4), errors)
def test_crer_times_the_clean_error_is_cre(clean, corrupted):
    assert crer(cre(corrupted, clean), clean) * clean == pytest.approx(corrupted - clean, rel=1e-12)


def test_robustness_of_undefined_errors_is_undefined():
    assert cre(None, 1.0) is None
    assert cre(1.0, None) is None
    assert crer(None, 1.0) is None
    assert [crer(1.0, clean) for clean in (0.0, 5e-324, 0.003)] == [None, None, None]
    assert [cre(*errors) for errors in ((1e28, 1e28), (1e28, 1.0), (1.0, 1e28))] == [None, None, None]
    assert crer(1.0, None) is None


@given(cases())
def test_rcre_bounds_the_change_of_the_error(case):
    """The triangle inequality holds for each pixel, and hence for every mean over the same pixels."""
    pred, clean, sample = case
    moved = rcre(pred, clean, sample.valid)
    change = cre(epe(pred, sample.flow, sample.valid), epe(clean, sample.flow, sample.valid))
    if moved is None:
        assert change is None
    else:
        assert moved >= abs(change) * (1 - 1e-12) - 1e-9
