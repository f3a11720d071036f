"""HD1K, which has flow for every frame."""

from __future__ import annotations

from .dataset import NON_COMMERCIAL, DatasetFacts
from .layout import Layout, LayoutDataset


class HD1K(LayoutDataset):
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
    layout = Layout(
        "hd1k_input/image_2/{sequence:06}_{n:04}.png",
        "hd1k_flow_gt/flow_occ/{sequence:06}_{n:04}.png",
        group="{sequence}",
        stride=None,
        flow_needs=(0,),
    )
