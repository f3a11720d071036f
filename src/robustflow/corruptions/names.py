"""Order of the corruptions in tables and figures: first the paper's, then those that exist only as files.

Results are grouped and ordered using these names; `registry` lists the corruptions that can be computed.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from typing import Any

from ..errors import UsageError
from .on_disk import SETS
from .registry import CLIP, CORRUPTIONS, FAMILIES, FURTHER

MEMBERS: dict[str, tuple[str, ...]] = {
    family: (*names, *(each.local_name(own) for each in SETS for own in each.families.get(family, ())))
    for family, names in FAMILIES.items()
}
"""Corruptions by family. No benchmark contains both the paper's corruptions and corruptions from files, so they are
never averaged together.
"""

ORDER: tuple[str, ...] = (
    *(name for names in FAMILIES.values() for name in names),
    *(name for each in SETS for name in each.names),
)
_PLACE = {name: place for place, name in enumerate(ORDER)}
_FAMILY = {name: family for family, names in MEMBERS.items() for name in names}


def family_of(name: str) -> str | None:
    """Return the family of a corruption, or None for elastic_transform, stacks and user-defined corruptions.

    >>> family_of("fog"), family_of("robustspring_rain"), family_of("elastic_transform")
    ('weather', 'weather', None)
    """
    return _FAMILY.get(name)


def ordered(names: Iterable[str]) -> list[str]:
    """Return the corruptions in table order: those in `ORDER` first, then the remaining ones by name."""
    return sorted(names, key=lambda name: (_PLACE.get(name, len(_PLACE)), name))


ALL = "all"
"""In a list of names, selects all corruptions of the benchmark."""


def with_families(given: Iterable[Any], available: Collection[str]) -> list[Any]:
    """Replace "all" and names of families with the corruptions that they contain; keep everything else.

    >>> with_families(["noise", "fog:2+snow"], ["fog", "shot_noise", "impulse_noise"])
    ['shot_noise', 'impulse_noise', 'fog:2+snow']
    >>> with_families(["sensor"], ["fog"])
    ['raw_noise']
    """
    chosen: list[Any] = []
    for name in given:
        family = None if not isinstance(name, str) or name in CORRUPTIONS else MEMBERS.get(name) or FURTHER.get(name)
        members = available if name == ALL else family
        if members is None:
            chosen.append(name)
            continue
        fitting = [one for one in members if one in available or (name in ("depth", "sensor") and one not in CLIP)]
        if not fitting:
            raise UsageError(
                f"no corruption of the family '{name}' applies to these data; choose from {', '.join(available)}"
            )
        chosen += fitting
    return list(dict.fromkeys(chosen))
