"""HD1K: 36 driving sequences with ground truth and uncertainties, 1080x2560, flow in KITTI's format.

    hd1k_input/image_2/000000_0000.png ...      sequence_frame
    hd1k_flow_gt/flow_occ/000000_0000.png ...   one per frame; the last frame of a sequence has no second frame

Source: Kondermann et al., CVPR Workshops 2016.
"""

from __future__ import annotations

from pathlib import Path

from ..layout import by_sequence, consecutive, locate, partner
from .facts import NON_COMMERCIAL, DatasetFacts
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
