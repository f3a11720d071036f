"""Expect an error whose message is one line."""

from collections.abc import Callable

import pytest

from robustflow.core.errors import RobustFlowError, as_argument


def refusal(call: Callable[[], object], error: type[RobustFlowError], culprit: object) -> RobustFlowError:
    """Call it, and check the class and the culprit of its error, whose message is one line. An option is an argument in
    Python."""
    with pytest.raises(RobustFlowError) as caught:
        call()
    assert (type(caught.value), caught.value.culprit) == (error, as_argument(str(culprit))), caught.value
    assert "\n" not in str(caught.value)
    return caught.value
