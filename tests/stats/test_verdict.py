"""No adversarial model leads over DIS or is called better; real runs on 16 pairs, and simulated rows."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
import polars as pl
import pytest

from robustflow.api import evaluate
from robustflow.models import load_model
from robustflow.run.run import Run
from robustflow.stats.estimate import OVERALL_SCOPES, contrast, cubes_of
from robustflow.stats.exclusion import exclusions
from robustflow.stats.paired import better_of, is_sure
from robustflow.stats.verdict import compared, verdict_of

from .simulated import PIXELS, rows_of

Change = Callable[[np.ndarray], np.ndarray]
_RNG = np.random.default_rng(0)
_HARD = _RNG.gamma(4, 0.25, 40)


def _noise(fixed: bool) -> Change:
    stream = np.random.default_rng(1)

    def change(flow: np.ndarray) -> np.ndarray:
        rng = np.random.default_rng(0) if fixed else stream
        return flow + rng.normal(0, 2, flow.shape).astype(np.float32)

    return change


def _outliers(size: float) -> Change:
    def change(flow: np.ndarray) -> np.ndarray:
        chosen = np.random.default_rng(0).random(flow.shape[:2]) < 0.01
        return np.where(chosen[..., None], np.float32(size), flow)

    return change


def _abstaining(flow: np.ndarray) -> np.ndarray:
    edges = np.hypot(*np.gradient(flow[..., 0])) + np.hypot(*np.gradient(flow[..., 1]))
    return np.where((edges > np.quantile(edges, 0.995))[..., None], np.float32(np.nan), flow)


def _clipped(flow: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(flow, axis=-1, keepdims=True)
    return np.where(length > 3, flow * (3 / np.maximum(length, 1)), flow)


def _untrained(frames: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """Random filters of both frames, as in a network without training."""
    both = cv2.GaussianBlur(np.concatenate(frames, axis=2)[..., :3].astype(np.float32) / 255, (0, 0), 4)
    return both @ np.random.default_rng(0).normal(0, 3, (3, 2)).astype(np.float32)


CHANGES: dict[str, Change] = {
    "DIS": lambda flow: flow,
    "fixed noise": _noise(fixed=True),
    "noise of every call": _noise(fixed=False),
    "0.9 x": lambda flow: np.float32(0.9) * flow,
    "clipped": _clipped,
    "constant": lambda flow: np.full_like(flow, 1.0),
    "abstains": _abstaining,
    "outliers of 1e5": _outliers(1e5),
    "outliers of 1e30": _outliers(1e30),
    "untrained": lambda flow: flow,
}


class Changed:
    """DIS with a changed flow."""

    def __init__(self, name: str) -> None:
        self._name, self._change, self._dis = name, CHANGES[name], load_model("dis")

    def predict(self, first: np.ndarray, second: np.ndarray) -> np.ndarray:
        if self._name == "untrained":
            return _untrained((first, second))
        return self._change(self._dis.predict(first, second)).astype(np.float32)

    def identity(self) -> dict[str, str]:
        return {"name": self._name}


@pytest.fixture(scope="module")
def runs(tmp_path_factory) -> dict[str, Run]:
    options = {"corruptions": ["fog", "gaussian_noise"], "severities": [3], "limit": 16, "examples": False}
    options |= {"data_options": {"size": "64x96"}, "workers": 1, "allow_invalid": True}
    return {name: evaluate(Changed(name), "shapes", output=tmp_path_factory.mktemp("v"), **options) for name in CHANGES}


ADVERSARIES = [name for name in CHANGES if name != "DIS"]
MISSES, OUTLIERS = "zero flow", "outliers"
REASONS = {"constant": MISSES, "untrained": MISSES, "outliers of 1e5": OUTLIERS, "outliers of 1e30": OUTLIERS}


@pytest.mark.parametrize("name", ADVERSARIES)
def test_no_adversary_leads_over_dis_or_is_called_better(runs, name):
    rows = {model: runs[model].rows for model in ("DIS", name)}
    verdict = verdict_of(compared(rows))
    if name == "abstains":
        assert runs[name].epe < runs["DIS"].epe
        assert (verdict.kind, set(verdict.names)) == ("not decided", {"DIS", name})
        assert any("fewer pixels" in remark for remark in verdict.remarks)
    else:
        assert (verdict.kind, verdict.names) == ("leads", ("DIS",))
        assert any(name in remark and "CRE" in remark for remark in verdict.remarks)
    tests = contrast(cubes_of(rows), scopes=OVERALL_SCOPES).filter(measure="epe")
    assert not [row for row in tests.iter_rows(named=True) if is_sure(row) and better_of(row) == name]
    (reason,) = exclusions([runs[name]])
    assert REASONS.get(name, "") in reason
    assert len(reason) < 400
    if REASONS.get(name) == OUTLIERS:
        assert "hardly" not in reason


def _blind(rows: pl.DataFrame) -> pl.DataFrame:
    """The rows as without ground truth."""
    of_truth = ("n_valid", "n_truth", "epe_sum", "clean_epe_sum", "magnitude_sum", "rcre_sum", "truth_digest")
    return rows.with_columns(pl.lit(None, rows.schema[name]).alias(name) for name in of_truth)


@pytest.mark.parametrize("name", ["constant", "untrained", "0.9 x", "clipped"])
def test_without_ground_truth_the_lowest_rcre_alone_crowns_nobody(runs, name):
    rows = {model: _blind(runs[model].rows) for model in ("DIS", name)}
    assert runs[name].rcre < runs["DIS"].rcre
    verdict = verdict_of(compared(rows))
    assert verdict.measures == ("rcre", "photometric")
    assert (verdict.kind, verdict.names) == ("not decided", (name, "DIS"))
    assert any("grey levels" in remark for remark in verdict.remarks)


def _model(clean: float, corrupted: float, moved: float = 1.0, error: float | None = None) -> pl.DataFrame:
    """Forty images with the given mean errors; with a photometric error, without ground truth."""
    spread = _HARD[:, None] * _RNG.gamma(50, 1 / 50, (40, 3))
    rows = rows_of(clean * _HARD, corrupted * spread, moved * spread)
    if error is None:
        return rows
    hard = pl.col("sample").cast(pl.Int64).map_elements(lambda number: float(_HARD[number]), return_dtype=pl.Float64)
    total = pl.when(pl.col("severity") == 0).then(clean * hard * PIXELS).otherwise(error * hard * PIXELS)
    return _blind(rows).with_columns(n_photometric=pl.lit(PIXELS), photometric_sum=total)


A, B, C = _model(2, 4), _model(2, 8), _model(1, 8)
CASES = {
    "lower on both": ({"a": A, "b": B}, "leads", ("a",)),
    "better on the clean frames": ({"a": A, "b": B, "c": C}, "trade-off", ("a", "c")),
    "equal": ({"a": A, "b": B, "d": A}, "not decided", ("a", "d")),
    "one": ({"a": A}, "not tested", ()),
    "none": ({}, "not tested", ()),
    "no difference that can be seen": ({"a": _model(2e-4, 4e-4), "b": _model(2e-4, 8e-4)}, "not decided", ("a", "b")),
    "five images": (
        {name: rows.filter(pl.col("sample") < "00005") for name, rows in (("a", A), ("b", B))},
        *("not decided", ("a", "b")),
    ),
    "blind, both agree": ({"a": _model(2, 4, 1, 4), "b": _model(2, 4, 3, 8)}, "leads", ("a",)),
    "blind, clean flow worse": ({"a": _model(3, 4, 1, 4), "b": _model(2, 4, 3, 8)}, "trade-off", ("a", "b")),
    "blind, they disagree": ({"a": _model(2, 4, 1, 8), "b": _model(2, 4, 3, 4)}, "not decided", ("a", "b")),
}


@pytest.mark.parametrize(("rows", "kind", "names"), CASES.values(), ids=CASES)
def test_who_leads(rows, kind, names):
    verdict = verdict_of(compared(rows))
    assert (verdict.kind, verdict.names) == (kind, names)
    assert bool(verdict.sentence) == (len(rows) > 1)


def _blown_up(corrupted: bool) -> pl.DataFrame:
    """A with errors that are a tenth lower, but 20 times as large on one image, either under corruption or without."""
    factor = pl.when(pl.col("sample") == "00000").then(20.0).otherwise(0.9)
    changed = pl.when((pl.col("severity") > 0) == corrupted).then(factor).otherwise(1.0)
    return A.with_columns(epe_sum=pl.col("epe_sum") * changed)


@pytest.mark.parametrize("corrupted", [True, False])
def test_blow_ups_under_corruption_are_named_beside_a_tie(corrupted):
    assert len(verdict_of(compared({"a": A, "d": _blown_up(corrupted)})).remarks) == corrupted
