"""RobustSpring as a benchmark: Spring's ten test sequences under twenty corruptions, without public ground truth; and
the layout of flow submissions to its server.

    spring/test/0003/frame_left/frame_left_0001.png ...     as unpacked from Spring's test_frame_left.zip, _right.zip
    fog/test/0003/frame_left/frame_left_0001.png ...        from fog.zip, and so on

RobustSpring measures the change of a model's flow relative to the clean pair, in both cameras, forwards and backwards.
This package does not generate these corruptions; rows use the names in `robustflow.corruptions.registry`. The server
expects the flow of every pair, clean and corrupted, as CONDITION/test/0003/flow_FW_left/flow_FW_left_0001.flo5.

Source: Schmalfuss et al., RobustSpring, arXiv 2505.09368. The layout of the flows and the names and lengths of the
sequences are taken from springeval/templates/springeval/faq.html and subsampling/flow_robust_subsampling.cpp in
cv-stuttgart/springwebsite at bbfabe8. The layout of the frames is the one that two independent readers expect:
tools/official_transfer_probe.py in eLiAshaun/CAR-GR-RoCo-Spring at 5cbd69a and
instant_video_models/datasets/robust_spring.py in wision-lab/instant-video-models at e685f56. This reader has not been
tested on the released frames.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from itertools import product
from pathlib import Path

from ...core.arguments import choice
from ...core.errors import DataError, UsageError
from ...core.paths import folders, user_path
from ...core.types import Frame
from ...corruptions.registry import ON_DISK, ON_DISK_PREFIX
from .dataset import DatasetFacts
from .layout import Layout, matching
from .pair_files import PairDataset, PairFiles, read_frames
from .places import locate

CLEAN = "clean"

CORRUPTIONS = tuple(sorted(name.removeprefix(ON_DISK_PREFIX) for name in ON_DISK))
"""RobustSpring's names for its corruptions; each corruption has a single strength."""

SEQUENCES = {3: 131, 19: 111, 28: 39, 29: 135, 31: 73, 34: 47, 35: 120, 40: 111, 42: 116, 46: 117}
"""Number of frames of each test sequence."""

DIRECTIONS = ("FW", "BW")
_SIDES = ("left", "right")
_CLEAN_NAMES = ("spring", CLEAN)


class ConditionPairs(PairDataset):
    """The pairs of one condition, for both cameras and directions. A key is the path of a flow below CONDITION/test; a
    group is a sequence, because both cameras see the same scene.
    """

    name = "robustspring"
    has_flow = False
    layout = Layout(
        "{sequence:04}/frame_{side}/frame_{side}_{n:04}.png",
        "",
        "{sequence}/flow_{direction}_{side}/flow_{direction}_{side}_{n:04}",
        "{sequence}",
    )

    def __init__(self, root: str | Path, condition: str = CLEAN, spring: str | Path | None = None) -> None:
        self.folder = condition_folder(root, choice("condition", condition, (CLEAN, *CORRUPTIONS)), spring)
        self._pairs_of: dict[str, dict[str, PairFiles]] = {direction: {} for direction in DIRECTIONS}
        for sequence in (folder.name for folder in folders(self.folder) if re.fullmatch(r"\d{4}", folder.name)):
            for side, (direction, pairs) in product(_SIDES, self._pairs_of.items()):
                frames = self.folder / sequence / f"frame_{side}"
                if not frames.is_dir():
                    raise DataError(frames, "no such folder; unpack the frames of both cameras")
                pairs |= self.layout.pairs(self.folder, sequence=sequence, side=side, direction=direction)
        super().__init__(self._pairs_of["FW"] | self._pairs_of["BW"], self.folder)

    def steps(self) -> Iterable[tuple[Path, Path]]:
        return (pair.frames for pair in self._pairs_of["FW"].values())


def submitted() -> Iterator[str]:
    for condition in (CLEAN, *CORRUPTIONS):
        for sequence, frames in SEQUENCES.items():
            for side in _SIDES:
                for direction in DIRECTIONS:
                    first = 1 if direction == "FW" else 2
                    for number in range(first, first + frames - 1):
                        kind = f"flow_{direction}_{side}"
                        yield f"{condition}/test/{sequence:04d}/{kind}/{kind}_{number:04d}.flo5"


def condition_folder(root: str | Path, condition: str, spring: str | Path | None = None) -> Path:
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


class RobustSpring(ConditionPairs):
    """The clean pairs of both cameras in both directions, with their frames under all unpacked corruptions. Implements
    `Dataset` and `CorruptedClips`.
    """

    facts = DatasetFacts(
        title="RobustSpring",
        description="Spring's ten test sequences, 1080x1920, under 20 corruptions, which are distributed as files.",
        ground_truth="none",
        pairs=3960,
        clips="always",
        licence="CC BY 4.0 (Spring's; for the corrupted frames see the distributor's terms)",
        citation="Schmalfuss et al., RobustSpring: Benchmarking Robustness to Image Corruptions for Optical Flow, "
        "Scene Flow and Stereo, arXiv 2505.09368, 2025",
        layout="fog/test/0003/frame_left, spring/test/0003/frame_left",
        same_domain=("spring",),
        corruptions=ON_DISK,
        folder_options=("spring",),
    )

    def __init__(self, root: str | Path, spring: str | Path | None = None) -> None:
        super().__init__(root, CLEAN, spring)
        self.root = user_path(root)
        self._corrupted = {
            f"{ON_DISK_PREFIX}{own}": condition_folder(self.root, own)
            for own in CORRUPTIONS
            if (self.root / own).is_dir()
        }
        for folder in self._corrupted.values():
            self._check_whole(folder)

    def has_corrupted(self, corruption: str) -> bool:
        return corruption in self._corrupted

    def corrupted(self, key: str, corruption: str, severity: int) -> tuple[Frame, ...]:
        clean, *_ = self.files(key)
        return read_frames((clean, *self.corrupted_files(key, corruption, severity)))[1:]

    def corrupted_files(self, key: str, corruption: str, severity: int) -> list[Path]:
        return [self._corrupted_file(corruption, severity, path) for path in self.files(key)]

    def corrupted_frame(self, key: str, offset: int, corruption: str, severity: int) -> Frame:
        (clean,) = self.frame_files(key, [offset])
        return read_frames((self.files(key)[0], self._corrupted_file(corruption, severity, clean)))[1]

    def _corrupted_file(self, corruption: str, severity: int, clean: Path) -> Path:
        if corruption not in self._corrupted or severity != 1:
            raise UsageError(corruption, f"not in {self.root} at severity {severity}; corruptions exist at severity 1")
        return self._corrupted[corruption] / clean.relative_to(self.folder)

    def _check_whole(self, folder: Path) -> None:
        """Raise if a clean frame has no corrupted version."""
        frames = matching(folder, self.layout.frame).values()
        there = {path for numbered in frames for path in numbered.values()}
        wanted = {folder / path.relative_to(self.folder) for key in self.keys() for path in self.files(key)}
        if lacking := wanted - there:
            raise DataError(min(lacking), "missing; unpack the complete archive")
