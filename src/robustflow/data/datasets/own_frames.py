"""Pairs of a user's own frames, without ground truth; those of frames that are not consecutive are left out."""

from __future__ import annotations

import warnings
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any

from ...core.errors import DataError
from ...core.text import counted
from ...core.types import Frame
from ...media.images import read_image
from .arrangement import Arrangement
from .continuity import UNLIKE, faults
from .dataset import OWN_FRAMES, Dataset, DatasetFacts
from .pair_files import PairDataset, PairFiles, too_few_frames

FACTS = DatasetFacts(
    title="Your own frames",
    description="Consecutive frames from a folder, from its subfolders, or from a video.",
    ground_truth="none",
    clips="always",
    licence="yours",
    citation="none",
    layout="images, folders of images, or a video file",
)

ALONE = "frames"
"""Group of the images directly in the folder, independent of the folder's name."""

_IRREGULAR = "a gap or change of the frame interval"


class OwnFrames(PairDataset):
    """Pairs of frames `step` apart from a user's films. The pairs of a film form one group, because statistics may not
    treat them as independent.

    Args:
        where: the folder or video.
        arrangement: the films.
        chosen: the frames to use.
        step: distance of the frames of a pair.
        gaps: "skip", or "keep" to keep pairs of frames that are not consecutive.

    Attributes:
        recognised: options that were chosen by what was recognised, for the identity of runs.
        notices: what was recognised or left out when the dataset was opened, as parts of one sentence.
    """

    name = OWN_FRAMES
    has_flow = False
    facts = FACTS

    def __init__(self, where: Path, arrangement: Arrangement, chosen: Collection[Any], step: int, gaps: str) -> None:
        self.where, self.independent, self._skips = where, arrangement.independent, gaps == "skip"
        self.recognised = {"pairs": arrangement.recognised} if arrangement.recognised else {}
        self.notices: list[str] = []
        self._irregular: list[str] = []
        self._faults: dict[str, str] = {}
        pairs: dict[str, PairFiles] = {}
        several = len(arrangement.films) > len({folder for folder, _ in arrangement.films})
        for folder, film in arrangement.films:
            count = sum(frame in chosen for frame in film.frames)
            if several and count < 2:
                continue
            if count <= step:
                raise too_few_frames(count, step, where / folder, len(film.frames))
            off = film.gaps() if self._skips else set()
            group = "" if self.independent else self._group(folder, film.frames[0] if several else None)
            for place, frames in enumerate(zip(film.frames, film.frames[step:], strict=False)):
                if not (frames[0] in chosen and frames[1] in chosen):
                    continue
                key = self._key(folder, frames[0])
                if off.isdisjoint(range(place, place + step)):
                    pairs[key] = PairFiles(frames, group=group)
                else:
                    self._irregular.append(key)
        super().__init__(pairs, where)
        self._pairs = pairs  # in the order of the frames

    def read(self, frame: Any) -> Frame:
        """Return a frame by its name."""
        return read_image(frame)

    def keep(self, keys: Sequence[str]) -> None:
        """Leave out all other pairs."""
        self._pairs = {key: self._pairs[key] for key in keys}

    def consecutive(self, keys: Sequence[str], compare: bool) -> list[str]:
        """See `continuous`."""
        unknown = [key for key in keys if key not in self._faults] if compare and self._skips else []
        self._faults |= faults({key: pair.frames for key, pair in self._pairs.items()}, unknown, self.read)
        reasons = {key: self._faults[key] for key in keys if self._faults.get(key)} if compare else {}
        by_reason: dict[str, list[str]] = {}
        for key, reason in (dict.fromkeys(self._irregular, _IRREGULAR) | reasons).items():
            by_reason.setdefault(reason, []).append(key)
        unlike = by_reason.pop(UNLIKE, [])
        notices = list(self.notices)
        if by_reason:
            counts = (f"{counted(len(out), 'pair')} across {reason} ({out[0]})" for reason, out in by_reason.items())
            notices.append(f"{', '.join(counts)} left out (-D gaps=keep keeps them)")
        if unlike and (self.independent or 2 * len(unlike) > len(keys)):  # the motion of a film can be too fast
            notices.append(f"the frames of {counted(len(unlike), 'pair')} share no content ({', '.join(unlike[:3])})")
        if notices:
            warnings.warn(f"{self.where}: {'; '.join(notices)}", stacklevel=4)
        kept = [key for key in keys if reasons.get(key, UNLIKE) == UNLIKE]
        if not kept:
            raise DataError(self.where, "no pair of consecutive frames; check the frames, or give -D gaps=keep")
        return kept

    def _key(self, folder: str, frame: Any) -> str:
        return f"{folder}/{frame.stem}" if folder else str(frame.stem)

    def _group(self, folder: str, first: Any) -> str:
        return f"{folder or ALONE}/{first.stem}" if first else folder or ALONE


def continuous(dataset: Dataset, keys: Sequence[str], compare: bool = True) -> list[str]:
    """Return the keys of the pairs of consecutive frames, and say in one line what was recognised and left out. Only
    pairs of a user's own frames are left out.

    Raises:
        DataError: no pair remains.
    """
    return dataset.consecutive(keys, compare) if isinstance(dataset, OwnFrames) else list(keys)
