"""Damaged, changed and forged records fail, each at the right check."""

from __future__ import annotations

import json

import polars as pl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robustflow.api import evaluate
from robustflow.core.files import digest_of_value, json_bytes
from robustflow.core.files import sealed as with_digest
from robustflow.metrics.rows import ROW_SCHEMA
from robustflow.run.records.format import container_bytes, rows_from_text
from robustflow.run.records.pack import record_bytes
from robustflow.run.records.verify import CHECKS, verify
from robustflow.testing import ZeroFlow

from .forge import assert_fails, at, entries_of, failure, put, verified, with_json, with_rows

_FOG = (pl.col("corruption") == "fog") & (pl.col("severity") == 5)
_PLANNED = ("planned", 0, "corruptions")


def test_valid_record_verifies_and_states_its_subject(run, packed, tmp_path):
    (tmp_path / "a.robustflow").write_bytes(packed)
    found = verify(tmp_path / "a.robustflow")
    assert found.ok, found.first_failure()
    assert [check.name for check in found.checks] == list(CHECKS)
    assert found.facts.author == "Ada"
    assert found.subject.cre == pytest.approx(run.cre)
    assert found.subject.model == "Farneback"
    assert (found.subject.setting, found.subject.pairs) == ("knowledge", 1)
    assert len(found.unproven) == 3


def test_a_missing_file_is_a_failed_check(tmp_path):
    found = verify(tmp_path / "nowhere.robustflow")
    assert [check.status for check in found.checks] == ["failed", *["not checked"] * (len(found.checks) - 1)]


def _rows(edit):
    return lambda data: with_rows(data, edit)


def _manifest(*path, value):
    return lambda data: with_json(data, "manifest.json", put(*path, value=value))


def _record(**fields):
    return lambda data: with_json(data, "record.json", lambda record: record.update(fields))


def _identity(*path, value):
    """Change the identity and its digest."""

    def forge(data):
        entries = entries_of(data)
        manifest = json.loads(entries["manifest.json"])
        put(*path, value=value)(manifest["identity"])
        manifest["identity_digest"] = digest_of_value(manifest["identity"])
        return container_bytes(entries | {"manifest.json": json_bytes(with_digest(manifest))})

    return forge


def _text(old, new):
    """Replace text in the rows."""

    def forge(data):
        entries = entries_of(data)
        return container_bytes(entries | {"rows.csv": entries["rows.csv"].replace(old, new)})

    return forge


def _too_large(data):
    """A small manifest that implies more cells than fit into memory."""

    def edit(manifest):
        manifest["samples"] = {str(index): [] for index in range(20_000)}
        every = {f"c{index}": [1, 2, 3, 4, 5] for index in range(1000)}
        manifest["planned"] = [{"samples": list(manifest["samples"]), "corruptions": every}]

    return with_json(data, "manifest.json", edit)


EVERY = pl.lit(True)
FORGED = {
    "record": [
        *(_record(version=value) for value in (3, 5, 10**400, "4", True, 0)),
        _record(format="zip"),
        _record(more=1),
        _record(author="\x1b[31m"),
        _record(author="x" * 201),
        _record(description="x" * 10_000),
        _record(link="javascript:alert(1)"),
        _record(complete="yes"),
    ],
    "manifest": [
        _too_large,
        *(_manifest(*_PLANNED, "fog", value=value) for value in ([0, 1, 5], [1, 5, 6], [5, 1])),
        _manifest(*_PLANNED, value={}),
        _manifest("planned", value=[]),
        _manifest("provenance", value={"setting": "OOD"}),
        _manifest("training", "sets", value="best"),
        _manifest("identity", "frames", "seed", value=1),
        _manifest("identity", "extra", value=1),
        _manifest("identity_digest", value="../../x"),
        _manifest("version", value=True),
        _manifest("places", value={"a host": 3}),
        _manifest("unknown", value=1),
        _manifest("environment", "command", value=["robustflow"]),
        _manifest("samples", "motorcycle", value=[["a.png", "1"]]),
        _manifest("samples", value={"x" * 10_000: []}),
        _manifest("environment", "packages", value={"numpy": "\x1b[31m2"}),
        _manifest("environment", "packages", value={"\x9b31m": "2"}),
        _manifest("started", value="a\nb"),
        _identity("frames", "streams", value=0),
        _identity("measuring", "rows", value=1),
    ],
    "rows": [
        *(_rows(at(_FOG, epe_sum=pl.lit(value))) for value in (float("nan"), float("inf"), -1.0)),
        *(_rows(at(_FOG, n_all=pl.lit(value, pl.Int64))) for value in (-1, 2**60, None)),
        _rows(at(_FOG, pred_magnitude_sum=pl.lit(None, pl.Float64))),
        *(_rows(at(_FOG, frames_digest=pl.lit(value))) for value in ("../x", "A" * 32, "0" * 32)),
        *(_rows(at(_FOG, sample=pl.lit(value))) for value in ("\x1b]0;owned\x07", "x" * 1_000, "")),
        _rows(at(_FOG, group=pl.lit("a\u202eb"))),
        _rows(at(_FOG, corruption=pl.lit("x" * 10_000))),
        _rows(at(_FOG, truth=pl.lit("moved"))),
        _rows(at(_FOG, truth_digest=pl.lit(None, pl.String))),
        _rows(at(_FOG, fl_count=pl.col("n_valid") + 1)),
        _rows(lambda rows: pl.concat([rows, rows.filter(_FOG)])),
        _rows(lambda rows: rows.clear()),
        _text(b"\n", b"\r\n"),
        *(_text(b"fog,1,", new) for new in (b"fog,01,", b"fog,1.0,", b'"fog",1,', b'"fog,1,', b"fog, 1,")),
        *(_text(b"fog,1,", new) for new in (b"fog,1,extra,", b"fog,", b"fog,1\0,")),
        _text(b"sample,group", b"group,sample"),
        _text(b"epe_sum,", b"epe_sum,more,"),
        _text(b"fog", b"\xff\xfe"),
        _text(b"\nmotorcycle", b"\n\nmotorcycle"),
    ],
    "training": [
        _manifest("training", "sets", value=["flyingchairs"]),
        _manifest("training", value={"basis": "declared", "sets": ["x"]}),
        _identity("model", value={"settings": {"name": "mine"}}),  # unlike what is known about the name
    ],
    "cells": [
        _record(complete=False),
        *(_manifest(*_PLANNED, name, value=[1]) for name in ("fogg", "fog+", "fog:2")),
        _manifest("left_out", value={"fog": [5]}),
        _manifest("left_out", value={"fogg": [5]}),
        _rows(at(EVERY, frames_digest=pl.lit("ab" * 16))),
        _rows(at(EVERY, frames_digest=pl.col("frames_digest").first())),
        _rows(lambda rows: pl.concat([rows, rows.filter(_FOG).with_columns(severity=pl.lit(3, pl.Int64))])),
        _rows(lambda rows: rows.filter(~_FOG)),
        _rows(lambda rows: rows.filter(corruption="fog")),
        _rows(at(_FOG, sample=pl.lit("other"))),
        _rows(at(_FOG, n_invalid=pl.lit(1, pl.Int64), n_all=pl.col("n_all") - 1)),
    ],
}
"""Changes of a record, by the first check that fails."""


@pytest.mark.parametrize(("check", "forge"), [(check, forge) for check, every in FORGED.items() for forge in every])
def test_forged_record_fails_a_check(packed, check, forge):
    assert forge(packed) != packed
    found = verified(forge(packed))
    assert failure(found)[0] == check
    assert [one.status for one in found.checks].count("ok") == list(CHECKS).index(check)
    assert found.subject is None


def test_a_few_equal_frames_are_possible(packed):
    """A corruption that changes nothing (a flat frame, a stream in which no bit was flipped) is not a forgery."""
    same = with_rows(packed, at(_FOG & (pl.col("severity") == 5), frames_digest=pl.col("frames_digest").first()))
    assert verified(same).ok


def test_removed_number_is_detected(packed):
    rows = rows_from_text(entries_of(packed)["rows.csv"])
    measured = [name for name, kind in ROW_SCHEMA.items() if kind is not pl.String and rows[name].null_count() == 0]
    assert len(measured) > 40
    cells = [(name, _FOG) for name in measured]
    cells += [(name, pl.col("corruption") == "clean") for name in ("n_all", "n_valid", "epe_sum", "fl_count_s10_40")]
    for name, where in cells:
        failure(with_rows(packed, at(where, **{name: pl.lit(None, ROW_SCHEMA[name])})))


@pytest.mark.parametrize("name", ["record.json", "manifest.json"])
@pytest.mark.parametrize(
    "text",
    [
        b"[1]\n",
        b"[" * 60_000,
        *(b'{"a":' * depth + b"1" + b"}" * depth for depth in (300, 10_000)),
        b'{"cre": NaN}\n',
        b'{\n  "cre": 1,\n  "cre": 2\n}\n',
        b'{"a": "\xff"}',
        b'{"a": "\\ud800"}',
        b'{"a": ' + b"9" * 5_000 + b"}",
    ],
)
def test_invalid_json_fails(packed, name, text):
    entries = entries_of(packed)
    assert failure(container_bytes(entries | {name: text}))[0] in ("record", "manifest")


def test_cost_of_a_different_run_fails(packed):
    entries = entries_of(packed)
    cost = dict.fromkeys(("version", "height", "width", "parameters", "macs", "thop_parameters", "thop_macs"), 1)
    cost |= {"run": "0" * 16, "iterations": None, "seconds": None, "peak_bytes": None, "device": None}
    other, negative = (json_bytes(with_digest(cost | change)) for change in ({}, {"parameters": -1}))
    for data in (other, negative, json_bytes(cost)):
        assert "profile.json" in failure(container_bytes(entries | {"profile.json": data}))[1]
    fitting = cost | {"run": json.loads(entries["manifest.json"])["identity_digest"]}
    assert verified(container_bytes(entries | {"profile.json": json_bytes(with_digest(fitting))})).ok


@settings(max_examples=60)
@given(st.data())
def test_arbitrary_content_gives_a_failed_check_and_no_exception(packed, data):
    """Records with randomly cut and pasted entries are verified or refused with a message, never
    with an exception.
    """
    entries = entries_of(packed)
    name = data.draw(st.sampled_from([n for n in entries if n != "record.json"]))
    text = entries[name]
    start = data.draw(st.integers(0, len(text)))
    stop = data.draw(st.integers(start, min(len(text), start + 40)))
    words = [b"", b",", b"\n", b'"', b"null", b"-1", b"1e400", b"9" * 30, b"{", b"]", b"\0", b"\xff", b"NaN", b"true"]
    pasted = data.draw(st.sampled_from(words) | st.binary(max_size=8))
    changed = text[:start] + pasted + text[stop:]
    found = verified(container_bytes(entries | {name: changed}))
    if not found.ok:
        assert changed != text
        failure(found)


def test_declared_training_sets_are_shown(tmp_path):
    class Mine(ZeroFlow):
        trained_on = "C+T"

        def identity(self):
            return {"name": "mine"}

    run = evaluate(Mine(), "demo", output=tmp_path / "run", corruptions=["fog"], severities=[1])
    data = record_bytes(run)
    assert verified(data).ok
    for change in (
        {"sets": ["anything"]},
        {"sets": []},
        {"basis": "undeclared"},
        {"basis": "method", "sets": None},
    ):
        forged = with_json(data, "manifest.json", lambda manifest, change=change: manifest["training"].update(change))
        assert_fails(forged, "training")


def test_plan_that_contradicts_the_severities_of_its_scale_fails(tmp_path):
    options = {"corruptions": ["saturate", "fog"], "severities": [1, 5], "severity_scale": "calibrated"}
    run = evaluate("dis", "demo", output=tmp_path / "run", **options)
    assert run.left_out
    data = record_bytes(run)
    assert verified(data).ok
    without_fog = put("left_out", value={"fog": [5], **run.left_out})
    assert_fails(with_json(data, "manifest.json", without_fog), "cells")
    assert_fails(with_json(data, "manifest.json", put(*_PLANNED, "saturate", value=[1, 5])), "cells")


def test_verification_leaves_no_temporary_file(packed, tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    assert verified(packed).ok
    assert not verified(with_rows(packed, at(_FOG, n_invalid=pl.lit(1, pl.Int64)))).ok
    assert not list(tmp_path.iterdir())
