"""Call native code in forked children, so that a crash is a result."""

from __future__ import annotations

import faulthandler
import os
import signal
import sys
import traceback
import warnings
from collections.abc import Callable, Iterable, Iterator
from itertools import islice
from typing import TypeVar

from robustflow.core.errors import RobustFlowError

Case = TypeVar("Case")


def outcomes(call: Callable[[Case], object], cases: Iterable[Case], together: int = 1) -> Iterator[tuple[Case, str]]:
    """Yield how each call ends: "returned", "refused" by an error of this package, "raised" another error, or the name
    of the signal. A child makes up to `together` calls; after a crash, the next one continues.
    """
    waiting = iter(cases)
    while batch := list(islice(waiting, together)):
        while batch:
            ends = _in_child(call, batch)
            yield from zip(batch, ends, strict=False)
            batch = batch[len(ends) :]


def _in_child(call: Callable[[Case], object], batch: list[Case]) -> list[str]:
    reading, writing = os.pipe()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # Python warns of forks while other threads run
        child = os.fork()
    if not child:
        faulthandler.disable()
        signal.alarm(600)  # a call that never returns
        for case in batch:
            try:
                call(case)
                end = "returned"
            except RobustFlowError:
                end = "refused"
            except BaseException:
                print(case, traceback.format_exc(), file=sys.stderr, flush=True)
                end = "raised"
            os.write(writing, f"{end}\n".encode())
        os._exit(0)
    os.close(writing)
    with open(reading) as pipe:
        ends = pipe.read().split()
    status = os.waitpid(child, 0)[1]
    return [*ends, signal.Signals(os.WTERMSIG(status)).name] if os.WIFSIGNALED(status) else ends
