"""The five severities, and how one is checked."""

from __future__ import annotations

from .errors import UsageError

SEVERITIES = (1, 2, 3, 4, 5)


def check_severity(severity: int) -> int:
    """Return `severity` if it exists.

    >>> check_severity(6)
    Traceback (most recent call last):
    robustflow.errors.UsageError: severity 6 does not exist: choose 1 (mild) to 5 (severe)
    """
    if isinstance(severity, bool) or severity not in SEVERITIES:
        raise UsageError(f"severity {severity!r} does not exist: choose 1 (mild) to 5 (severe)")
    return int(severity)
