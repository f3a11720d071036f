"""MPI-Sintel.

training/depth/alley_1/frame_0001.dpt           metres
training/camdata_left/alley_1/frame_0001.cam    the camera
"""

from __future__ import annotations

from pathlib import Path

from ...core.errors import DataError
from ...core.paths import folders
from ...core.types import Camera, Mask, Sample, SceneDepth
from ...media.depth import read_camera, read_dpt
from ...media.flow import read_flow
from ...media.images import read_mask
from .dataset import DatasetFacts
from .depth import existing, relative_motion, scene_depth
from .layout import Layout, LayoutDataset
from .pair_files import PairFiles, Truth
from .places import locate

_SINTEL_MAPS = ("flow", "occlusions", "invalid", "flow_viz", "depth", "depth_viz", "camdata_left")


class Sintel(LayoutDataset):
    """The MPI-Sintel dataset. `root` is `training/` or its parent folder."""

    name = "sintel"
    facts = DatasetFacts(
        title="MPI-Sintel",
        description="23 scenes of an animated film, 436x1024, in a clean and a final rendering.",
        pairs=1041,
        depth="exact, with its depth package",
        clips="always",
        licence="film CC BY 3.0; data for research, see the distributor's terms",
        citation="Butler et al., A Naturalistic Open Source Movie for Optical Flow Evaluation, ECCV 2012",
        layout="training/clean, training/final, training/flow, training/occlusions, training/invalid",
        training_set="sintel",
    )
    layout = Layout(
        "{render_pass}/{scene}/frame_{n:04}.png",
        "flow/{scene}/frame_{n:04}.flo",
        "{scene}/frame_{n:04}",
        "{scene}",
        {"occlusion": "occlusions/{scene}/frame_{n:04}.png", "invalid": "invalid/{scene}/frame_{n:04}.png"},
    )

    def __init__(self, root: str | Path, render_pass: str = "clean") -> None:
        self.options = {"render_pass": (render_pass,)}
        super().__init__(root)

    def find(self, root: Path, words: dict[str, str]) -> tuple[Path, dict[str, PairFiles]]:
        folder = locate(self.facts.title, root, ["flow"], ("training", ""), self.facts.layout)
        passes = [path.name for path in folders(folder) if path.name not in _SINTEL_MAPS]
        if words["render_pass"] not in passes:
            raise DataError(folder, f"no pass '{words['render_pass']}'; choose render_pass from {', '.join(passes)}")
        return folder, self.layout.pairs(folder, **words)

    def truth(self, pair: PairFiles) -> Truth | None:
        """Read the flow, excluding the pixels marked in `invalid`, and the occlusion map."""
        assert pair.flow is not None
        flow, valid = read_flow(pair.flow)
        if pair.invalid is not None:
            valid &= ~_fitting(pair.invalid, valid.shape)
            flow[~valid] = 0
        return Truth(flow, valid, None if pair.occlusion is None else _fitting(pair.occlusion, valid.shape))

    def depth(self, sample: Sample) -> SceneDepth:
        *maps, first, second = self.depth_files(sample.key)
        lenses, poses = zip(*(read_camera(path) for path in (first, second)), strict=True)
        (fx, fy, cx, cy), moved = ((float(k[0, 0]), float(k[1, 1]), float(k[0, 2]), float(k[1, 2])) for k in lenses)
        camera = Camera((fx, fy), (cx, cy), *relative_motion(*poses), moved)
        now, then = (read_dpt(path) for path in maps)
        return scene_depth(now, then, camera, self.name, sample)

    def depth_files(self, key: str) -> list[Path]:
        frames = self.pair(key).frames
        training, scene = frames[0].parents[2], frames[0].parent.name
        kinds = (("depth", ".dpt"), ("camdata_left", ".cam"))
        files = [training / kind / scene / f"{frame.stem}{suffix}" for kind, suffix in kinds for frame in frames]
        return existing(files, "MPI-Sintel", "MPI-Sintel-depth-training")


def _fitting(path: Path, shape: tuple[int, ...]) -> Mask:
    mask = read_mask(path)
    if mask.shape != shape:
        raise DataError(path, f"{mask.shape[0]}x{mask.shape[1]} pixels, but the flow has {shape[0]}x{shape[1]}")
    return mask
