"""Check the options of models and runs, whose values the command line has already parsed as numbers and booleans."""

from __future__ import annotations

from numbers import Integral, Real

from ..errors import UsageError

MOST_THREADS = 1024
"""Maximum number of CPU threads of a network. Libraries crash with many more threads than processors."""


def check_count(name: str, value: int, least: int = 1, most: int | None = None) -> None:
    """Raise a UsageError unless a value is an integer of at least `least` and at most `most`.

    Args:
        name: name of the option, for the message.
        value: value of the option; True is not accepted as 1.
        least, most: minimum and maximum value; None for no maximum.

    Raises:
        UsageError: the value is invalid.

    >>> check_count("iterations", 12)
    >>> check_count("iterations", 1.5)
    Traceback (most recent call last):
    robustflow.errors.UsageError: iterations must be an integer of at least 1, not 1.5
    """
    if (
        not isinstance(value, Integral)
        or isinstance(value, bool)
        or value < least
        or (most is not None and value > most)
    ):
        allowed = f"of at least {least}" if most is None else f"from {least} to {most}"
        raise UsageError(f"{name} must be an integer {allowed}, not {value!r}")


def check_positive(name: str, value: float) -> None:
    """Raise a UsageError unless a value is a positive number; NaN, True and texts are not accepted.

    >>> check_positive("timeout", 0.5)
    """
    if isinstance(value, bool) or not isinstance(value, Real) or not value > 0:
        raise UsageError(f"{name} must be a positive number, not {value!r}")


def check_switch(name: str, value: bool) -> None:
    """Raise a UsageError unless a value is a bool; a non-empty string such as "no" would be treated as true.

    Args:
        name: name of the option, for the message.
        value: value of the option.

    Raises:
        UsageError: the value is invalid.

    >>> check_switch("compile", False)
    """
    if not isinstance(value, bool):
        raise UsageError(f"{name} must be true or false, not {value!r}")
