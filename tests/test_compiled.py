"""Test the cache of compiled functions when several processes fill it at the same time."""

import importlib.util
import subprocess
import sys

import numpy as np

_SOURCE = """
from robustflow.compiled import njit

@njit(cache=True)
def total(x):
    result = 0
    for i in range(x.shape[0]):
        for j in range(x.shape[1]):
            result += x[i, j]
    return result
"""


def test_cache_filled_by_two_processes_holds_both_signatures(tmp_path):
    """Neither process sees the index written by the other, as when both compile at the same time."""
    (tmp_path / "summed.py").write_text(_SOURCE)
    contiguous = np.arange(12).reshape(3, 4)
    strided = contiguous[:, ::2]

    def process():
        spec = importlib.util.spec_from_file_location("summed", tmp_path / "summed.py")
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        return module.total

    process()(strided)
    index = {path: path.read_bytes() for path in tmp_path.rglob("*.nbi")}
    for path in index:
        path.unlink()
    process()(contiguous)
    for path, written in index.items():
        path.write_bytes(written)

    third = process()
    assert third(strided) == strided.sum()
    assert third(contiguous) == contiguous.sum()
    assert sum(third.stats.cache_hits.values()) == 2


def test_importing_what_reads_runs_compiles_nothing():
    """A function compiled at import costs each process 50 MiB, even if the process never calls it."""
    script = (
        "from numba.core.dispatcher import Dispatcher\n"
        "compiled, of = [], Dispatcher.compile\n"
        "Dispatcher.compile = lambda self, types: (compiled.append(self.py_func.__name__), of(self, types))[1]\n"
        "import robustflow.runs.run\n"
        "print(compiled)"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
