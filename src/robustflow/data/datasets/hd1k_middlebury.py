"""HD1K: 36 driving sequences with ground truth and uncertainties, 1080x2560, flow in KITTI's format. Middlebury
flow: eight scenes with dense ground truth.

    hd1k_input/image_2/000000_0000.png ...      sequence_frame
    hd1k_flow_gt/flow_occ/000000_0000.png ...   one per frame; the last frame of a sequence has no second frame

Source: Kondermann et al., CVPR Workshops 2016.

    other-data/RubberWhale/frame10.png  frame11.png     (frame07 to frame14 for scenes with eight frames)
    other-gt-flow/RubberWhale/flow10.flo

Scenes of `other-data` whose ground truth was never released (Beanbags, DogDance, MiniCooper, Walking) are not samples.
Source: Baker et al., IJCV 2011.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from ...core.paths import by_sequence, consecutive, folders, following, locate, numbered, partner
from .base import NON_COMMERCIAL, DatasetFacts
from .pairs import PairDataset, PairFiles


class HD1K(PairDataset):
    """The HD1K dataset. `root` contains `hd1k_input/` and `hd1k_flow_gt/`."""

    name = "hd1k"
    facts = DatasetFacts(
        title="HD1K",
        description="36 driving sequences, 1080x2560.",
        ground_truth="sparse",
        pairs=1047,
        clips="always",
        licence=NON_COMMERCIAL,
        citation="Kondermann et al., The HCI Benchmark Suite, CVPR Workshops 2016",
        layout="hd1k_input/image_2, hd1k_flow_gt/flow_occ",
        training_set="hd1k",
    )

    def __init__(self, root: str | Path) -> None:
        expected = "hd1k_input/image_2/ and hd1k_flow_gt/flow_occ/"
        folder = locate("HD1K", root, ["hd1k_flow_gt/flow_occ"], expected=expected)
        images, flows = folder / "hd1k_input" / "image_2", folder / "hd1k_flow_gt" / "flow_occ"
        locate("HD1K", folder, ["hd1k_input/image_2"], expected=expected)
        for path in flows.glob("*_*.png"):
            partner(images / path.name, path)
        pairs = {}
        for sequence, frames in by_sequence(images, r"(\d{6})_(\d{4})\.png").items():
            for first, second in consecutive(frames, stride=None):
                flow = partner(flows / frames[first].name, frames[first])
                pairs[frames[first].stem] = PairFiles((frames[first], frames[second]), flow, group=sequence)
        super().__init__(pairs, folder)


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
