"""What the file names of a user's frames tell: films, independent pairs, times, and maps that are not frames.

A name is text with numbers. Frames whose text and numbers are equal up to the last number that varies belong together:
"000027_10" and "000027_11" are a pair, "000027_00" to "000027_20" a film. In `ROLES`, words are numbers, too.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from statistics import median
from typing import Any

from ...media.images import are_decimals, natural_order

ROLES = (
    ("left", "right"), ("l", "r"), ("a", "b"), ("first", "second"), ("even", "odd"), ("prev", "next"),
    ("previous", "next"), ("before", "after"), ("source", "target"), ("src", "tgt"), ("ref", "tgt"), ("start", "end"),
)  # fmt: skip
"""Words that distinguish the two frames of a pair."""

_MAP = (
    r"(masks?|depths?|disps?|disparit(y|ies)|labels?|annotations?|segm?|segmentation(s|class|object)?|semantics?|instances?|flows?|occ|"
    r"noc|occlusions?|normals|mattes?|trimaps?|gt|ground_?truth)([_. -]?(maps?|images?|png|left|right|\d+))*"
)
_MAP_FOLDER, _MAP_FILE = re.compile(rf"(.*[_. -])?{_MAP}", re.I), re.compile(rf".*[_. -]{_MAP}", re.I)

_DATE = re.compile(
    r"(?<!\d)([12]\d{3})[-_.]?([01]\d)[-_.]?([0-3]\d)[T_. -]+"
    r"([0-2]\d)[-_:.h]?([0-5]\d)[-_:.m]?([0-5]\d)(?:[-_.](\d+))?(?!\d)"
)
_SECONDS = re.compile(r"(?:.*\D)?(\d{9,10})[_.-](\d{1,9})")

IRREGULAR = 1.5
"""Factor by which an interval differs from the usual one if frames are missing, or the frame rate varies."""


@dataclass(frozen=True)
class Film:
    """Frames of one sequence in order, as paths or as numbers in a video, with the numbers or times in their names, ()
    if they have none."""

    frames: tuple[Any, ...]
    numbers: tuple[float, ...] = ()
    timed: bool = False

    def gaps(self) -> set[int]:
        """Return the places i for which frames i and i + 1 are not the usual interval apart."""
        return irregular(self.numbers, self.timed)

    def couples(self) -> list[Film]:
        """Return the frames as pairs that do not overlap."""
        return [replace(self, frames=self.frames[i : i + 2], numbers=()) for i in range(0, len(self.frames) - 1, 2)]


def irregular(times: Sequence[float], timed: bool = True) -> set[int]:
    """Return the places of intervals that are longer or shorter than the usual one by the factor `IRREGULAR`: the most
    frequent one if it is that of half of the frames, else the median. Irregular numbers without a usual step, which are
    no times, give no gap.

    >>> irregular([1, 2, 3, 13, 14]), irregular([0, 33, 67, 100, 167, 200]), irregular([3, 5, 80, 999], timed=False)
    ({2}, {3}, set())
    """
    steps = [later - earlier for earlier, later in pairwise(times)]
    if len(steps) < 2:
        return set()
    count, usual = max((count, -step) for step, count in Counter(steps).items())
    usual = -usual if 2 * count >= len(steps) else median(steps)
    off = {place for place, step in enumerate(steps) if not usual / IRREGULAR < step < usual * IRREGULAR}
    return off if timed or 2 * len(off) <= len(steps) else set()


def without_maps(places: dict[str, list[Path]]) -> tuple[dict[str, list[Path]], list[str]]:
    """Return folders with the frames in them, without masks, depth maps and the like that lie beside frames, and the
    names of what was left out."""
    skipped = [name for name in places if _MAP_FOLDER.fullmatch(name)]
    kept = {name: frames for name, frames in places.items() if name not in skipped}
    if not kept:
        kept, skipped = dict(places), []
    words = [f"{name}/" for name in skipped]
    for name, frames in kept.items():
        maps = [frame for frame in frames if _MAP_FILE.fullmatch(frame.stem)]
        if maps and len(maps) < len(frames):
            kept[name] = [frame for frame in frames if frame not in maps]
            words.append(f"{len(maps)} like {maps[0].name}")
    return kept, words


def films_of(frames: Sequence[Path]) -> list[Film]:
    """Sort the frames of a folder into films by their names; frames whose names have nothing in common are one film."""
    stems = [frame.stem for frame in frames]
    if times := _times(stems):
        order = sorted(zip(times, frames, strict=True))
        return [Film(tuple(frame for _, frame in order), tuple(time for time, _ in order), timed=True)]
    decimals = are_decimals(stems)
    groups: dict[tuple[object, ...], list[tuple[tuple[float, ...], Path]]] = {}
    for (text, numbers), frame in zip(_parsed(stems, decimals), frames, strict=True):
        groups.setdefault(text, []).append((numbers, frame))
    films: list[Film] = []
    for members in groups.values():
        columns = list(zip(*(numbers for numbers, _ in members), strict=True))
        varying = [place for place, column in enumerate(columns) if len(set(column)) > 1]
        *scene, counter = varying or [-1]
        if scene and len(set(columns[scene[0]])) == len(members):  # further numbers describe each frame
            scene, counter = [], scene[0]
        scenes: dict[tuple[float, ...], list[tuple[float, Path]]] = {}
        for numbers, frame in members:
            at = scenes.setdefault(tuple(numbers[place] for place in scene), [])
            at.append((numbers[counter] if numbers else 0, frame))
        for at in scenes.values():
            at.sort(key=lambda numbered: numbered[0])
            films.append(Film(tuple(frame for _, frame in at), tuple(number for number, _ in at), decimals))
    if max(map(len, (film.frames for film in films))) == 1:
        return [Film(tuple(frames))]
    return sorted(films, key=lambda film: natural_order(film.frames[0].name))


def _times(stems: Sequence[str]) -> list[float]:
    """Return the times in names that all have a date and a time of day, or seconds since 1970 and the number of milli-,
    micro- or nanoseconds; [] for other names.

    >>> first, second = _times(["20240131_235959", "20240201_000000"])
    >>> second - first, _times(["1305031102_9", "1305031102_500000"])
    (1.0, [1305031102.000009, 1305031102.5])
    """
    dates = [_DATE.search(stem) for stem in stems]
    if all(dates):
        return [_of_date(*map(int, date.groups("0")[:6])) + float(f"0.{date[7] or 0}") for date in dates if date]
    seconds = [_SECONDS.fullmatch(stem) for stem in stems]
    if len(stems) < 2 or not all(seconds) or are_decimals(stems):
        return []
    parts = [(int(name[1]), name[2]) for name in seconds if name]
    unit = 10 ** (-(-max(len(fraction) for _, fraction in parts) // 3) * 3)
    return [whole + int(fraction) / unit for whole, fraction in parts]


def _of_date(year: int, month: int, day: int, hour: int, minute: int, second: int) -> int:
    """Return seconds in a calendar in which every month has 31 days."""
    return (((12 * year + month) * 31 + day) * 24 + hour) * 3600 + minute * 60 + second


def _parsed(stems: Sequence[str], decimals: bool) -> list[tuple[tuple[object, ...], tuple[float, ...]]]:
    """Return the text of each name with None for each number, and the numbers."""
    number = r"\d+(?:\.\d+)?" if decimals else r"\d+"
    names = [re.findall(rf"{number}|[a-z]+|[^a-z0-9]+", stem.casefold()) for stem in stems]
    words = Counter(word for name in names for word in set(name))
    roles = {word: str(place) for pair in ROLES if words[pair[0]] == words[pair[1]] for place, word in enumerate(pair)}
    parsed = []
    for name in names:
        parts = [roles.get(word, word) for word in name]
        text = tuple(None if part[0].isdecimal() else part for part in parts)
        parsed.append((text, tuple(float(part) for part in parts if part[0].isdecimal())))
    return parsed
