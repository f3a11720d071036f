"""The five severities and the check for a valid one."""

from __future__ import annotations

from .errors import UsageError

SEVERITIES = (1, 2, 3, 4, 5)


def check_severity(severity: int) -> int:
    """Return `severity`; raise a UsageError if it is not a valid severity.

    >>> check_severity(6)
    Traceback (most recent call last):
    robustflow.core.errors.UsageError: severity 6 does not exist: choose 1 (mild) to 5 (severe)
    """
    if isinstance(severity, bool) or severity not in SEVERITIES:
        raise UsageError(f"severity {severity!r} does not exist: choose 1 (mild) to 5 (severe)")
    return int(severity)
