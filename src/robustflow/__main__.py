"""Entry point of the command `robustflow` and of `python -m robustflow`, which `torchrun -m robustflow` needs."""

import _signal  # type: ignore[import-not-found]  # `signal` itself imports more
import sys


def main() -> None:
    """Run the command line. Ctrl-C during the imports ends the process without a traceback."""
    interrupt = _signal.getsignal(_signal.SIGINT)
    if interrupt is _signal.default_int_handler:  # a background process ignores the signal
        _signal.signal(_signal.SIGINT, _signal.SIG_DFL)
    from .cli.main import main as command_line

    _signal.signal(_signal.SIGINT, interrupt)
    command_line()


if __name__ == "__main__":
    if not sys.flags.safe_path and not __file__.startswith(f"{sys.path[0]}/robustflow/"):
        del sys.path[0]  # the working folder is untrusted
    main()
