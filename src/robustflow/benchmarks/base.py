"""A benchmark: which samples, under which corruptions, at which severities."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from ..attacks.api import AnyAttack, with_controls
from ..corruptions import CLIP, SEVERITIES, Corruption, corruption_name, load_corruption
from ..corruptions.on_disk import on_disk
from ..corruptions.stack import needs_depth, split_stack
from ..datasets.base import Dataset, Depths, PreCorrupted, no_depth
from ..datasets.own_depth import OwnDepth
from ..datasets.still import Still
from ..errors import UsageError, unknown_name
from ..layout import VIDEO_SUFFIXES
from ..severity import check_severity
from .facts import NEUTRAL, NON_OCCLUDED, BenchmarkFacts, check_still, facts_of_still, still_name

AnyCorruption = str | Corruption | type[Corruption]
"""A corruption's name, or one of the user's as an object or a class."""


@dataclass(frozen=True)
class Benchmark:
    """What is measured, and on which samples.

    Attributes:
        name: "kitti-fc", "demo", "folder", ...
        dataset: where the samples come from.
        keys: the samples, in order.
        corruptions: the corruptions, in the paper's order.
        severities: 1 to 5 unless narrowed.
        protocol: everything else that determines the numbers (split, ground truth), for the run's identity.
        closed: whether the corrupted frames come from files, so that no other corruption or severity can be requested.
        classes: corruption -> class that computes it here, where that is not the registered one.
        attacks: adversarial attacks on the model, at the same severities; none unless they are asked for.
        facts: title, whether there is ground truth, what the paper measured.
        own_depth: the user's depth maps; without them depth is the data set's, where it has any.
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

    @property
    def depths(self) -> Depths | None:
        """Where the depth of its samples comes from; None where nothing has it."""
        if self.own_depth is not None and not isinstance(self.dataset, Still):
            return self.own_depth
        return self.dataset if isinstance(self.dataset, Depths) else None

    def depth_to_read(self) -> Depths | None:
        """Where the depth comes from that its corruptions need; None if none of them does.

        Raises:
            UsageError: its data have no depth; or the user gave some, and no corruption needs it.
            DataError: a file of it is missing.
        """
        wanting = next((name for name in self.corruptions if needs_depth(name)), None)
        if wanting is None:
            if self.own_depth is not None:
                raise UsageError("none of the corruptions needs depth: name one that does, or leave out --depth")
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
        """The same benchmark with fewer (or other) corruptions or severities, or fewer samples (`spread`).

        With attacks and without corruptions, only the attacks; the random noise of their norms is added.

        Raises:
            UsageError: an unknown corruption or attack, a severity outside 1 to 5, a limit below 1.
        """
        if limit is not None and limit < 1:
            raise UsageError(f"--limit {limit} leaves no samples: give 1 or more")
        against = with_controls(_several(attacks or ()))
        asked = (() if against else self.corruptions) if corruptions is None else _several(corruptions)
        chosen = tuple(dict.fromkeys(map(corruption_name, asked)))
        for name in chosen:
            if name not in self.corruptions and not (self.closed and on_disk(name)):
                load_corruption(name)
                self._refuse_clip_corruption(name)
        named = self.severities if severities is None else _several(severities)
        levels = tuple(sorted({check_severity(level) for level in named}))
        if self.closed and not (set(chosen) <= set(self.corruptions) and set(levels) <= set(self.severities)):
            raise UsageError(
                f"these frames were corrupted beforehand, with {', '.join(self.corruptions)} at severities "
                f"{', '.join(map(str, self.severities))}; choose among them, or give the uncorrupted data"
            )
        if not (chosen or against) or not levels:
            raise UsageError("nothing to run: name at least one corruption or attack, and one severity")
        if both := set(chosen) & set(against):
            raise UsageError(f"'{min(both)}' is an attack: give your own corruption another name")
        return replace(self, keys=spread(self.keys, limit), corruptions=chosen, severities=levels, attacks=against)

    def still(self) -> Benchmark:
        """Its frames without motion: each paired with itself, and a true flow of zero everywhere.

        Raises:
            UsageError: a benchmark of the paper, whose name implies its pairs and their ground truth; or frames that
                are corrupted beforehand.
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
        """The same benchmark under the conditions of a subset alone: "quick", see `BenchmarkFacts.quick`.

        Raises:
            UsageError: another name, or a benchmark without such a subset.
        """
        if name != "quick":
            raise unknown_name("subset", name, ("quick",))
        if self.facts.quick is None:
            raise UsageError(f"no quick subset was found for {self.name}; name fewer --corruptions or --severities")
        return self.narrowed(self.facts.quick.corruptions, self.facts.quick.severities)

    def _refuse_clip_corruption(self, name: str) -> None:
        """Raise for a corruption of whole clips, which this data set does not hold."""
        parts = [part for part, _ in split_stack(name)]
        if set(parts).isdisjoint(CLIP) or (isinstance(self.dataset, PreCorrupted) and self.dataset.has_corrupted(name)):
            return
        if len(parts) > 1:
            raise UsageError(f"{name} cannot be made: a corruption of the whole clip cannot be stacked")
        videos = [file for file in self.dataset.files(self.keys[0]) if file.suffix.lower() in VIDEO_SUFFIXES]
        video = f" --data {videos[0]}" if videos else ", which takes a video file as it is"
        raise UsageError(f"{name} needs the clip that its frames come from: give --benchmark gopro-fc{video}")


def _several(given: Any) -> Iterable[Any]:
    """One or several corruptions or severities, as several."""
    return (given,) if isinstance(given, str | type) or not isinstance(given, Iterable) else given


def spread(keys: Sequence[str], limit: int | None) -> tuple[str, ...]:
    """`limit` keys, in their order, spread evenly over all; all if there are no more, or for None.

    The first is in the middle, the next at the quarters, then the eighths, so that a larger limit adds to the keys of
    a smaller one: a run with it continues in the same folder.

    >>> [spread("abcdefgh", limit) for limit in (1, 3, 5)]
    [('e',), ('c', 'e', 'g'), ('b', 'c', 'e', 'f', 'g')]
    """
    if limit is None or limit >= len(keys):
        return tuple(keys)
    chosen: set[int] = set()
    number = 1
    while len(chosen) < limit:
        digits = f"{number:b}"
        chosen.add(len(keys) * int(digits[::-1], 2) >> len(digits))
        number += 1
    return tuple(keys[place] for place in sorted(chosen))
