"""Arguments of `evaluate` that are no usable numbers are refused by name."""

import numpy as np
import pytest

import robustflow as rf
from robustflow.core.errors import UsageError
from robustflow.testing import ZeroFlow

OPTIONS = {name: name for name in ("workers", "batch_size", "timeout", "limit", "draws")}


@pytest.mark.parametrize("option", [*OPTIONS, "seed", "severities"])
@pytest.mark.parametrize("value", ["2", 0.5, True, -1, [2, "3"], float("nan")])
def test_argument_that_is_not_a_usable_number_is_refused(tmp_path, option, value):
    if (option, value) in (("timeout", 0.5), ("seed", -1)):
        pytest.skip("this value is valid")
    with pytest.raises(UsageError) as refused:
        rf.evaluate(ZeroFlow(), "demo", output=tmp_path, **{"corruptions": "contrast", option: value})
    assert OPTIONS.get(option, "") in str(refused.value)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("option", ["batch_size", "limit"])
def test_whole_number_of_numpy_is_accepted(tmp_path, option):
    options = {"corruptions": "contrast", "severities": 1, option: np.int64(1)}
    assert rf.evaluate(ZeroFlow(), "demo", output=tmp_path, **options).rcre == 0
