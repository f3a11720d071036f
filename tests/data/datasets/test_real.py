"""On real data, the readers reproduce the statistics listed in the data's manifest."""

import re
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from robustflow.core.types import Sample
from robustflow.data.datasets import load_dataset
from robustflow.media.flow import read_flow
from tests.shared_data import shared_root

MANIFEST = shared_root() / "data" / "MANIFEST.md"


class Row(NamedTuple):
    """A row of the manifest's table of pairs with ground truth."""

    folder: str
    truth: str
    size: str
    valid: float
    mean: float
    largest: float
    no_warp: float
    warp: float


def rows() -> list[Row]:
    pattern = r"\| (\S+) \| (.+?) \| (\d+x\d+) \| ([\d.]+) \| ([\d.]+) / ([\d.]+) \| ([\d.]+) \| ([\d.]+) \| [\d.]+ \|"
    text = MANIFEST.read_text() if MANIFEST.is_file() else ""
    return [Row(*match[:3], *map(float, match[3:])) for match in re.findall(pattern, text)]


def sample_of(row: Row) -> Sample:
    root = MANIFEST.parent / row.folder
    number = re.search(r"(\d{5,6})_", row.truth)
    if row.folder.startswith("kitti2012"):
        images = "colour" if row.truth.endswith("colored_0") else "grey"
        return load_dataset("kitti2012", root, images=images).load(number[1])
    if row.folder.startswith("kitti2015"):
        return load_dataset("kitti2015", root).load(number[1])
    if row.folder.startswith("flyingchairs"):
        return load_dataset("flyingchairs", root).load(number[1])
    scene, frame = Path(row.truth.split(" on ")[0]).parts[1:]
    if row.folder == "sintel":
        return load_dataset("sintel", root, render_pass="unlabelled_pass").load(f"{scene}/{Path(frame).stem}")
    return load_dataset("middlebury", root).load(scene)


def inside(flow: np.ndarray) -> np.ndarray:
    """Mask of the pixels whose target lies inside the second frame."""
    height, width = flow.shape[:2]
    y, x = np.mgrid[:height, :width]
    x, y = x + flow[..., 0].astype(float), y + flow[..., 1].astype(float)
    return (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)


def difference(sample: Sample, use: np.ndarray, flow: np.ndarray) -> float:
    """Mean |frame 1 - frame 2 at the flow's target| over RGB, bilinear in float64, with replicated borders."""
    y, x = np.nonzero(use)
    u, v = flow[y, x].astype(float).T
    second = np.moveaxis(sample.frames[1].astype(float), -1, 0)
    warped = [map_coordinates(channel, (y + v, x + u), order=1, mode="nearest") for channel in second]
    return float(np.abs(sample.frames[0][y, x] - np.transpose(warped)).mean())


@pytest.mark.skipif(not rows(), reason="no shared data; set ROBUSTFLOW_SHARED to the folder that contains it")
@pytest.mark.parametrize("row", rows(), ids=lambda row: f"{row.folder}-{row.truth.split(' ')[0]}-{row.truth[-9:]}")
def test_real_pairs_have_the_statistics_of_the_manifest(row: Row) -> None:
    sample = sample_of(row)
    assert row.size == f"{sample.shape[1]}x{sample.shape[0]}"
    flow, valid = sample.flow, sample.valid
    if row.truth.startswith("flow_noc") and sample.occluded is not None:
        noc = MANIFEST.parent / row.folder / "training" / row.truth.split(" ")[0]
        flow, valid = read_flow(noc)  # KITTI 2012 has values in noc that differ from those in occ
        np.testing.assert_array_equal(valid & sample.valid, sample.valid & ~sample.occluded)
    magnitude = np.hypot(*np.moveaxis(flow[valid].astype(float), -1, 0))
    assert valid.mean() == pytest.approx(row.valid, abs=0.00051)
    assert magnitude.mean() == pytest.approx(row.mean, abs=0.0051)
    assert magnitude.max() == pytest.approx(row.largest, abs=0.051)
    use = valid & inside(flow)
    warp, negated, unmoved = (difference(sample, use, factor * flow) for factor in (1, -1, 0))
    assert warp < unmoved < negated
    assert (warp, unmoved) == pytest.approx((row.warp, row.no_warp), abs=0.011)


def test_motorcycle_is_the_pair_of_scikit_image() -> None:
    from skimage.data import stereo_motorcycle

    left, right, disparity = stereo_motorcycle()
    sample = load_dataset("motorcycle").load("motorcycle")
    np.testing.assert_array_equal(sample.frames[0], left)
    np.testing.assert_array_equal(sample.frames[1], right)
    np.testing.assert_array_equal(sample.valid, np.isfinite(disparity))
    np.testing.assert_array_equal(sample.flow[sample.valid, 0], -disparity[sample.valid])
    assert (sample.flow[..., 1] == 0).all()
    use = sample.valid & inside(sample.flow)
    warp, negated, unmoved = (difference(sample, use, factor * sample.flow) for factor in (1, -1, 0))
    assert warp < unmoved < negated
