"""A child process of a caller that may have none is refused."""

from __future__ import annotations

import multiprocessing

import pytest

from robustflow.core.errors import UsageError
from robustflow.core.processes import Child


def test_child_of_a_worker_of_a_pool_is_refused():
    with multiprocessing.get_context("fork").Pool(1) as pool, pytest.raises(UsageError, match="ProcessPoolExecutor"):
        pool.apply(Child, (print,))
