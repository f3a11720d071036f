"""Results written by other benchmarks' programs, as lines of tables.

They are means without the rows behind them, so nothing in them can be checked: every line says so (`NOTE`).
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ...errors import DataError
from ..model_result import ModelResult
from . import flowbench, reference
from .json_file import read_json_file

NOTE = "imported, not verifiable: no seed, no rows"
"""What every imported line says."""


def read_imported(paths: Sequence[Path]) -> list[ModelResult]:
    """Read result files (JSON) of the paper's reference code and of FlowBench, which are recognised by their content.

    Args:
        paths: of files. FlowBench writes a file for each corruption; all that are given are read as one.

    Returns:
        A line for each model; a sample set is what was written by one program, on one data set, under the
        same corruptions and severities.

    Raises:
        DataError: a file that cannot be read, is neither of the two, or holds what such a file cannot hold.
    """
    benchmarks: list[reference.Results] = []
    experiments: list[flowbench.Experiment] = []
    for path in paths:
        content = read_json_file(path)
        if reference.is_reference(content):
            benchmarks.append(reference.parse(content, path))
        elif flowbench.is_flowbench(content):
            experiments += flowbench.parse(content, path)
        else:
            raise DataError(
                f"{path}: neither results.json of the reference code nor metrics_DATASET.json of FlowBench; name "
                "results as CSV, or a run's folder or record"
            )
    return [*reference.lines(benchmarks, NOTE), *flowbench.lines(experiments, NOTE)]
