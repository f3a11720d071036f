"""Import results written by the programs of other benchmarks, as lines of results tables.

These results are means without the underlying rows, so they cannot be verified. Every imported line has a note that
states this (`NOTE`).
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ...core.errors import DataError
from ..model_result import ModelResult
from . import flowbench, reference
from .flowbench import NOTE, read_json_file

__all__ = ["NOTE", "read_imported"]


def read_imported(paths: Sequence[Path]) -> list[ModelResult]:
    """Read JSON result files of the paper's reference code and of FlowBench, distinguished by their content."""
    benchmarks: list[ModelResult] = []
    experiments: list[flowbench.Experiment] = []
    for path in paths:
        content = read_json_file(path)
        if reference.is_reference(content):
            benchmarks.append(reference.parse(content, path))
        elif flowbench.is_flowbench(content):
            experiments += flowbench.parse(content, path)
        else:
            raise DataError(
                f"{path} is neither a results.json of the reference code nor a metrics_DATASET.json of FlowBench; "
                "give one of these, a CSV file of results, or a run's folder or record"
            )
    return [*benchmarks, *flowbench.lines(experiments)]
