"""Average values over families of corruptions."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TypeVar

from ..corruptions.names import MEMBERS

T = TypeVar("T")


def grouped_by_family(values: Mapping[str, T]) -> dict[str, list[T]]:
    """Group values by family of corruptions, in the paper's order, without empty families and without corruptions that
    have no family.

    >>> grouped_by_family({"snow": 2, "fog": 1, "elastic_transform": 3})
    {'weather': [1, 2]}
    """
    measured = {family: [values[name] for name in names if name in values] for family, names in MEMBERS.items()}
    return {family: members for family, members in measured.items() if members}


def family_crer(cre: Mapping[str, float], clean: float | None) -> dict[str, float]:
    """Return the CREr of each family: the mean CRE of its measured corruptions, divided by the clean EPE; empty if the
    clean EPE is 0 or unknown.
    """
    return {family: mean / clean for family, mean in family_means(cre).items()} if clean else {}


def family_means(values: Mapping[str, float]) -> dict[str, float]:
    """Average each family over its measured corruptions.

    >>> family_means({"snow": 2.0, "fog": 1.0})
    {'weather': 1.5}
    """
    return {family: math.fsum(members) / len(members) for family, members in grouped_by_family(values).items()}
