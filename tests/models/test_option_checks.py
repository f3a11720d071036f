"""Model options: numbers, booleans and text are not mistaken for each other."""

import pytest

from robustflow.core.errors import UsageError
from robustflow.models.conventions import check_count, check_switch


@pytest.mark.parametrize("value", [0, -1, 1.0, "3", None, True])
def test_value_that_is_not_a_count_is_refused(value):
    with pytest.raises(UsageError, match="iterations must be an integer of at least 1, not"):
        check_count("iterations", value)


def test_a_count_may_begin_elsewhere():
    check_count("levels", 0, least=0)
    with pytest.raises(UsageError, match="winsize must be an integer of at least 2, not 1"):
        check_count("winsize", 1, least=2)


@pytest.mark.parametrize("value", [0, 1, "no", None])
def test_value_that_is_not_a_boolean_is_refused(value):
    with pytest.raises(UsageError, match="compile must be true or false, not"):
        check_switch("compile", value)
