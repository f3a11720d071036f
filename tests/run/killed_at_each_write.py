"""For each write operation, start a run in a child process and kill it at that operation
(see `test_killed`).

    python killed_at_each_write.py FOLDER

Polars is not used before the fork, because its threads would not survive in the child.
"""

import os
import pathlib
import signal
import sys
from itertools import count
from pathlib import Path

import robustflow as rf
import robustflow.api
import robustflow.run.compute_missing
import robustflow.run.data_files
from robustflow.data.benchmarks import Benchmark
from robustflow.testing import BrightnessFlow, TexturePairs


def run(folder):
    """The run that is killed and resumed; it has no report, because a report takes longer than everything else."""
    robustflow.api._write_report = lambda *_: None
    benchmark = Benchmark("drawn", TexturePairs(3, (24, 32)), ("0", "1", "2"), ("contrast", "high_light"), (1, 2))
    return rf.evaluate(BrightnessFlow(), benchmark, output=folder)


def kill_before(call):
    """Kill this process without warning just before file system change number `call`."""
    calls = count()

    def killing(function):
        def changed(*arguments, **options):
            if next(calls) == call:
                os.kill(os.getpid(), signal.SIGKILL)
            return function(*arguments, **options)

        return changed

    os.replace = killing(os.replace)
    os.fsync = killing(os.fsync)
    pathlib.Path.unlink = killing(pathlib.Path.unlink)
    pathlib.Path.mkdir = killing(pathlib.Path.mkdir)


def main():
    home = Path(sys.argv[1])
    for call in count():
        child = os.fork()
        if not child:
            try:
                kill_before(call)
                run(home / str(call))
            except BaseException:
                os._exit(3)
            os._exit(0)
        status = os.waitpid(child, 0)[1]
        if os.WIFEXITED(status):
            sys.exit(os.WEXITSTATUS(status))


if __name__ == "__main__":
    main()
