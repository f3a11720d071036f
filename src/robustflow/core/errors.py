"""The exceptions: one root class; a message states the problem, its location, and the remedy, on one line."""

from __future__ import annotations

import re
import signal
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from difflib import get_close_matches
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pydantic import ValidationError


_names_options = False

_PROGRAM = r"\b(?:robustflow|ray|git|pip|python -m) [a-z][^;,)]*"
_VALUE = r"(?!(?:or|and)\b)[^\s=,;()]+(?=[,;)]|$| --)"
_OPTION = re.compile(rf"({_PROGRAM})|(?<![\w-])(?:-[A-Z] |--([a-z][a-z-]+)(?:[ =]({_VALUE}))?)")
_RENAMED = {"seeds": "draws", "data_option": "data_options"}


@contextmanager
def options_named(named: bool = True) -> Iterator[None]:
    """Name options of the command line in errors that are raised within the block; elsewhere, errors name the arguments
    of Python's functions."""
    global _names_options
    before, _names_options = _names_options, named
    try:
        yield
    finally:
        _names_options = before


def names_options() -> bool:
    """Return whether errors name options of the command line."""
    return _names_options


def as_argument(text: Any) -> Any:
    """Write the options in a message as arguments in Python, unless they belong to a command or the command line is
    running.

    >>> as_argument("--batch-size"), as_argument("use --engine ray, or omit --workers")
    ('batch_size', "use engine='ray', or omit workers")
    >>> as_argument("see robustflow list --help")
    'see robustflow list --help'
    """
    return text if _names_options or not isinstance(text, str) else _OPTION.sub(_argument, text)


def _argument(option: re.Match[str]) -> str:
    command, flag, value = option.groups()
    name = (flag or "").replace("-", "_")
    name = _RENAMED.get(name, name)
    literal = value if value is None or value.isupper() or value[0].isdigit() else repr(value)
    return command or (name if value is None else f"{name}={literal}")


class RobustFlowError(Exception):
    """Base class of all exceptions that RobustFlow raises on purpose: `Error(culprit, sentence)`, or `Error(sentence)`
    where nothing in particular is at fault.

    >>> error = DataError("a.flo", "truncated; copy it again")
    >>> print(error, "|", error.culprit, "|", error.code)
    a.flo: truncated; copy it again | a.flo | data
    """

    code = "error"
    """Kind of the error, the same in every version: "usage", "data", "asset", "model" or "run"."""
    exit_code = 1
    """Exit code of the command line."""

    def __init__(self, *parts: object) -> None:
        super().__init__(*map(as_argument, parts))
        self.culprit = str(self.args[0]) if len(parts) > 1 else ""
        """Path, option, key or name that is at fault; "" if there is none."""

    def __str__(self) -> str:
        return ": ".join(map(str, self.args))


class UsageError(RobustFlowError, ValueError):
    """An argument is invalid: an unknown name, a severity of 6, or mutually exclusive options."""

    code = "usage"
    exit_code = 2


class DataError(RobustFlowError):
    """A file or folder is missing, damaged, or not of the expected kind."""

    code = "data"


class AssetError(RobustFlowError):
    """Something that a corruption, model or command needs (textures, weights, a library) is not installed."""

    code = "asset"


class ModelError(RobustFlowError):
    """A model cannot be loaded, or returned something other than optical flow."""

    code = "model"


class RunError(RobustFlowError):
    """A run folder cannot be used: it is locked, not writable, has a different schema, or belongs to a different
    run."""

    code = "run"


def unknown_name(kind: str, name: str, known: Iterable[str]) -> UsageError:
    """Return the error for an unknown name, with suggestions of similar known names.

    >>> print(unknown_name("corruption", "gausian_noise", ["gaussian_noise", "fog"]))
    unknown corruption 'gausian_noise': did you mean 'gaussian_noise'? Known: gaussian_noise, fog
    >>> print(unknown_name("model", "RAFT", ["dis", "raft"]))
    unknown model 'RAFT': did you mean 'raft'? Known: dis, raft
    >>> print(unknown_name("metric", "error", ["epe", "cre"]))
    unknown metric 'error'. Known: epe, cre
    """
    names = list(known)
    as_lower = {candidate.lower(): candidate for candidate in reversed(names)}
    longer = [candidate for candidate in names if len(name) > 2 and name.lower() in candidate.lower()][:3]
    close = longer or [as_lower[candidate] for candidate in get_close_matches(name.lower(), as_lower, n=1, cutoff=0.5)]
    hint = f": did you mean {' or '.join(map(repr, close))}?" if close else "."
    error = UsageError(f"unknown {kind} '{name}'{hint} Known: {', '.join(names) or 'none'}")
    error.culprit = name
    return error


def first_misfit(error: ValidationError, whole: str = "the file") -> str:
    """Describe where data first deviates from the expected schema, and why, without quoting the data, which may be
    hostile.

    Args:
        error: pydantic's validation error.
        whole: the name of the data as a whole, for errors that do not concern a specific field.

    >>> from pydantic import TypeAdapter, ValidationError
    >>> try:
    ...     TypeAdapter(dict[str, int]).validate_python({"severity": "high"})
    ... except ValidationError as error:
    ...     print(first_misfit(error))
    severity: Input should be a valid integer, unable to parse string as an integer
    """
    first = error.errors(include_input=False, include_url=False)[0]
    return f"{'.'.join(map(str, first['loc'])) or whole}: {first['msg']}"


def first_line(error: BaseException) -> str:
    """Return the first line of an error's message, to be quoted in ours, or its class name if the message is empty.

    >>> first_line(ValueError("bad magic\\nat byte 3")), first_line(EOFError())
    ('bad magic', 'EOFError')
    """
    return next(iter(str(error).splitlines()), type(error).__name__)


def class_and_message(error: BaseException) -> str:
    """Describe an exception on one line, even if its class is a user's and cannot give its message.

    >>> class_and_message(ValueError("no weights\\nat all")), class_and_message(EOFError())
    ('ValueError: no weights at all', 'EOFError: no message')
    """
    message = ""
    with suppress(Exception):
        message = " ".join(str(error).split())
    return f"{type(error).__name__}: {message or 'no message'}"


class StoppedError(BaseException):
    """Raised inside a user's code to end its thread, because its result is no longer needed."""


def raise_interrupt(error: BaseException) -> None:
    """Raise Ctrl-C again if a user's code was interrupted; a KeyboardInterrupt where Ctrl-C is ignored, as in a worker,
    is raised by the code, as may be any other exception."""
    of_ctrl_c = isinstance(error, KeyboardInterrupt)
    if isinstance(error, StoppedError) or (of_ctrl_c and signal.getsignal(signal.SIGINT) != signal.SIG_IGN):
        raise error


def plain_warning(message: Warning | str, *_: object, **__: object) -> str:
    """Format a warning as one line, without its location in the code. For `warnings.formatwarning`.

    >>> plain_warning(UserWarning("nothing was changed"), UserWarning, "cache.py", 66)
    'robustflow: warning: nothing was changed\\n'
    """
    return f"robustflow: warning: {' '.join(str(message).split())}\n"
