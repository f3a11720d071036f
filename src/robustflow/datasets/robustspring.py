"""RobustSpring as a benchmark: Spring's ten test sequences under twenty corruptions, without public ground truth.

    spring/test/0003/frame_left/frame_left_0001.png ...     Spring's own test frames, clean
    fog/test/0003/frame_left/frame_left_0001.png ...        the same frame under fog, and so on

RobustSpring measures the change of a model's flow relative to the clean pair, in both cameras, forwards and backwards.
This package does not generate these corruptions; rows use the names in `robustflow.corruptions.on_disk`. Sources: see
`robustspring_condition`.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

from ..corruptions.on_disk import ROBUSTSPRING
from ..errors import DataError, UsageError
from ..layout import user_path
from ..sample import Frame, Sample
from .facts import DatasetFacts
from .pairs import read_frames
from .robustspring_condition import CLEAN, CORRUPTIONS, DIRECTIONS, Condition, condition_folder
from .samples import Samples


class RobustSpring(Samples):
    """The clean pairs of both cameras in both directions, with their frames under all unpacked corruptions. Implements
    `Dataset` and `CorruptedClips`.
    """

    name = "robustspring"
    has_flow = False
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
        corruptions=ROBUSTSPRING.names,
        folder_options=("spring",),
    )

    def __init__(self, root: str | Path, spring: str | Path | None = None) -> None:
        self.root = user_path(root)
        self._clean = {direction: Condition(self.root, CLEAN, direction, spring) for direction in DIRECTIONS}
        self._condition_of = {key: pairs for pairs in self._clean.values() for key in pairs.keys()}  # noqa: SIM118
        self._corrupted = {
            ROBUSTSPRING.local_name(own): condition_folder(self.root, own)
            for own in CORRUPTIONS
            if (self.root / own).is_dir()
        }
        for folder in self._corrupted.values():
            self._check_whole(folder)

    def keys(self) -> list[str]:
        """See `Dataset.keys`."""
        return sorted(self._condition_of)

    def load(self, key: str) -> Sample:
        """See `Dataset.load`."""
        return self._condition(key).load(key)

    def files(self, key: str) -> list[Path]:
        """See `Dataset.files`."""
        return self._condition(key).files(key)

    def around(self, key: str, reach: int) -> range:
        """See `Clips.around`."""
        return self._condition(key).around(key, reach)

    def frame(self, key: str, offset: int) -> Frame:
        """See `Clips.frame`."""
        return self._condition(key).frame(key, offset)

    def frame_files(self, key: str, offsets: Iterable[int]) -> list[Path]:
        """See `Clips.frame_files`."""
        return self._condition(key).frame_files(key, offsets)

    def has_corrupted(self, corruption: str) -> bool:
        """See `PreCorrupted.has_corrupted`."""
        return corruption in self._corrupted

    def corrupted(self, key: str, corruption: str, severity: int) -> tuple[Frame, ...]:
        """See `PreCorrupted.corrupted`."""
        clean, *_ = self._condition(key).files(key)
        return read_frames((clean, *self.corrupted_files(key, corruption, severity)))[1:]

    def corrupted_files(self, key: str, corruption: str, severity: int) -> list[Path]:
        """See `PreCorrupted.corrupted_files`."""
        return [self._corrupted_file(corruption, severity, path) for path in self.files(key)]

    def corrupted_frame(self, key: str, offset: int, corruption: str, severity: int) -> Frame:
        """See `CorruptedClips.corrupted_frame`."""
        (clean,) = self.frame_files(key, [offset])
        return read_frames((self.files(key)[0], self._corrupted_file(corruption, severity, clean)))[1]

    def _condition(self, key: str) -> Condition:
        """Return the clean pairs in the direction that a key names."""
        return self._condition_of.get(key, self._clean["FW"])  # raises the error for an unknown key

    def _corrupted_file(self, corruption: str, severity: int, clean: Path) -> Path:
        """Return the corrupted file of a clean frame."""
        if corruption not in self._corrupted or severity != 1:
            raise UsageError(
                f"{self.root} has no {corruption} at severity {severity}; its corruptions exist only at severity 1"
            )
        return self._corrupted[corruption] / clean.relative_to(self._clean["FW"].folder)

    def _check_whole(self, folder: Path) -> None:
        """Raise if a clean frame has no corrupted version. List each folder once instead of testing every file."""
        clean = self._clean["FW"]
        wanted: dict[Path, set[str]] = {}
        for key in clean.keys():  # noqa: SIM118
            for path in clean.files(key):
                wanted.setdefault(path.parent.relative_to(clean.folder), set()).add(path.name)
        for place, names in wanted.items():
            there = set(os.listdir(folder / place)) if (folder / place).is_dir() else set()
            if lacks := names - there:
                raise DataError(
                    f"{folder / place / min(lacks)}: missing, though {clean.folder} exists; unpack the complete archive"
                )
