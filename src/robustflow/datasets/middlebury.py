"""Middlebury flow: eight scenes with dense ground truth.

    other-data/RubberWhale/frame10.png  frame11.png     (frame07 to frame14 for scenes with eight frames)
    other-gt-flow/RubberWhale/flow10.flo

Scenes of `other-data` whose ground truth was never released (Beanbags, DogDance, MiniCooper, Walking) are not samples.
Source: Baker et al., IJCV 2011.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from ..layout import folders, following, locate, numbered, partner
from .facts import NON_COMMERCIAL, DatasetFacts
from .pairs import PairDataset, PairFiles


class Middlebury(PairDataset):
    """The Middlebury dataset. `root` contains `other-data/` and `other-gt-flow/`."""

    name = "middlebury"
    facts = DatasetFacts(
        title="Middlebury optical flow",
        description="Small scenes, real and rendered.",
        pairs=8,
        clips="with all frames of a scene",
        licence=NON_COMMERCIAL,
        citation="Baker et al., A Database and Evaluation Methodology for Optical Flow, IJCV 2011",
        layout="other-data/SCENE/frame10.png, other-gt-flow/SCENE/flow10.flo",
        training_set="middlebury",
    )

    def __init__(self, root: str | Path) -> None:
        folder = locate("Middlebury", root, ["other-gt-flow"], expected="other-data/ and other-gt-flow/")
        pairs = {}
        for scene in folders(folder / "other-gt-flow"):
            flow = partner(scene / "flow10.flo", scene)
            first, second = (folder / "other-data" / scene.name / f"frame{number}.png" for number in (10, 11))
            pairs[scene.name] = PairFiles((partner(first, flow), partner(second, flow)), flow)
        super().__init__(pairs, folder)

    def steps(self) -> Iterator[tuple[Path, Path]]:
        """Return all consecutive frames of a scene; most scenes have eight."""
        for pair in self._pairs.values():
            yield from following(numbered(pair.frames[0].parent, r"frame(\d\d)\.png"))
