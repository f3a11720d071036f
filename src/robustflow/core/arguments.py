"""Check what a user passes: a choice, a number, a switch, a severity, a size."""

from __future__ import annotations

from collections.abc import Sequence
from numbers import Integral, Real

from .errors import UsageError

SEVERITIES = (1, 2, 3, 4, 5)


def check_severity(severity: int) -> int:
    """Return `severity`; raise a UsageError if it is not a valid severity.

    >>> check_severity(6)  # doctest: +IGNORE_EXCEPTION_DETAIL
    Traceback (most recent call last):
    robustflow.core.errors.UsageError: severity 6 does not exist: choose 1 (mild) to 5 (severe)
    """
    if isinstance(severity, bool | str | list | tuple | dict) or severity not in SEVERITIES:
        hint = "" if isinstance(severity, int | float) else ", an integer"
        error = UsageError(f"severity {severity!r} does not exist: choose 1 (mild) to 5 (severe){hint}")
        error.culprit = str(severity)
        raise error
    return int(severity)


def parse_size(text: str, multiple: int = 1, smallest: int = 1, largest: int = 99_999) -> tuple[int, int]:
    """Parse a text such as "256x832" into height and width, in pixels."""
    height, cross, width = str(text).lower().partition("x")
    if not (cross and all(side.isdecimal() and len(side) <= 5 for side in (height, width))):
        raise UsageError(str(text)[:40], "not a size; write HEIGHTxWIDTH, for example 256x832")
    size = int(height), int(width)
    if any(side % multiple or not max(multiple, smallest) <= side <= largest for side in size):
        must = f"multiples of {multiple}" if multiple > 1 else f"{smallest} to {largest} pixels"
        raise UsageError(text, f"height and width must be {must}, for example 256x832")
    return size


def choice(option: str, value: str, known: Sequence[str]) -> str:
    """Return `value`; raise a UsageError that lists the allowed values if it is not one of them."""
    if value not in known:
        raise UsageError(option, f"'{value}' does not exist; choose from {', '.join(known)}")
    return value


def check_count(name: str, value: int, least: int = 1, most: int | None = None) -> None:
    """Raise a UsageError unless a value is an integer of at least `least` and at most `most`."""
    number = isinstance(value, Integral) and not isinstance(value, bool)
    if not number or value < least or (most is not None and value > most):
        allowed = f"of at least {least}" if most is None else f"from {least} to {most}"
        raise UsageError(name, f"must be an integer {allowed}, not {value!r}")


def check_positive(name: str, value: float) -> None:
    """Raise a UsageError unless a value is a positive number; NaN, True and texts are not accepted.

    >>> check_positive("timeout", 0.5)
    """
    if isinstance(value, bool) or not isinstance(value, Real) or not value > 0:
        raise UsageError(name, f"must be a positive number, not {value!r}")


def check_switch(name: str, value: bool) -> None:
    """Raise a UsageError unless a value is a bool; a non-empty string such as "no" would be treated as true."""
    if not isinstance(value, bool):
        raise UsageError(name, f"must be true or false, not {value!r}")
