"""Every corruption with its own place in tables and figures: the paper's, then those that exist only as files.

Results are grouped and ordered by these names; what can be computed is in `registry`.
"""

from __future__ import annotations

from collections.abc import Iterable

from .on_disk import SETS
from .registry import FAMILIES

MEMBERS: dict[str, tuple[str, ...]] = {
    family: (*names, *(each.local_name(own) for each in SETS for own in each.families.get(family, ())))
    for family, names in FAMILIES.items()
}
"""Family -> its corruptions. No benchmark has both a paper's corruption and one of files, so no mean mixes them."""

ORDER: tuple[str, ...] = (
    *(name for names in FAMILIES.values() for name in names),
    *(name for each in SETS for name in each.names),
)
_PLACE = {name: place for place, name in enumerate(ORDER)}
_FAMILY = {name: family for family, names in MEMBERS.items() for name in names}


def family_of(name: str) -> str | None:
    """The family of a corruption; None for one without: elastic_transform, a stack, a user's own.

    >>> family_of("fog"), family_of("robustspring_rain"), family_of("elastic_transform")
    ('weather', 'weather', None)
    """
    return _FAMILY.get(name)


def ordered(names: Iterable[str]) -> list[str]:
    """Corruptions in the order of tables: those of `ORDER`, then the others by name.

    >>> ordered(["rain", "robustspring_fog", "fog", "contrast"])
    ['contrast', 'fog', 'robustspring_fog', 'rain']
    """
    return sorted(names, key=lambda name: (_PLACE.get(name, len(_PLACE)), name))
