"""The benchmark class: samples, corruptions and severities."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from numbers import Real
from typing import TYPE_CHECKING, Any

from ...core.arguments import check_count, check_severity
from ...core.errors import UsageError, unknown_name
from ...core.paths import VIDEO_SUFFIXES
from ...corruptions import CLIP, SEVERITIES, Corruption, corruption_names, load_corruption
from ...corruptions.condition import Condition, condition_of
from ...corruptions.registry import ON_DISK, with_families
from ..datasets.dataset import Dataset, Depths, PreCorrupted, no_depth
from ..datasets.own_depth import OwnDepth
from ..datasets.own_frames import continuous
from ..datasets.still import Still
from .facts import NEUTRAL, NON_OCCLUDED, BenchmarkFacts, check_still, facts_of_still, still_name

if TYPE_CHECKING:
    from ...attacks.api import AnyAttack

AnyCorruption = str | Corruption | type[Corruption]
"""The name of a corruption, or a user-defined corruption as an object or a class."""


@dataclass(frozen=True)
class Benchmark:
    """The samples, corruptions and severities to evaluate.

    Attributes:
        name: name of the benchmark: "kitti-fc", "demo", "folder", ...
        dataset: dataset that provides the samples.
        keys: keys of the samples, in order.
        corruptions: the corruptions, in the paper's order.
        severities: severities to evaluate; 1 to 5 unless restricted.
        protocol: everything else that determines the numbers (split, ground truth), for the run's identity.
        closed: whether the corrupted frames come from files, in which case no additional corruption or severity can be
            requested.
        classes: mapping from a corruption's name to its class, for classes that differ from the registered one.
        attacks: adversarial attacks on the model, at the same severities; empty unless requested.
        facts: title, availability of ground truth, and the paper's settings.
        own_depth: the user's depth maps; without them, depth comes from the dataset if available.
    """

    name: str
    dataset: Dataset
    keys: tuple[str, ...]
    corruptions: tuple[str, ...]
    severities: tuple[int, ...] = SEVERITIES
    protocol: dict[str, Any] = field(default_factory=dict)
    closed: bool = False
    classes: Mapping[str, type[Corruption]] = field(default_factory=dict)
    attacks: tuple[str, ...] = ()
    facts: BenchmarkFacts = NEUTRAL
    own_depth: OwnDepth | None = None

    @cached_property
    def conditions(self) -> tuple[Condition, ...]:
        """Return the corruptions as their names describe them."""
        return tuple(map(condition_of, self.corruptions))

    @property
    def depths(self) -> Depths | None:
        """Return the source of depth for the samples, or None if there is no depth."""
        if self.own_depth is not None and not isinstance(self.dataset, Still):
            return self.own_depth
        return self.dataset if isinstance(self.dataset, Depths) else None

    def depth_to_read(self) -> Depths | None:
        """Return the source of depth if a corruption of the benchmark needs depth, else None.

        Raises:
            UsageError: the data have no depth, or the user gave depth maps that no corruption needs.
            DataError: a depth file is missing.
        """
        wanting = next((one.name for one in self.conditions if one.needs_depth), None)
        if wanting is None:
            if self.own_depth is not None:
                raise UsageError("--depth", "none of the corruptions needs depth; choose one that does, or omit it")
            return None
        if self.depths is None:
            raise no_depth(wanting, self.dataset.name)
        for key in self.keys:
            self.depths.depth_files(key)
        return self.depths

    def narrowed(
        self,
        corruptions: AnyCorruption | Sequence[AnyCorruption] | None = None,
        severities: int | Sequence[int] | None = None,
        limit: int | None = None,
        attacks: AnyAttack | Sequence[AnyAttack] | None = None,
    ) -> Benchmark:
        """Return the same benchmark with fewer or different corruptions or severities, or fewer samples (`spread`).

        Pairs of a user's own frames that are not consecutive are left out (`own_frames`). Names of families and "all"
        stand for the benchmark's corruptions. With attacks but without corruptions, only
        the attacks are run. Random noise of the same norms is added as a baseline.

        Raises:
            UsageError: a corruption or attack is unknown, a severity is outside 1 to 5, or the limit is below 1.
        """
        if limit is not None:
            check_count("--limit", limit)
        against: tuple[str, ...] = ()
        if attacks:
            from ...attacks.api import with_controls

            against = with_controls(_several("attacks", attacks))
        asked = (() if against else self.corruptions) if corruptions is None else _several("corruptions", corruptions)
        chosen = corruption_names(with_families(asked, self.corruptions))
        for name in chosen:
            if name not in self.corruptions and not (self.closed and name in ON_DISK):
                condition = condition_of(name)
                condition.check()
                self._refuse_clip_corruption(condition)
        named = self.severities if severities is None else _several("severities", severities)
        levels = tuple(sorted({check_severity(level) for level in named}))
        if self.closed and not (set(chosen) <= set(self.corruptions) and set(levels) <= set(self.severities)):
            known = f"{', '.join(self.corruptions)} at severities {', '.join(map(str, self.severities))}"
            raise UsageError(self.name, f"these frames were corrupted beforehand, with {known}; choose from these")
        if not (chosen or against) or not levels:
            raise UsageError("--corruptions", "nothing to run; give a corruption or attack, and a severity")
        if both := set(chosen) & set(against):
            raise UsageError(min(both), "this is the name of an attack; give your own corruption a different name")
        keys = tuple(continuous(self.dataset, spread(self.keys, limit)))
        return replace(self, keys=keys, corruptions=chosen, severities=levels, attacks=against)

    def still(self) -> Benchmark:
        """Return the still version of the benchmark: every frame paired with itself, with a true flow of zero
        everywhere.

        Raises:
            UsageError: the benchmark is from the paper, so its name implies its pairs and their ground truth, or
                its frames were corrupted beforehand.
        """
        check_still(self.name, self.facts)
        dataset = Still(self.dataset, self.keys, self.own_depth)
        return replace(
            self,
            name=still_name(self.name),
            dataset=dataset,
            keys=tuple(dataset.keys()),
            protocol={name: value for name, value in self.protocol.items() if name not in NON_OCCLUDED},
            facts=facts_of_still(self.facts),
        )

    def subset(self, name: str) -> Benchmark:
        """Return the same benchmark restricted to the conditions of a subset: "quick", see `BenchmarkFacts.quick`.

        Raises:
            UsageError: the subset is unknown, or the benchmark does not have it.
        """
        if name != "quick":
            raise unknown_name("subset", name, ("quick",))
        if self.facts.quick is None:
            raise UsageError("--subset", f"{self.name} has no quick subset; name fewer --corruptions or --severities")
        return self.narrowed(self.facts.quick.corruptions, self.facts.quick.severities)

    def _refuse_clip_corruption(self, condition: Condition) -> None:
        name, data = condition.name, self.dataset
        if not {*CLIP} & {*condition.names} or (isinstance(data, PreCorrupted) and data.has_corrupted(name)):
            return
        if len(condition.parts) > 1:
            raise UsageError(name, "a corruption of the whole clip cannot be stacked")
        videos = [file for file in self.dataset.files(self.keys[0]) if file.suffix.lower() in VIDEO_SUFFIXES]
        video = f" --data {videos[0]}" if videos else ", which also accepts a video file"
        instead = getattr(load_corruption(name), "instead", "")
        raise UsageError(name, f"needs the clip that the frames are from; give --benchmark gopro-fc{video}{instead}")


def _several(name: str, given: Any) -> list[Any]:
    """Return one or several values as a list."""
    values = [given] if isinstance(given, str | bytes | type | Mapping) or not isinstance(given, Iterable) else [*given]
    for value in values:
        if isinstance(value, bytes | Mapping | list | tuple) or (name != "severities" and isinstance(value, Real)):
            raise UsageError(name, f"give one or a list of them, not {value!r:.60}")
    return values


def spread(keys: Sequence[str], limit: int | None) -> tuple[str, ...]:
    """Select `limit` keys spread evenly over all keys, in the same order; None or a larger limit selects all."""
    if limit is None or limit >= len(keys):
        return tuple(keys)
    chosen: set[int] = set()
    number = 1
    while len(chosen) < limit:
        digits = f"{number:b}"
        chosen.add(len(keys) * int(digits[::-1], 2) >> len(digits))
        number += 1
    return tuple(keys[place] for place in sorted(chosen))
