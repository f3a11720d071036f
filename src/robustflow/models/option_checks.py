"""Check the options of models, whose values the command line has already parsed as numbers and booleans."""

from __future__ import annotations

from ..errors import UsageError


def check_count(name: str, value: int, least: int = 1) -> None:
    """Raise a UsageError unless a value is an integer of at least `least`.

    Args:
        name: name of the option, for the message.
        value: value of the option; True is not accepted as 1.
        least: minimum value.

    Raises:
        UsageError: the value is invalid.

    >>> check_count("iterations", 12)
    >>> check_count("iterations", 1.5)
    Traceback (most recent call last):
    robustflow.errors.UsageError: iterations must be an integer of at least 1, not 1.5
    """
    if not isinstance(value, int) or isinstance(value, bool) or value < least:
        raise UsageError(f"{name} must be an integer of at least {least}, not {value!r}")


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
