"""Models that change little because they ignore their frames or miss the motion are not called robust."""

from __future__ import annotations

import cv2
import numpy as np
import polars as pl
import pytest

from robustflow.api import evaluate
from robustflow.metrics import Cube
from robustflow.metrics.measures import CLEAN_MEASURES
from robustflow.stats.exclusion import exclusion_reasons, exclusions, reasons_from_rows
from robustflow.testing import ConstantFlow
from tests.made_rows import made_run, rows_frame
from tests.run.mean_rows import row

from .simulated import PIXELS, compare_all, rows_of

_RNG = np.random.default_rng(3)
_HARD = _RNG.gamma(2, 1, 40)
_HARD /= _HARD.mean()


def _rows(
    clean: float, moved: float, motion: float = 50.0, truth: bool = True, hard: np.ndarray = _HARD
) -> pl.DataFrame:
    """Forty images with the given mean clean EPE, changes in error and in flow under corruption, and lengths of both
    flows."""
    rows = rows_of(clean * hard, (clean + moved) * hard[:, None] * np.ones(3), moved * hard[:, None] * np.ones(3))
    lengths = {name: pl.lit(motion * PIXELS) for name in ("magnitude_sum", "pred_magnitude_sum")}
    of_truth = [name for name in rows.columns if name in ("n_valid", "n_truth", "epe_sum", "magnitude_sum")]
    rows = rows.with_columns(**lengths)
    return rows if truth else rows.with_columns(pl.lit(None, rows.schema[name]).alias(name) for name in of_truth)


_USELESS, _SOUND = _rows(31.0, 0.5), _rows(13.0, 5.0)


CASES = {
    "sound": (_SOUND, []),
    "just below half of zero flow": (_rows(24.9, 5.0), []),
    "exactly half": (_rows(25.0, 5.0, hard=np.ones(40)), ["25.00 px", "50.00 px"]),
    "just above": (_rows(25.1, 5.0), ["25.10 px", "50.00 px"]),
    "far above": (_USELESS, ["31.00 px", "50.00 px"]),
    "nearly zero flow": (_rows(11.93, 0.02, motion=12.10), ["11.93 px", "12.10 px"]),
    "small motion": (_rows(0.2, 0.1, motion=0.3), ["0.20 px", "0.30 px"]),
    "small motion, better": (_rows(0.2, 0.1, motion=0.5), []),
    "changes by just over 0.1 %": (_rows(13.0, 0.0505), []),
    "by exactly 0.1 %": (_rows(13.0, 0.05, hard=np.ones(40)), ["50.00 px"]),
    "by just under": (_rows(13.0, 0.0495), ["50.00 px"]),
    "slow clip": (_rows(0.0024, 0.008, motion=0.24), []),
    "slow clip without truth": (_rows(0.0024, 0.008, motion=0.24, truth=False), []),
    "constant with noise": (_rows(0.5, 0.02), ["0.020 px"]),
    "constant with noise, without truth": (_rows(0.5, 0.02, truth=False), ["0.020 px"]),
    "constant": (_rows(0.5, 0.0), ["0.000 px"]),
    "slow constant without truth": (_rows(0.0024, 0.0, motion=0.24, truth=False), ["0.000 px"]),
    "a hundredth of the pixels left out": (_SOUND.with_columns(n_truth=pl.col("n_valid") * 100 // 99), []),
    "1.09 % left out": (_SOUND.with_columns(n_truth=pl.lit(1011)), ["1 %"]),
    "more left out": (_SOUND.with_columns(n_truth=pl.col("n_valid") * 50 // 49), ["1 %"]),
    "frames that no corruption changed": (_rows(1.0, 0.0).with_columns(frames_digest=pl.lit("same")), []),
}


@pytest.mark.parametrize(("rows", "numbers"), CASES.values(), ids=CASES)
def test_reasons_name_the_numbers_that_exclude_a_model(rows, numbers):
    reasons = reasons_from_rows(rows)
    assert len(reasons) == bool(numbers)
    assert all(number in reason for reason in reasons for number in numbers)


@pytest.mark.parametrize(("shorter", "excluded"), [(25.2, False), (25.0, False), (24.8, True)])
def test_flow_is_excluded_below_half_of_the_median_length_of_the_others(base, shorter, excluded):
    """Of the other models' 40, 50 and 100 px, the median is 50 and the mean 63 px."""
    lengths = {"a": 40.0, "b": 50.0, "c": 100.0, "short": shorter}
    runs = [made_run(base, _rows(0.0, 0.1 * px, px, truth=False), name) for name, px in lengths.items()]
    assert [run.name for run, why in zip(runs, exclusions(runs), strict=True) if why] == ["short"] * excluded


def test_guard_averages_over_images_with_unequal_numbers_of_pixels():
    """Clean errors of 1, 2 and 9 px over 10, 20 and 90 pixels: mean 4, median 2, over pixels 7.2 px."""
    pixels, errors, motion = (10, 20, 90), (1.0, 2.0, 9.0), (3.0, 6.0, 27.0)
    rows = rows_frame(
        row(name, n=n, epe=epe, magnitude_sum=length * n)
        for name, n, epe, length in zip("abc", pixels, errors, motion, strict=True)
    )
    assert Cube.of(rows).mean(CLEAN_MEASURES["zero_flow_epe"], "clean") == 12.0


def _explained(error: float, of_still: float, truth: bool = False) -> list[str]:
    """The reasons about a flow with a photometric error, where zero flow has the error `of_still`."""
    columns = {
        "n_photometric": pl.lit(100),
        "photometric_sum": 100.0 * error,
        "photometric_still_sum": 100.0 * of_still,
    }
    return reasons_from_rows(_rows(0.0, 5.0, truth=truth).with_columns(**columns))


@pytest.mark.parametrize("error", [18.1, 20.0, 31.0], ids=["much too short", "zero", "negated"])
def test_flow_that_explains_the_frames_no_better_than_zero_flow_is_excluded_without_ground_truth(error):
    (reason,) = _explained(error, 20.0)
    assert f"{error:.2f}" in reason
    assert "20.00" in reason


@pytest.mark.parametrize("given", [(17.0, 20.0, False), (18.0, 20.0, False), (31.0, 20.0, True), (0.0, 0.0, False)])
def test_flow_that_explains_the_frames_or_has_ground_truth_is_not_excluded(given):
    assert not _explained(*given)


@pytest.mark.parametrize(
    ("error", "motion", "doubted"),
    [
        *((9.9, 50.0, "ground truth"), (10.0, 50.0, "misses the motion"), (10.1, 50.0, "misses the motion")),
        *((9.9, 0.95, "motion this small"), (20.0, 0.95, "motion this small")),
        *((9.9, 1.0, "ground truth"), (20.0, 1.05, "misses the motion")),
    ],
)
def test_a_large_epe_is_due_to_small_motion_to_the_ground_truth_or_to_the_model(error, motion, doubted):
    rows = _rows(0.62 * motion, 5.0, motion).with_columns(
        n_photometric=pl.lit(100), photometric_sum=100.0 * error, photometric_still_sum=pl.lit(2000.0)
    )
    (reason,) = reasons_from_rows(rows)
    assert doubted in reason


class ScaledDis:
    """DIS with scaled flow; with a factor of 0.1, the flow also changes a tenth as much under corruption."""

    def __init__(self, factor: float) -> None:
        self._dis = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_ULTRAFAST)
        self._factor = factor

    def identity(self):
        return {"name": f"{self._factor:g} x DIS"}

    def predict(self, frame1, frame2):
        grey = (cv2.cvtColor(frame, cv2.COLOR_RGB2GRAY) for frame in (frame1, frame2))
        return np.float32(self._factor) * self._dis.calc(*grey, None)


@pytest.fixture(scope="module")
def measured_runs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("excluded")
    models = {"dis": ScaledDis(1.0), "most": ScaledDis(0.9), "tenth": ScaledDis(0.1)}
    models |= {"constant": ConstantFlow(-30.0, 0.0)}
    options = {"corruptions": ["gaussian_noise"], "severities": [3], "examples": False, "workers": 1}
    return {name: evaluate(model, "demo", output=folder / name, **options) for name, model in models.items()}


def test_a_tenth_of_dis_and_a_constant_vector_are_excluded_and_dis_is_not(measured_runs):
    """The constant is close to the pair's mean motion, so its error is below half that of zero flow although it ignores
    the frames.
    """
    assert not exclusion_reasons(measured_runs["dis"])
    assert measured_runs["tenth"].cre < 0.3 * measured_runs["dis"].cre
    assert "34.34 px" in exclusion_reasons(measured_runs["tenth"])[0]
    assert measured_runs["constant"].epe_clean < 0.5 * 34.34
    assert len(exclusion_reasons(measured_runs["constant"])) == 1


def test_compare_ranks_no_excluded_run(measured_runs, robustflow):
    paths = [run.path for run in measured_runs.values()]
    out = robustflow.prints("compare", *paths, "--format", "markdown")
    names = [line.split("|")[1].strip() for line in out.splitlines() if line.startswith("| ") and " to 2 |" in line]
    assert names == ["1 x DIS", "0.9 x DIS"]


def test_many_models_are_compared_over_what_all_of_them_measured():
    """One run has only a third of the conditions; a mean over three conditions must not be compared with a mean over
    one."""
    part = _rows(5.0, 2.0).filter(pl.col("corruption").is_in(["clean", "snow"]))
    lines = compare_all({"a": _USELESS, "b": _SOUND, "c": part})
    values = {}
    for line in lines.iter_rows(named=True):
        for side in ("model", "against"):
            values.setdefault(line[side], set()).add(line[f"value_{side}"])
    assert {name: len(found) for name, found in values.items()} == {"a": 1, "b": 1, "c": 1}
    assert values["b"].pop() == pytest.approx(5)
