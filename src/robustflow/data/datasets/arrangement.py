"""Films or independent pairs: arrange a user's frames by their names, and by what the frames show."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

from ...core.arguments import choice
from ...core.errors import UsageError
from ...core.text import counted
from ...media.images import read_image
from .continuity import MATCH, NO_MATCH, match, sketch_of
from .frame_names import Film, films_of

CONSECUTIVE, DISJOINT, NAMES = PAIRS = ("consecutive", "disjoint", "names")
"""Values of the option `pairs`."""
_TRIED = 4
"""Number of pairs of frames that are compared to find out whether frames are a film."""


@dataclass(frozen=True)
class Arrangement:
    """Films, or independent pairs as films of two frames, with the folder of each; "" if there are two.

    Attributes:
        recognised: value of `pairs` that states the arrangement; "" for a film in every folder.
    """

    films: list[tuple[str, Film]]
    recognised: str = ""
    independent: bool = False
    notice: str = ""


def arranged(places: Mapping[str, Sequence[Path]], pairs: str) -> Arrangement:
    """Arrange the frames of folders, by name of the folder, as `pairs` states, or by default as is recognised."""
    if pairs:
        choice("pairs", pairs, PAIRS)
    films = {group: films_of(frames) if frames else [] for group, frames in places.items()}
    numbers = {group: of_group[0] for group, of_group in films.items() if len(of_group) == 1}
    whole = [(group, numbers.get(group, Film(tuple(frames)))) for group, frames in places.items()]
    if pairs == CONSECUTIVE:
        return Arrangement(whole)
    if pairs == DISJOINT:
        if odd := [film.frames[0].parent for _, film in whole if len(film.frames) % 2]:
            raise UsageError("pairs", f"{odd[0]} has an odd number of frames, which are no {DISJOINT} pairs")
        return Arrangement([(group, pair) for group, film in whole for pair in film.couples()], DISJOINT, True)
    every = [(group, film) for group in films for film in films[group]]
    recognised = _across(every, pairs) or _by_name(every, len(whole)) or (_by_content(whole) if not pairs else None)
    if recognised is None and pairs == NAMES:
        raise UsageError("pairs", "the names of the frames tell no pairs; give pairs=disjoint or pairs=consecutive")
    return recognised or Arrangement(whole)


def _across(films: Sequence[tuple[str, Film]], pairs: str) -> Arrangement | None:
    """Pair the frames with equal numbers of two films, such as left and right, if the films are none by what they show,
    or if the user states that names tell the pairs."""
    if len(films) != 2:
        return None
    (group, first), (other, second) = films
    stems, stems_of_other = ([frame.stem for frame in film.frames] for film in (first, second))
    equal_names = group != other and stems == stems_of_other
    if not equal_names and not (first.numbers and first.numbers == second.numbers):
        return None
    couples = list(zip(first.frames, second.frames, strict=True))
    links = [link for film in (first, second) for link in pairwise(film.frames)]
    if pairs == NAMES and (group != other or len(couples) > 2):
        are_pairs = not _are_alike(links) or _are_alike(couples)
    else:
        are_pairs = not _are_alike(links) and _are_alike(couples)
    folder = group if group == other else ""
    return _independent([(folder, Film(couple)) for couple in couples], NAMES) if are_pairs else None


def _by_name(films: Sequence[tuple[str, Film]], folders: int) -> Arrangement | None:
    """Return the films and pairs that names tell, None if each folder is one film."""
    couples = [(group, film) for group, film in films if len(film.frames) == 2]
    longest = max((len(film.frames) for _, film in films), default=0)
    if len(films) > folders and longest == 2 and 2 * len(couples) > len(films):
        return _independent(couples, NAMES, len(films) - len(couples))
    if len(films) > folders and longest > 2:
        longer = [(group, film) for group, film in films if len(film.frames) > 1]
        alone = sum(len(film.frames) for _, film in films) - sum(len(film.frames) for _, film in longer)
        words = f"read as {counted(len(longer), 'film')} by names such as {longer[0][1].frames[0].name}{_alone(alone)}"
        return Arrangement(longer, NAMES, notice=words + _OTHERWISE)
    return None


def _by_content(films: Sequence[tuple[str, Film]]) -> Arrangement | None:
    """Return independent pairs if in every folder, frames 1 and 2, 3 and 4, ... show the same, but not 2 and 3."""
    for _, film in films:
        links = list(pairwise(film.frames))
        if len(links) < 3 or len(links) % 2 == 0:
            return None
        if any(_match(*link) >= NO_MATCH for link in _some(links[1::2])) or not _are_alike(links[::2]):
            return None
    return _independent([(group, pair) for group, film in films for pair in film.couples()], DISJOINT)


def _independent(couples: list[tuple[str, Film]], pairs: str, alone: int = 0) -> Arrangement:
    first, second = couples[0][1].frames
    across = first.parent != second.parent
    example = " and ".join(str(frame.relative_to(frame.parents[across])) for frame in (first, second))
    words = f"read as {counted(len(couples), 'independent pair')} such as {example}, not as a film"
    return Arrangement(couples, pairs, True, f"{words}{_alone(alone)}{_OTHERWISE}")


_OTHERWISE = f" (-D pairs={CONSECUTIVE} reads films)"


def _alone(frames: int) -> str:
    return f", without {counted(frames, 'frame')} that has no partner" if frames else ""


def _are_alike(links: Sequence[tuple[Path, ...]]) -> bool:
    """Return whether the frames of most pairs show the same scene; False for no pairs."""
    tried = [_match(*link) >= MATCH for link in _some(links)]
    return 2 * sum(tried) > len(tried)


def _some(links: Sequence[tuple[Path, ...]]) -> list[tuple[Path, ...]]:
    tried = min(_TRIED, len(links))
    return [links[place * (len(links) - 1) // max(1, tried - 1)] for place in range(tried)]


def _match(first: Path, second: Path) -> float:
    return match(sketch_of(read_image, first), sketch_of(read_image, second))
