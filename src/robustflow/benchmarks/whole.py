"""Warn if data are not all of a benchmark of the paper, because its name is the title of the results."""

from __future__ import annotations

import warnings
from collections.abc import Sequence

from ..text import first_of

_MOST_NAMED = 20


def warn_unless_whole(title: str, noun: str, wanted: Sequence[str], evaluated: Sequence[str], remedy: str = "") -> None:
    """Warn if the evaluated pairs or sequences are not those of a benchmark."""
    missing = [name for name in wanted if name not in set(evaluated)]
    others = len(set(evaluated) - set(wanted))
    remarks = []
    if missing:
        remarks.append(
            f"{len(missing)} of {title}'s {len(wanted)} {noun}s are missing ({first_of(missing, _MOST_NAMED)})"
        )
    if others:
        remarks.append(
            f"{others} of the {len(evaluated)} evaluated {'is' if others == 1 else 'are'} not part of {title}"
        )
    if remarks:
        warn_incomplete(title, ", and ".join(remarks), remedy)


def warn_incomplete(title: str, what: str, remedy: str = "") -> None:
    """Warn that results on these data are not results on a benchmark."""
    warnings.warn(f"{what}; the result is not a {title} result{remedy}", stacklevel=5)
