"""Spring: 37 training sequences of an animated film at 1920x1080, ground truth at 3840x2160. Needs the extra `h5`.

    train/0001/frame_left/frame_left_0001.png ...
    train/0001/flow_FW_left/flow_FW_left_0001.flo5 ...      from this frame to the next
    train/0001/flow_BW_left/flow_BW_left_0002.flo5 ...      from this frame to the one before

Vectors are in pixels of the frames, four for each pixel; the benchmark's own reader takes every second one in both
directions, and so does this one. The optional maps (sky, detail, matching) are not read. Source: Mehl et al., CVPR
2023.
"""

from __future__ import annotations

from pathlib import Path

from ..errors import DataError
from ..extras import require
from ..flowio import read_flow
from ..layout import choice, consecutive, folders, locate, numbered, partner
from .facts import DatasetFacts
from .pairs import PairDataset, PairFiles, Truth


class Spring(PairDataset):
    """Spring. `root` holds `train/`, or is that folder.

    Args:
        side: "left" or "right" camera.
        direction: "FW" (to the next frame) or "BW" (to the one before).

    Raises:
        DataError: another layout, a frame missing within a sequence, or flow without its frames.
    """

    name = "spring"
    facts = DatasetFacts(
        title="Spring",
        description="37 sequences of an animated film, 1920x1080, with detailed ground truth.",
        pairs=4963,
        clips="always",
        licence="CC BY 4.0",
        citation="Mehl et al., Spring: A High-Resolution High-Detail Dataset and Benchmark, CVPR 2023",
        layout="train/0001/frame_left, train/0001/flow_FW_left",
        training_set="spring",
    )

    def __init__(self, root: str | Path, side: str = "left", direction: str = "FW") -> None:
        choice("side", side, ("left", "right"))
        choice("direction", direction, ("FW", "BW"))
        require("h5py", "Spring's ground truth")
        expected = f"train/0001/frame_{side}/ and train/0001/flow_{direction}_{side}/"
        folder = _train(Path(root), expected)
        pairs: dict[str, PairFiles] = {}
        for sequence in folders(folder):
            pairs.update(_sequence(sequence, side, direction))
        super().__init__(pairs, folder)

    def truth(self, pair: PairFiles) -> Truth | None:
        """Every second vector of every second row."""
        if pair.flow is None:
            return None
        flow, valid = read_flow(pair.flow)
        if flow.shape[0] % 2 or flow.shape[1] % 2:
            raise DataError(f"{pair.flow}: {flow.shape[1]}x{flow.shape[0]} vectors; Spring has two per pixel and side")
        return Truth(flow[::2, ::2].copy(), valid[::2, ::2].copy())

    def training_truth(self, pair: PairFiles) -> Truth | None:
        """The same."""
        return self.truth(pair)


def _train(root: Path, expected: str) -> Path:
    root = root.expanduser()
    if any((sequence / f"frame_{side}").is_dir() for sequence in folders(root) for side in ("left", "right")):
        return root
    return locate("Spring", root, ["train"], expected=expected) / "train"


def _sequence(sequence: Path, side: str, direction: str) -> dict[str, PairFiles]:
    images, flows = sequence / f"frame_{side}", sequence / f"flow_{direction}_{side}"
    ahead = 1 if direction == "FW" else -1
    known = numbered(flows, rf"flow_{direction}_{side}_(\d{{4}})\.flo5") if flows.is_dir() else {}
    for number, flow in known.items():
        for needed in (number, number + ahead):
            partner(images / f"frame_{side}_{needed:04d}.png", flow)
    frames = numbered(images, rf"frame_{side}_(\d{{4}})\.png") if images.is_dir() else {}
    pairs = {}
    for before, after in consecutive(frames):
        first, second = (before, after) if ahead == 1 else (after, before)
        flow = partner(flows / f"flow_{direction}_{side}_{first:04d}.flo5", frames[first])
        pairs[f"{sequence.name}/{first:04d}"] = PairFiles((frames[first], frames[second]), flow, group=sequence.name)
    return pairs
