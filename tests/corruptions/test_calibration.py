"""Calibrated severities, and SSIM compared with a naive float64 loop."""

import hashlib
import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import skimage

import robustflow as rf
from robustflow.core.errors import DataError, UsageError
from robustflow.core.files import sealed
from robustflow.corruptions import IMAGE_PAIR, SEVERITIES, load_corruption
from robustflow.corruptions.api import stream_for
from robustflow.corruptions.condition import condition_of
from robustflow.corruptions.scale import (
    CALIBRATION_VARIABLE,
    calibrated_levels,
    calibration_digest,
    read_table,
    shipped,
)
from robustflow.data.benchmarks import load_benchmark
from robustflow.media.images import read_image, write_image
from robustflow.report.gallery.ssim import Ssim
from robustflow.run.config import FrameOptions, RunConfig
from robustflow.run.plan import Plan
from robustflow.run.stages import frames_digest
from robustflow.testing import ZeroFlow

from ..refusals import refusal

GAPS = {name: levels for name in IMAGE_PAIR if (levels := calibrated_levels(name)) != SEVERITIES}
GAP = next(iter(GAPS))
MISSING = next(s for s in SEVERITIES if s not in GAPS[GAP])


def _reference(name):
    return read_image(Path(skimage.__file__).parent / "data" / name)


def test_the_shipped_table_covers_every_image_pair_corruption_and_says_how_it_was_made():
    table = shipped()
    assert set(IMAGE_PAIR) | {"elastic_transform"} == set(table.corruptions)
    for name, digest in table.images.items():
        assert hashlib.sha256(_reference(name).tobytes()).hexdigest() == digest
    for found in table.corruptions.values():
        low, high = found.reachable
        for level, target in zip(found.levels, table.targets, strict=True):
            assert low <= level.ssim <= high
            assert (level.parameter is None) == (abs(level.ssim - target) > table.tolerance)
    full = [name for name in table.corruptions if calibrated_levels(name) == SEVERITIES]
    assert len(full) >= 0.8 * len(table.corruptions)


def _mean_ssim(name, severity):
    """Return the mean SSIM of a shipped level on the reference set, computed using only public functions."""
    corruption = load_corruption(name, scale="calibrated")
    values = []
    for key in shipped().images:
        picture = _reference(key)
        for draw in range(shipped().draws):
            state = corruption.draw(
                stream_for(corruption, 1, shipped().seed, f"{key}/{draw}"), severity, picture.shape[:2]
            )
            index = getattr(state, "exposed", None) or 0
            values.append(Ssim(picture)(corruption.apply(picture, state, index)))
    return np.mean(values)


@pytest.mark.parametrize(
    ("name", "levels"),
    [("contrast", (3,)), ("impulse_noise", (5,)), ("under_exposure", (2,))]
    + [pytest.param(name, calibrated_levels(name), marks=pytest.mark.slow) for name in shipped().corruptions],
)
def test_shipped_levels_have_the_ssim_they_claim(name, levels):
    for severity in levels:
        claimed = shipped().corruptions[name].levels[severity - 1].ssim
        assert _mean_ssim(name, severity) == pytest.approx(claimed, abs=1e-6)


@pytest.mark.parametrize(
    "change",
    [
        lambda t: t.update(targets=[0.6, 0.7, 0.8, 0.9, 0.95]),
        lambda t: t.update(version=1),
        lambda t: t["corruptions"]["fog"]["levels"].pop(),
        lambda t: t["corruptions"]["fog"]["levels"][0].update(ssim=0.5),
        lambda t: t.update(hidden=1),
    ],
)
def test_a_damaged_table_is_refused(tmp_path, change):
    document = shipped().model_dump(mode="json")
    change(document)
    (tmp_path / "table.json").write_text(json.dumps(sealed(document)))
    refusal(lambda: read_table(tmp_path / "table.json"), DataError, tmp_path / "table.json")


def test_stack_has_the_severities_of_all_its_parts():
    assert condition_of(f"contrast+{GAP}").levels(SEVERITIES, "calibrated") == GAPS[GAP]
    stack = load_corruption(f"contrast+{GAP}", scale="calibrated")
    refusal(lambda: stack.parameter(MISSING), UsageError, stack.name)


def test_a_run_leaves_gaps_out_and_says_so(tmp_path):
    have = GAPS[GAP][0]
    ask = {"corruptions": [GAP, "contrast"], "severities": [MISSING, have], "severity_scale": "calibrated"}
    result = rf.evaluate(ZeroFlow(), output=tmp_path / "run", **ask)
    assert result.left_out == {GAP: (MISSING,)}
    assert result.measured.complete
    assert result.measured.corruptions[GAP] == [have]
    assert result.measured.corruptions["contrast"] == sorted([MISSING, have])
    frames = load_benchmark("demo").dataset.load("motorcycle").frames
    row = result.rows.filter((result.rows["corruption"] == "contrast") & (result.rows["severity"] == have))
    corrupted = rf.corrupt(*frames, "contrast", have, key="motorcycle", scale="calibrated")
    assert row["frames_digest"].item() == frames_digest(corrupted)
    assert rf.evaluate(ZeroFlow(), output=tmp_path / "run", **ask).left_out == result.left_out
    with pytest.raises(rf.RobustFlowError):
        rf.evaluate(ZeroFlow(), output=tmp_path / "run", corruptions=["contrast"], severities=[have])


def test_run_without_any_remaining_condition_is_refused(tmp_path):
    with pytest.raises(UsageError):
        rf.evaluate(
            ZeroFlow(), output=tmp_path / "run", corruptions=[GAP], severities=[MISSING], severity_scale="calibrated"
        )
    assert not (tmp_path / "run").exists()


def test_the_scale_is_part_of_a_runs_identity_and_the_papers_changes_none(monkeypatch, tmp_path):
    benchmark = load_benchmark("demo")

    def identity(scale):
        return Plan(benchmark, config=RunConfig(frames=FrameOptions(severity_scale=scale))).identity

    paper, calibrated = identity("paper"), identity("calibrated")
    assert "severity_scale" not in paper.record()["frames"]
    assert paper.digest() == Plan(benchmark).identity.digest() != calibrated.digest()
    before = calibrated.digest(), calibration_digest()
    document = shipped().model_dump(mode="json")
    document["seed"] += 1
    (tmp_path / "mine.json").write_text(json.dumps(sealed(document)))
    monkeypatch.setenv(CALIBRATION_VARIABLE, str(tmp_path / "mine.json"))
    assert calibration_digest() != before[1]
    assert identity("calibrated").digest() != before[0]


def test_the_command_refuses_a_severity_that_the_scale_lacks(tmp_path, robustflow):
    for name in ("a.png", "b.png"):
        write_image(tmp_path / name, _reference("chelsea.png")[60:156, 90:210])
    corrupt = ("corrupt", "a.png", "b.png", "-c", GAP, "-s", MISSING, "--severity-scale", "calibrated")
    assert GAP in robustflow.refuses(*corrupt)
    assert not Path("corrupted").exists()


def naive_ssim(a, b):
    """Compute the SSIM of one window at a time, using the formula (Wang et al. 2004, Eq. 13)."""
    x, y = (cv2.cvtColor(image, cv2.COLOR_RGB2GRAY).astype(np.float64) for image in (a, b))
    line = np.exp(-(np.arange(-5, 6) ** 2) / (2 * 1.5**2))
    weights = np.outer(line, line) / line.sum() ** 2
    padded = [np.pad(image, 5, mode="reflect") for image in (x, y)]
    c1, c2 = (0.01 * 255) ** 2, (0.03 * 255) ** 2
    values = []
    for i in range(x.shape[0]):
        for j in range(x.shape[1]):
            p, q = (image[i : i + 11, j : j + 11] for image in padded)
            mp, mq = (weights * p).sum(), (weights * q).sum()
            vp, vq = (weights * (p - mp) ** 2).sum(), (weights * (q - mq) ** 2).sum()
            cov = (weights * (p - mp) * (q - mq)).sum()
            values.append((2 * mp * mq + c1) * (2 * cov + c2) / ((mp**2 + mq**2 + c1) * (vp + vq + c2)))
    return np.mean(values)


@pytest.mark.parametrize("shape", [(24, 31), (11, 16), (7, 40)])
@pytest.mark.parametrize("deviation", [2.0, 30.0, 200.0])
def test_a_naive_loop_agrees(shape, deviation):
    rng = np.random.default_rng(3)
    frame = cv2.GaussianBlur(rng.integers(0, 256, (*shape, 3)).astype(np.uint8), (3, 3), 1.0)
    other = np.clip(frame + rng.normal(0, deviation, frame.shape), 0, 255).astype(np.uint8)
    assert Ssim(frame)(other) == pytest.approx(naive_ssim(frame, other), abs=1e-9)
    assert Ssim(frame)(frame) == 1.0
