"""The cells of a run: which samples it measures, under which corruptions and attacks, at which severities.

Calls may ask for different conditions on different samples, so a plan is a list of `Cells`: every sample is in exactly
one of them, together with the samples that are measured under the same conditions.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from itertools import chain, pairwise
from typing import Annotated

import polars as pl
from pydantic import AfterValidator, Field

from ..core.types import Untrusted
from ..metrics.rows import CLEAN
from .identity import Text

_Conditions = tuple[frozenset[tuple[str, tuple[int, ...]]], ...]

Cell = tuple[str, str, int]
"""The sample key, corruption and severity of a row."""

UNEVEN = "not all at the same severities and on the same pairs"
"""Remark about a mean over corruptions, see `Manifest.uneven`."""


def _ascending(levels: tuple[int, ...]) -> tuple[int, ...]:
    if any(one >= other for one, other in pairwise(levels)):
        raise ValueError("severities must be ascending and different")
    return levels


Levels = Annotated[
    tuple[Annotated[int, Field(ge=1, le=5)], ...], Field(min_length=1, max_length=5), AfterValidator(_ascending)
]


class Cells(Untrusted):
    """Some samples, each measured on the clean frames and under the same conditions."""

    samples: tuple[Text, ...]
    corruptions: dict[Text, Levels] = {}
    attacks: dict[Text, Levels] = {}

    def corrupted(self) -> Iterator[Cell]:
        """Yield every cell except those of attacks; clean cells as (sample, "clean", 0)."""
        levels = {CLEAN: (0,), **self.corruptions}
        return ((key, name, level) for key in self.samples for name in levels for level in levels[name])

    def attacked(self) -> Iterator[Cell]:
        """Yield every cell of an attack."""
        levels = self.attacks
        return ((key, name, level) for key in self.samples for name in levels for level in levels[name])

    def every(self) -> Iterator[Cell]:
        """Yield every cell."""
        return chain(self.corrupted(), self.attacked())

    def count(self, attacks: bool = True) -> int:
        """Return the number of cells, with or without those of attacks, without listing them."""
        levels = (*self.corruptions.values(), *(self.attacks.values() if attacks else ()))
        return len(self.samples) * (1 + sum(map(len, levels)))

    def has(self, condition: str, severity: int) -> bool:
        """Return whether a condition is among those of these samples."""
        levels = {CLEAN: (0,), **self.corruptions, **self.attacks}
        return severity in levels.get(condition, ())

    def among(self, keys: Iterable[str]) -> Cells:
        """Return the same conditions of other samples."""
        return self.model_copy(update={"samples": tuple(keys)})

    def contain(self) -> pl.Expr:
        """Return an expression that selects the rows of these cells."""
        of_level: dict[tuple[int, ...], list[str]] = {(0,): [CLEAN]}
        for name, levels in (*self.corruptions.items(), *self.attacks.items()):
            of_level.setdefault(levels, []).append(name)
        conditions = (
            pl.col("corruption").is_in(names) & pl.col("severity").is_in(levels) for levels, names in of_level.items()
        )
        return pl.col("sample").is_in(self.samples) & pl.any_horizontal(*conditions)


def union(every: Iterable[Cells]) -> tuple[Cells, ...]:
    """Return the same cells, with every sample in exactly one of the parts, and no two parts with equal conditions. The
    time is linear in the number of samples and conditions."""
    of_sample: dict[str, Cells] = {}
    parts: dict[_Conditions, Cells] = {}

    def shared(part: Cells) -> Cells:
        """Return the one object with these conditions."""
        return parts.setdefault((frozenset(part.corruptions.items()), frozenset(part.attacks.items())), part.among(()))

    for asked in every:
        alone, together = shared(asked), dict[int, Cells]()
        for key in asked.samples:
            before = of_sample.get(key, alone)
            if id(before) not in together:
                corruptions = merged_levels(before.corruptions, asked.corruptions)
                attacks = merged_levels(before.attacks, asked.attacks)
                together[id(before)] = shared(Cells(samples=(), corruptions=corruptions, attacks=attacks))
            of_sample[key] = together[id(before)]
    samples: dict[int, list[str]] = {}
    for key, part in of_sample.items():
        samples.setdefault(id(part), []).append(key)
    return tuple(part.among(samples[id(part)]) for part in parts.values() if id(part) in samples)


def parts_of(cells: Iterable[Cell], attacks: Collection[str]) -> tuple[Cells, ...]:
    """Return some cells as parts; every sample has its clean cell."""
    of_sample: dict[str, dict[str, list[int]]] = {}
    for key, name, level in cells:
        levels = of_sample.setdefault(key, {})
        if name != CLEAN:
            levels.setdefault(name, []).append(level)
    return union(
        Cells(
            samples=(key,),
            corruptions={name: tuple(sorted(given)) for name, given in levels.items() if name not in attacks},
            attacks={name: tuple(sorted(given)) for name, given in levels.items() if name in attacks},
        )
        for key, levels in sorted(of_sample.items())
    )


def merged_levels(
    one: Mapping[str, tuple[int, ...]], other: Mapping[str, tuple[int, ...]]
) -> dict[str, tuple[int, ...]]:
    """Return the severities that are in either of two mappings, by condition.

    >>> merged_levels({"fog": (3,)}, {"snow": (2,), "fog": (1,)})
    {'fog': (1, 3), 'snow': (2,)}
    """
    return {name: tuple(sorted({*one.get(name, ()), *other.get(name, ())})) for name in {**one, **other}}


def left_out_sentence(left_out: Mapping[str, Sequence[int]]) -> str:
    """Describe which severities a run omits.

    >>> left_out_sentence({"saturate": [5], "h264_crf": [1, 2]})
    'the calibrated scale has no saturate at severity 5, h264_crf at severity 1, 2'
    """
    each = ", ".join(f"{name} at severity {', '.join(map(str, levels))}" for name, levels in left_out.items())
    return f"the calibrated scale has no {each}"
