"""A run with attacks whose model kills its own process, for `test_runs`.

    python killed_run.py FOLDER [PREDICTIONS...]

For each number of predictions, the script starts a child process that is killed after that prediction; the last child
is not killed.
"""

import os
import signal
import sys
from itertools import count

import robustflow as rf
import robustflow.api
from robustflow.data.benchmarks import Benchmark
from robustflow.testing import BrightnessFlow, TexturePairs


class Deadly(BrightnessFlow):
    """Kills its process at a given prediction."""

    def __init__(self, last):
        self.calls, self.last = count(1), last

    def predict(self, frame1, frame2):
        if next(self.calls) == self.last:
            os.kill(os.getpid(), signal.SIGKILL)
        return super().predict(frame1, frame2)


def run(folder, last):
    data = TexturePairs(2, (24, 32))
    benchmark = Benchmark("drawn", data, data.keys(), ("contrast",), (1, 3))
    return rf.evaluate(Deadly(last), benchmark, output=folder, attacks="square:queries=9", corruptions="contrast")


def main():
    robustflow.api._write_report = lambda *_: None
    for last in (*map(int, sys.argv[2:]), 0):
        child = os.fork()
        if not child:
            try:
                run(sys.argv[1], last)
            except BaseException:
                os._exit(3)
            os._exit(0)
        status = os.waitpid(child, 0)[1]
        expected = os.WIFSIGNALED(status) if last else os.WIFEXITED(status) and os.WEXITSTATUS(status) == 0
        if not expected:
            raise SystemExit(f"the child to be killed at prediction {last} ended with status {status}")


if __name__ == "__main__":
    main()
