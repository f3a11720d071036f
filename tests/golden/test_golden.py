"""Golden runs give the stored rows, means, identities and comparison, and corruptions the stored bytes. Values and
digests, never prose.

After a deliberate change, raise STREAM_VERSION, ROW_SCHEMA_VERSION or IDENTITY_VERSION where it applies and rewrite the
file with `python -m tests.rewrite`.
"""

from __future__ import annotations

import json
from functools import cache
from typing import Any

import pytest

from robustflow.corruptions.machine_check import CHECKED

from . import corrupted
from .record import STORED, comparison, record
from .runs import GOLDEN_RUNS


@cache
def stored() -> dict[str, Any]:
    """The stored records by the run's name."""
    return json.loads(STORED.read_text(encoding="utf-8"))


@pytest.mark.parametrize("name", GOLDEN_RUNS)
def test_run_gives_the_stored_identity_rows_and_means(name, tmp_path):
    assert record(GOLDEN_RUNS[name].run(tmp_path)) == stored()[name]


def test_comparison_of_two_runs_gives_the_stored_differences_and_intervals(tmp_path):
    found = comparison(tmp_path)
    assert found.keys() == stored()["comparison"].keys()
    for at, numbers in stored()["comparison"].items():
        assert found[at] == pytest.approx(numbers, rel=1e-9), at  # logarithms differ by an ulp between processors


@pytest.mark.parametrize("name", CHECKED)
def test_corrupted_pairs_of_odd_sizes_have_the_stored_bytes(name):
    assert corrupted.digests_of(name) == json.loads(corrupted.STORED.read_text(encoding="utf-8"))[name]
