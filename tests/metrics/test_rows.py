import json

import numpy as np
import polars as pl
import pytest
from hypothesis import given

from robustflow.core.types import Sample
from robustflow.metrics.regions import Regions
from robustflow.metrics.rows import ROW_SCHEMA, measure, rows_frame

from . import naive
from .strategies import cases

LABELS = ("sample", "group", "corruption", "severity", "truth", "frames_digest", "height", "width")
DIGEST = "truth_digest"
PHOTOMETRIC = ("n_photometric", "photometric_sum", "photometric_still_sum")


@given(cases(finite=False))
def test_every_column_equals_the_naive_loop(case):
    pred, clean, sample = case
    row = measure(pred, clean, sample, Regions.of(sample), corruption="fog", severity=2, frames_digest="ab")
    assert list(row) == list(ROW_SCHEMA)
    assert [row[name] for name in LABELS] == ["s", "s", "fog", 2, "unchanged", "ab", *sample.shape]
    expected = naive.row(pred, clean, sample.flow, sample.valid, sample.occluded)
    expected |= naive.photometric(*sample.frames, pred)
    for name in ROW_SCHEMA:
        if name in (*LABELS, DIGEST):
            continue
        if name not in expected:
            assert row[name] is None
        elif name == "wauc_sum" or name.startswith(("epe_sum_", "rcre_sum_", "clean_epe_sum_")):
            assert row[name] == pytest.approx(expected[name], rel=1e-12)
        else:
            assert row[name] == expected[name], name


@given(cases(finite=False))
def test_row_without_ground_truth_has_only_rcre_over_all_pixels_and_the_photometric_error(case):
    pred, clean, sample = case
    blind = Sample(sample.key, sample.frames)
    row = measure(pred, clean, blind, Regions.of(blind))
    seen = measure(pred, clean, sample, Regions.of(sample))
    everywhere = ("n_invalid", "n_all", "rcre_all_sum", "pred_magnitude_sum", *PHOTOMETRIC)
    for name in ROW_SCHEMA:
        assert row[name] == (seen[name] if name in (*LABELS, *everywhere) else None)


def test_truth_digest_names_the_known_vectors_and_nothing_else():
    rng = np.random.default_rng(8)
    frame = np.zeros((6, 7, 3), np.uint8)
    truth, pred = rng.normal(0, 20, (2, 6, 7, 2)).astype(np.float32)
    valid = rng.random((6, 7)) < 0.7

    def digest(flow, known, occluded=None, prediction=pred):
        sample = Sample("a", (frame, frame), flow, known, occluded)
        return measure(prediction, prediction, sample, Regions.of(sample))["truth_digest"]

    elsewhere, fewer, turned = np.where(valid[..., None], truth, 0), valid.copy(), np.asfortranarray(truth)
    fewer[np.unravel_index(valid.argmax(), valid.shape)] = False
    same = [
        digest(elsewhere, valid),
        digest(turned, valid),
        digest(truth, valid, ~valid),
        digest(truth, valid, None, 2 * pred),
    ]
    assert set(same) == {digest(truth, valid)}
    other = [digest(1.5 * truth, valid), digest(truth, fewer), digest(truth, ~valid), digest(-truth, valid)]
    assert len({*same, *other}) == 5
    without = Sample("a", (frame, frame))
    assert measure(pred, pred, without, None)["truth_digest"] is None


def test_memory_layout_changes_no_bit():
    rng = np.random.default_rng(5)
    pred, clean, truth = rng.normal(0, 20, (3, 40, 60, 2)).astype(np.float32)
    valid, occluded = rng.random((2, 40, 60)) < 0.6
    frame = np.zeros((40, 60, 3), np.uint8)
    rows = []
    for order in (np.ascontiguousarray, np.asfortranarray):
        sample = Sample("a", (frame, frame), order(truth), order(valid), order(occluded))
        rows.append(json.dumps(measure(order(pred), order(clean), sample, Regions.of(sample))))
    assert rows[0] == rows[1]


def test_frame_has_the_schema_and_survives_parquet(tmp_path):
    frame = np.zeros((4, 5, 3), np.uint8)
    flow = np.ones((4, 5, 2), np.float32)
    sample = Sample("a", (frame, frame), 0 * flow, np.ones((4, 5), np.bool_))
    blind = Sample("b", (frame, frame))
    rows = [measure(flow, flow, blind, None), measure(flow, 0 * flow, sample, Regions.of(sample))]
    table = rows_frame(rows)
    assert dict(table.schema) == ROW_SCHEMA
    table.write_parquet(tmp_path / "rows.parquet")
    assert pl.read_parquet(tmp_path / "rows.parquet").equals(table)
    assert table.rows(named=True) == rows
