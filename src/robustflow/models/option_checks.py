"""Checks of a model's options. The command line has turned text into numbers and truth values."""

from __future__ import annotations

from ..errors import UsageError


def check_count(name: str, value: int, least: int = 1) -> None:
    """Raise unless a value is a whole number, `least` or more.

    Args:
        name: of the option, for the message.
        value: as it was given; True is not 1.
        least: the smallest allowed value.

    Raises:
        UsageError: something else.

    >>> check_count("iterations", 12)
    >>> check_count("iterations", 1.5)
    Traceback (most recent call last):
    robustflow.errors.UsageError: iterations must be a whole number from 1, not 1.5
    """
    if not isinstance(value, int) or isinstance(value, bool) or value < least:
        raise UsageError(f"{name} must be a whole number from {least}, not {value!r}")


def check_switch(name: str, value: bool) -> None:
    """Raise unless a value is true or false; "no" would count as true.

    Args:
        name: of the option, for the message.
        value: as it was given.

    Raises:
        UsageError: something else.

    >>> check_switch("compile", False)
    """
    if not isinstance(value, bool):
        raise UsageError(f"{name} must be true or false, not {value!r}")
