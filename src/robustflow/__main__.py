"""Entry point of the command `robustflow` and of `python -m robustflow`, which `torchrun -m robustflow` needs."""

import _signal  # type: ignore[import-not-found]  # `signal` itself imports more
import gc
import sys

_NEW_OBJECTS = 10_000
"""Number of new objects after which the garbage collector runs; with Python's 700, it runs 349 times in the imports."""


def main() -> None:
    """Run the command line. Ctrl-C during the imports ends the process without a traceback."""
    interrupt = _signal.getsignal(_signal.SIGINT)
    if interrupt is _signal.default_int_handler:  # a background process ignores the signal
        _signal.signal(_signal.SIGINT, _signal.SIG_DFL)
    gc.set_threshold(_NEW_OBJECTS)
    from .cli.main import main as command_line
    from .core import output

    _signal.signal(_signal.SIGINT, interrupt)
    try:
        command_line()
    finally:
        output.end_results()
        if "torch" not in sys.modules:  # triton prints a warning about each of its objects that is not collected
            gc.freeze()  # otherwise Python searches all objects for garbage before it exits: 0.6 s after a run


if __name__ == "__main__":
    if not sys.flags.safe_path and not __file__.startswith(f"{sys.path[0]}/robustflow/"):
        del sys.path[0]  # the working folder is untrusted
    main()
