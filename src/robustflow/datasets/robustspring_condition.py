"""The frames of RobustSpring under one condition, and the layout of flow submissions to its server.

    spring/test/0003/frame_left/frame_left_0001.png ...     as unpacked from Spring's test_frame_left.zip, _right.zip
    fog/test/0003/frame_left/frame_left_0001.png ...        from fog.zip, and so on

The server expects the flow of every pair, forwards and backwards in both cameras, clean and corrupted, in the layout
CONDITION/test/0003/flow_FW_left/flow_FW_left_0001.flo5.

Source: Schmalfuss et al., RobustSpring, arXiv 2505.09368. The layout of the flows and the names and lengths of the
sequences are taken from springeval/templates/springeval/faq.html and subsampling/flow_robust_subsampling.cpp in
cv-stuttgart/springwebsite at bbfabe8. The layout of the frames is the one that two independent readers expect:
tools/official_transfer_probe.py in eLiAshaun/CAR-GR-RoCo-Spring at 5cbd69a and
instant_video_models/datasets/robust_spring.py in wision-lab/instant-video-models at e685f56. This reader has not been
tested on the released frames.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path

from ..corruptions.on_disk import ROBUSTSPRING
from ..errors import DataError
from ..layout import choice, consecutive, folders, locate, numbered, user_path
from .pairs import PairDataset, PairFiles

CLEAN = "clean"

CORRUPTIONS = tuple(sorted(map(ROBUSTSPRING.dataset_name, ROBUSTSPRING.names)))
"""RobustSpring's names for its corruptions; each corruption has a single strength."""

SEQUENCES = {3: 131, 19: 111, 28: 39, 29: 135, 31: 73, 34: 47, 35: 120, 40: 111, 42: 116, 46: 117}
"""Number of frames of each test sequence."""

DIRECTIONS = ("FW", "BW")
_SIDES = ("left", "right")
_CLEAN_NAMES = ("spring", CLEAN)


class Condition(PairDataset):
    """The pairs of one condition in one direction, for both cameras. A key is the path of a flow below CONDITION/test;
    a group is a sequence, because both cameras see the same scene.
    """

    name = "robustspring"
    has_flow = False

    def __init__(
        self, root: str | Path, condition: str = CLEAN, direction: str = "FW", spring: str | Path | None = None
    ) -> None:
        choice("condition", condition, (CLEAN, *CORRUPTIONS))
        choice("direction", direction, DIRECTIONS)
        self.folder = condition_folder(root, condition, spring)
        pairs = {}
        for sequence in folders(self.folder):
            if re.fullmatch(r"\d{4}", sequence.name):
                for side in _SIDES:
                    pairs.update(_pairs(sequence, side, direction))
        super().__init__(pairs, self.folder)


def submitted() -> Iterator[str]:
    """Return the paths of all flows of a complete submission, relative to its folder."""
    for condition in (CLEAN, *CORRUPTIONS):
        for sequence, frames in SEQUENCES.items():
            for side in _SIDES:
                for direction in DIRECTIONS:
                    first = 1 if direction == "FW" else 2
                    for number in range(first, first + frames - 1):
                        yield f"{condition}/test/{_key(f'{sequence:04d}', side, direction, number)}.flo5"


def condition_folder(root: str | Path, condition: str, spring: str | Path | None = None) -> Path:
    """Return the path of CONDITION/test; for arguments and errors see `Condition`."""
    if condition != CLEAN:
        return _folder(root, [condition])
    if spring is not None:
        return locate("Spring", spring, ["test"], expected="test/, which contains 0003/frame_left/") / "test"
    neighbour = user_path(root).absolute().parent / "spring" / "test"
    if not any((user_path(root) / name).is_dir() for name in _CLEAN_NAMES) and neighbour.is_dir():
        return neighbour
    return _folder(root, _CLEAN_NAMES, "; or give the folder of Spring's frames with -D spring=FOLDER")


def _folder(root: str | Path, names: Sequence[str], otherwise: str = "") -> Path:
    expected = f"{' or '.join(f'{name}/test/' for name in names)}, which contains 0003/frame_left/{otherwise}"
    top = locate("RobustSpring", root, [f"{name}/test" for name in names], expected=expected)
    return next(top / name / "test" for name in names if (top / name / "test").is_dir())


def _key(sequence: str, side: str, direction: str, number: int) -> str:
    kind = f"flow_{direction}_{side}"
    return f"{sequence}/{kind}/{kind}_{number:04d}"


def _pairs(sequence: Path, side: str, direction: str) -> dict[str, PairFiles]:
    folder = sequence / f"frame_{side}"
    if not folder.is_dir():
        raise DataError(f"{folder}: no such folder; unpack the frames of both cameras")
    frames = numbered(folder, rf"frame_{side}_(\d{{4}})\.png")
    pairs = {}
    for before, after in consecutive(frames):
        first, second = (before, after) if direction == "FW" else (after, before)
        key = _key(sequence.name, side, direction, first)
        pairs[key] = PairFiles((frames[first], frames[second]), group=sequence.name)
    return pairs
