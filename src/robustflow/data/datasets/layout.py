"""Where the frames and the ground truth of a dataset are: one declaration per dataset, one reader for all.

In a pattern, {n:06} is the number of a frame, {m:06} the number of the other frame of its pair, {stem} the name of its
file without suffix, and {name} or {name:06} any other part of a path; a number gives the count of digits.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from inspect import Parameter, Signature
from itertools import pairwise
from pathlib import Path
from typing import Any

from ...core.arguments import choice
from ...core.errors import DataError
from ...core.paths import user_path
from .dataset import DatasetFacts
from .pair_files import PairDataset, PairFiles
from .places import consecutive, locate, partner

_FIELD = re.compile(r"\{(\w+)(?::0(\d+))?\}")

Parts = tuple[tuple[str, str], ...]
"""The values of a pattern's fields, sorted by name."""

_UNNUMBERED = -1

BACKWARDS = ("BW", "past")
"""Values of the option `direction` for flow from a frame to the one before."""


@dataclass(frozen=True)
class Layout:
    """The files of a dataset. Every file of a pair must exist; a map is left out if its top folder does not exist.

    Attributes:
        frame: pattern of the frames.
        flow: pattern of the flow from frame n; "" without ground truth.
        key: pattern of a pair's key.
        group: pattern of a pair's group.
        maps: patterns of the further maps, by the attribute of `PairFiles`.
        first: number of the only frame of a sequence that begins a pair; None for every frame but the last.
        stride: distance of consecutive frames; None for the smallest in the sequence; 0 if frames may be missing, in
            which case only frames with consecutive numbers are pairs.
        by_flow: whether only frames with a flow file begin a pair.
        flow_needs: offsets of the frames that must exist for every flow file.
        more_frames: whether sequences have frames outside the pairs, for multi-frame models.
    """

    frame: str
    flow: str = ""
    key: str = "{stem}"
    group: str = ""
    maps: Mapping[str, str] = field(default_factory=dict)
    first: int | None = None
    stride: int | None = 1
    by_flow: bool = False
    flow_needs: tuple[int, ...] = (0, 1)
    more_frames: bool = False

    def pairs(self, base: Path, **words: str) -> dict[str, PairFiles]:
        """Return the pairs below a folder by key; `words` are values of fields that are known."""
        frame, flow = (_filled(pattern, words) for pattern in (self.frame, self.flow))
        sequences, truths = matching(base, frame), matching(base, flow) if flow else {}
        maps = {name: _filled(p, words) for name, p in self.maps.items() if (base / p.split("{")[0]).is_dir()}
        ahead = -1 if words.get("direction") in BACKWARDS else 1
        pairs: dict[str, PairFiles] = {}
        for parts in sorted({*sequences, *truths}):
            frames, flows = sequences.get(parts, {}), truths.get(parts, {})
            if self.first is not None:
                only = flows.get(_UNNUMBERED) or flows.get(self.first)
                flows = {self.first: only} if only else {}
            at: dict[str, Any] = {**words, **dict(parts)}
            for n, path in flows.items():
                for number in (n + ahead * offset for offset in self.flow_needs):
                    if number not in frames:
                        partner(base / _put(frame, at | {"n": number}), path)
            for n, m in self._numbers(frames, flows, ahead):
                at |= {"n": n, "m": m}
                whose = frames.get(n) or frames.get(m) or flows[n]
                first, second = (frames.get(i) or partner(base / _put(frame, at | {"n": i}), whose) for i in (n, m))
                truth = flows.get(n) or partner(base / _put(flow, at), first) if flow else None
                more = {name: partner(base / _put(pattern, at), truth or first) for name, pattern in maps.items()}
                at["stem"] = first.stem
                pairs[_put(self.key, at)] = PairFiles((first, second), truth, **more, group=_put(self.group, at))
        return pairs

    def _numbers(self, frames: Mapping[int, Path], flows: Mapping[int, Path], ahead: int) -> Iterable[tuple[int, int]]:
        if self.by_flow:
            return [(n, n + ahead) for n in flows]
        if self.first is not None:
            existing = {*frames, *flows} & {self.first, self.first + ahead}
            return [(self.first, self.first + ahead)] if existing else []
        neighbours = following(frames) if self.stride == 0 else consecutive(frames, self.stride)
        return neighbours if ahead > 0 else [(m, n) for n, m in neighbours]


class LayoutDataset(PairDataset):
    """A dataset whose files follow a pattern; a class declares where they are, and its facts.

    Attributes:
        layout: the files.
        options: the values of each option, the default first; options are fields of the layout's patterns.
        roots: folders below the root from which the layout may begin.
        marker: a folder by which the layout is recognised; "" for the folder of the frames.
    """

    layout: Layout
    facts: DatasetFacts
    options: Mapping[str, tuple[str, ...]] = {}
    roots: tuple[str, ...] = ("",)
    marker: str = ""

    def __init_subclass__(cls, **arguments: Any) -> None:
        super().__init_subclass__(**arguments)
        if "__init__" not in vars(cls):
            named = [Parameter(o, Parameter.KEYWORD_ONLY, default=values[0]) for o, values in cls.options.items()]
            root = Parameter("root", Parameter.POSITIONAL_OR_KEYWORD)
            cls.__signature__ = Signature([root, *named])  # type: ignore[attr-defined]

    def __init__(self, root: str | Path, **options: str) -> None:
        words = {name: choice(name, options.get(name, known[0]), known) for name, known in self.options.items()}
        self.folder, pairs = self.find(user_path(root), words)
        self._frame = _filled(self.layout.frame, words)
        super().__init__(pairs, self.folder)

    def find(self, root: Path, words: dict[str, str]) -> tuple[Path, dict[str, PairFiles]]:
        """Return the folder from which the layout begins, and the pairs in it."""
        marker = self.marker or re.sub(_FIELD, "*", _filled(self.layout.frame, words).rpartition("/")[0])
        folder = locate(self.facts.title, root, [marker], self.roots, self.facts.layout)
        return folder, self.layout.pairs(folder, **words)

    def steps(self) -> Iterable[tuple[Path, Path]]:
        if not self.layout.more_frames:
            return super().steps()
        every = matching(self.folder, self._frame).values()
        return [(frames[n], frames[m]) for frames in every for n, m in following(frames)]


def matching(base: Path, pattern: str) -> dict[Parts, dict[int, Path]]:
    """Return the files below a folder that match a pattern, by its fields other than {n} and {m}, then by number (-1
    in a pattern without {n})."""
    places: Iterator[tuple[dict[str, str], Path]] = iter([({}, base)])
    for segment in pattern.split("/"):
        places = _deeper(places, segment)
    files: dict[Parts, dict[int, Path]] = {}
    for fields, path in places:
        parts = tuple(sorted((name, value) for name, value in fields.items() if name not in ("n", "m")))
        numbers, number = files.setdefault(parts, {}), int(fields.get("n", _UNNUMBERED))
        if number in numbers:
            raise DataError(path, f"has the same number as {numbers[number].name}; remove one of the two")
        numbers[number] = path
    return {parts: dict(sorted(files[parts].items())) for parts in sorted(files)}


def following(frames: Mapping[int, Path]) -> list[tuple[int, int]]:
    return [(n, m) for n, m in pairwise(sorted(frames)) if m == n + 1]


def _deeper(places: Iterator[tuple[dict[str, str], Path]], segment: str) -> Iterator[tuple[dict[str, str], Path]]:
    if not _FIELD.search(segment):
        yield from ((parts, path / segment) for parts, path in places if (path / segment).exists())
        return
    regex = re.compile(_FIELD.sub(_group, re.escape(segment).replace(r"\{", "{").replace(r"\}", "}")))
    for parts, path in places:
        for name in sorted(os.listdir(path)) if path.is_dir() else ():
            match = regex.fullmatch(name)
            if match and all(parts.get(key, value) == value for key, value in match.groupdict().items()):
                yield parts | match.groupdict(), path / name


def _group(field: re.Match[str]) -> str:
    digits = rf"\d{{{field[2]}}}" if field[2] else r"\d{1,10}" if field[1] in "nm" else r"[^/.][^/]*"
    return f"(?P<{field[1]}>{digits})"


def _filled(pattern: str, words: Mapping[str, str]) -> str:
    return _FIELD.sub(lambda match: words.get(match[1], match[0]), pattern)


def _put(pattern: str, values: Mapping[str, Any]) -> str:
    return _FIELD.sub(lambda m: f"{int(values[m[1]]):0{m[2]}}" if m[2] else str(values[m[1]]), pattern)
