"""Middlebury optical flow; Beanbags, DogDance, MiniCooper and Walking have no flow."""

from __future__ import annotations

from .dataset import NON_COMMERCIAL, DatasetFacts
from .layout import Layout, LayoutDataset


class Middlebury(LayoutDataset):
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
    layout = Layout(
        "other-data/{scene}/frame{n:02}.png",
        "other-gt-flow/{scene}/flow{n:02}.flo",
        "{scene}",
        by_flow=True,
        more_frames=True,
    )
    marker = "other-gt-flow"
