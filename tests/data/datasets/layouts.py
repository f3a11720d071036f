"""Small folders in the layouts of the real datasets; every file has different content."""

import hashlib
from pathlib import Path

import cv2
import numpy as np

from robustflow.media.flow import write_flow

HEIGHT, WIDTH = 6, 8


def _digest(path: Path) -> np.ndarray:
    return np.frombuffer(hashlib.blake2b(path.as_posix().encode()).digest(), np.uint8)


def placed(path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    return path


def picture(path: Path, height: int = HEIGHT, width: int = WIDTH) -> np.ndarray:
    """Write an image whose content depends on its path; return it as RGB."""
    image = np.resize(_digest(path), (height, width, 3))
    assert cv2.imwrite(str(placed(path)), image[..., ::-1])
    return image


def flow(path: Path, valid: np.ndarray | None = None, height: int = HEIGHT, width: int = WIDTH) -> np.ndarray:
    """Write a flow whose values depend on its path; return the flow."""
    values = np.resize(_digest(path).astype(np.float32) / 4 - 32, (height, width, 2))
    write_flow(placed(path), values, valid)
    return values


def mask(path: Path, values: np.ndarray) -> None:
    assert cv2.imwrite(str(placed(path)), values.astype(np.uint8) * 255)


def kitti(folder: Path, keys: list[str], images: str = "image_2", noc: bool = True, occ: bool = True) -> None:
    """Write pairs in KITTI's layout, with the first column occluded and the last row unknown."""
    known = np.ones((HEIGHT, WIDTH), bool)
    known[-1] = False
    visible = known.copy()
    visible[:, 0] = False
    for key in keys:
        picture(folder / images / f"{key}_10.png")
        picture(folder / images / f"{key}_11.png")
        if occ:
            flow(folder / "flow_occ" / f"{key}_10.png", known)
        if noc:
            flow(folder / "flow_noc" / f"{key}_10.png", visible)


def sintel(root: Path, maps: bool = True, frames: int = 3) -> Path:
    """Write two scenes in MPI-Sintel's layout; return the folder of the training split."""
    folder = root / "training"
    hidden = np.eye(HEIGHT, WIDTH, dtype=bool)
    for scene in ("alley_1", "market_2"):
        for number in range(1, frames + 1):
            picture(folder / "clean" / scene / f"frame_{number:04d}.png")
            picture(folder / "final" / scene / f"frame_{number:04d}.png")
            if maps:  # the last frame also has an invalid map, but no flow
                mask(folder / "invalid" / scene / f"frame_{number:04d}.png", ~hidden[::-1])
        for number in range(1, frames):
            flow(folder / "flow" / scene / f"frame_{number:04d}.flo")
            if maps:
                mask(folder / "occlusions" / scene / f"frame_{number:04d}.png", hidden)
    return folder


def spring(root: Path, frames: int = 3) -> Path:
    """Write two sequences in Spring's layout, with both cameras and directions; return the folder `train`."""
    for sequence in ("0001", "0007"):
        for side in ("left", "right"):
            for number in range(1, frames + 1):
                picture(root / "train" / sequence / f"frame_{side}" / f"frame_{side}_{number:04d}.png")
            for direction, first in (("FW", 1), ("BW", 2)):
                folder = root / "train" / sequence / f"flow_{direction}_{side}"
                for number in range(first, first + frames - 1):
                    flow(folder / f"{folder.name}_{number:04d}.flo5", None, 2 * HEIGHT, 2 * WIDTH)
    return root / "train"


def robustspring(root: Path, conditions: tuple[str, ...] = ("spring", "fog", "rain")) -> Path:
    """Write two short sequences from both cameras under some conditions, laid out like the unpacked archives."""
    for condition in conditions:
        for sequence, count in (("0003", 3), ("0028", 2)):
            for side in ("left", "right"):
                for number in range(1, count + 1):
                    folder = root / condition / "test" / sequence / f"frame_{side}"
                    picture(folder / f"frame_{side}_{number:04d}.png", 48, 64)
    return root
