"""Check the options of models and runs, whose values the command line has already parsed as numbers and booleans."""

from __future__ import annotations

from numbers import Integral, Real

from ..errors import UsageError

MOST_THREADS = 1024
"""Maximum number of CPU threads of a network. Libraries crash with many more threads than processors."""


def check_count(name: str, value: int, least: int = 1, most: int | None = None) -> None:
    """Raise a UsageError unless a value is an integer of at least `least` and at most `most`."""
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
    """Raise a UsageError unless a value is a bool; a non-empty string such as "no" would be treated as true."""
    if not isinstance(value, bool):
        raise UsageError(f"{name} must be true or false, not {value!r}")
