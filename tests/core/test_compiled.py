"""Test the cache of compiled functions: filled by several processes at the same time, and damaged."""

import importlib.util
import random
import subprocess
import sys

import numpy as np
import pytest

_SOURCE = """
from robustflow.core.compiled import njit

@njit(cache=True)
def total(x):
    result = 0
    for i in range(x.shape[0]):
        for j in range(x.shape[1]):
            result += x[i, j]
    return result
"""


@pytest.fixture
def process(tmp_path):
    """Return a compiled function as a new process imports it: `process()`."""
    (tmp_path / "summed.py").write_text(_SOURCE)

    def imported():
        spec = importlib.util.spec_from_file_location("summed", tmp_path / "summed.py")
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        return module.total

    return imported


def test_cache_filled_by_two_processes_holds_both_signatures(tmp_path, process):
    """Neither process sees the index written by the other, as when both compile at the same time."""
    contiguous = np.arange(12).reshape(3, 4)
    strided = contiguous[:, ::2]
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


def test_cached_code_with_a_flipped_bit_is_compiled_again(tmp_path, process):
    values = np.arange(12).reshape(3, 4)
    first = process()
    assert first(values) == 66
    (path,) = tmp_path.rglob("*.nbc")
    whole = path.read_bytes()
    key = first._cache._index_key(first.signatures[0], first.targetctx.codegen())
    draw = random.Random(0)
    for _ in range(100):
        at = draw.randrange(len(whole))
        path.write_bytes(whole[:at] + bytes([whole[at] ^ 1 << draw.randrange(8)]) + whole[at + 1 :])
        assert first._cache._cache_file.load(key) is None
    second, third = process(), process()
    assert (second(values), sum(second.stats.cache_hits.values())) == (66, 0)
    assert (third(values), sum(third.stats.cache_hits.values())) == (66, 1)


def test_importing_what_reads_runs_compiles_nothing():
    """A function compiled at import costs each process 50 MiB, even if the process never calls it."""
    script = (
        "from numba.core.dispatcher import Dispatcher\n"
        "compiled, of = [], Dispatcher.compile\n"
        "Dispatcher.compile = lambda self, types: (compiled.append(self.py_func.__name__), of(self, types))[1]\n"
        "import robustflow.run.run\n"
        "print(compiled)"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
