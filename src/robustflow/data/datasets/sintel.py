"""MPI-Sintel: 23 training scenes of an animated film, dense ground truth, occlusion maps.

    training/clean/alley_1/frame_0001.png ...       (and final, albedo)
    training/flow/alley_1/frame_0001.flo            one fewer than frames
    training/occlusions/alley_1/frame_0001.png      white: occluded
    training/invalid/alley_1/frame_0001.png         white: no reliable flow
    training/depth/alley_1/frame_0001.dpt           for depth: metres
    training/camdata_left/alley_1/frame_0001.cam    for depth: the camera

Source: Butler et al., ECCV 2012.
"""

from __future__ import annotations

from pathlib import Path

from ...core.errors import DataError
from ...core.paths import consecutive, folders, locate, numbered, partner
from ...core.types import Camera, Mask, Sample, SceneDepth
from ...media.depth import read_camera, read_dpt
from ...media.flow import read_flow
from ...media.images import read_mask
from .base import DatasetFacts
from .depth import existing, scene_depth
from .motorcycle import relative_motion
from .pairs import PairDataset, PairFiles, Truth

_MAPS = ("flow", "occlusions", "invalid", "flow_viz", "depth", "depth_viz", "camdata_left")


class Sintel(PairDataset):
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

    def __init__(self, root: str | Path, render_pass: str = "clean") -> None:
        folder = locate("MPI-Sintel", root, ["flow"], ("training", ""), "a pass (clean/ or final/) and flow/")
        passes = [path.name for path in folders(folder) if path.name not in _MAPS]
        if render_pass not in passes:
            available = ", ".join(passes) or "none"
            raise DataError(folder, f"no pass '{render_pass}'; found: {available} (option render_pass of the dataset)")
        scenes = {path.name for kind in (render_pass, "flow") for path in folders(folder / kind)}
        pairs: dict[str, PairFiles] = {}
        for scene in sorted(scenes):
            pairs.update(_scene(folder, render_pass, scene))
        super().__init__(pairs, folder)

    def truth(self, pair: PairFiles) -> Truth | None:
        """Read the flow, excluding the pixels marked in `invalid`, and the occlusion map."""
        if pair.flow is None:
            return None
        flow, valid = read_flow(pair.flow)
        if pair.invalid is not None:
            valid &= ~_fitting(pair.invalid, valid.shape)
            flow[~valid] = 0
        return Truth(flow, valid, None if pair.occlusion is None else _fitting(pair.occlusion, valid.shape))

    def depth(self, sample: Sample) -> SceneDepth:
        """See `Depths.depth`. The depth is exact, with the camera of each frame."""
        *maps, first, second = self.depth_files(sample.key)
        lenses, poses = zip(*(read_camera(path) for path in (first, second)), strict=True)
        (fx, fy, cx, cy), moved = ((float(k[0, 0]), float(k[1, 1]), float(k[0, 2]), float(k[1, 2])) for k in lenses)
        camera = Camera((fx, fy), (cx, cy), *relative_motion(*poses), moved)
        now, then = (read_dpt(path) for path in maps)
        return scene_depth(now, then, camera, self.name, sample)

    def depth_files(self, key: str) -> list[Path]:
        """See `Depths.depth_files`."""
        frames = self.pair(key).frames
        training, scene = frames[0].parents[2], frames[0].parent.name
        kinds = (("depth", ".dpt"), ("camdata_left", ".cam"))
        files = [training / kind / scene / f"{frame.stem}{suffix}" for kind, suffix in kinds for frame in frames]
        return existing(files, "MPI-Sintel", "MPI-Sintel-depth-training")


def _scene(folder: Path, render_pass: str, scene: str) -> dict[str, PairFiles]:
    frames = numbered(folder / render_pass / scene, r"frame_(\d{4})\.png")
    flows = numbered(folder / "flow" / scene, r"frame_(\d{4})\.flo")
    for number, flow in flows.items():
        for needed in (number, number + 1):
            partner(folder / render_pass / scene / f"frame_{needed:04d}.png", flow)
    pairs = {}
    for first, second in consecutive(frames):
        flow = partner(folder / "flow" / scene / f"frame_{first:04d}.flo", frames[first])
        occlusion, invalid = (
            partner(folder / kind / scene / f"frame_{first:04d}.png", flow) if (folder / kind).is_dir() else None
            for kind in ("occlusions", "invalid")
        )
        pairs[f"{scene}/frame_{first:04d}"] = PairFiles(
            (frames[first], frames[second]), flow, occlusion, invalid, scene
        )
    return pairs


def _fitting(path: Path, shape: tuple[int, ...]) -> Mask:
    mask = read_mask(path)
    if mask.shape != shape:
        raise DataError(path, f"{mask.shape[0]}x{mask.shape[1]} pixels, but the flow has {shape[0]}x{shape[1]}")
    return mask
