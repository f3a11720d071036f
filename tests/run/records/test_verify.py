"""Damaged, changed and forged records fail, each at the right check."""

from __future__ import annotations

import json
from functools import reduce

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

from .forge import assert_fails, at, entries_of, failure, put, sealed, verified, with_json, with_rows

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
    assert (found.subject.setting, found.subject.pairs, found.subject.corruptions) == ("knowledge", 1, 2)
    assert len(found.unproven) == 3


def test_a_missing_file_is_a_failed_check(tmp_path):
    found = verify(tmp_path / "nowhere.robustflow")
    assert [check.status for check in found.checks] == ["failed", *["not checked"] * (len(found.checks) - 1)]


@pytest.mark.parametrize("name", ["manifest.json", "rows.csv"])
def test_entry_changed_without_its_hash_fails(packed, name):
    entries = entries_of(packed)
    changed = bytearray(entries[name])
    changed[len(changed) // 2] ^= 1
    check, message = failure(container_bytes(entries | {name: bytes(changed)}))
    assert (check, message.partition(":")[0]) == ("hashes", name)


@pytest.mark.parametrize(
    ("check", "edit"),
    [
        ("rows", at(_FOG, epe_sum=pl.lit(float("nan")))),
        ("rows", at(_FOG, epe_sum=pl.lit(float("inf")))),
        ("rows", at(_FOG, epe_sum=pl.lit(-1.0))),
        ("rows", at(_FOG, n_valid=pl.lit(-1, pl.Int64))),
        ("rows", at(_FOG, n_all=pl.lit(2**60, pl.Int64))),
        ("rows", at(_FOG, n_all=pl.lit(None, pl.Int64))),
        ("rows", at(_FOG, pred_magnitude_sum=pl.lit(None, pl.Float64))),
        ("rows", at(_FOG, frames_digest=pl.lit("../x"))),
        ("rows", at(_FOG, frames_digest=pl.lit("A" * 32))),
        ("rows", at(_FOG, sample=pl.lit("\x1b]0;owned\x07"))),
        ("rows", at(_FOG, group=pl.lit("a\u202eb"))),
        ("rows", at(_FOG, corruption=pl.lit("x" * 10_000))),
        ("rows", at(_FOG, sample=pl.lit("x" * 1_000))),
        ("rows", lambda rows: pl.concat([rows, rows.filter(_FOG)])),
        ("rows", lambda rows: rows.clear()),
        ("rows", at(pl.lit(True), frames_digest=pl.lit("0" * 32))),
        ("cells", at(pl.lit(True), frames_digest=pl.lit("ab" * 16))),
        ("cells", at(pl.lit(True), frames_digest=pl.col("frames_digest").first())),
        (
            "cells",
            lambda rows: pl.concat([rows, rows.filter(_FOG).with_columns(severity=pl.lit(3, pl.Int64))]),
        ),
        ("cells", lambda rows: rows.filter(~_FOG)),
        ("cells", at(_FOG, sample=pl.lit("other"))),
        ("cells", lambda rows: rows.filter(corruption="fog")),
        ("cells", at(_FOG, n_invalid=pl.lit(1, pl.Int64), n_all=pl.col("n_all") - 1)),
        ("rows", at(_FOG, truth=pl.lit("moved"))),
        ("measurements", at(_FOG, truth=pl.lit("none"))),
        ("measurements", at(_FOG, rcre_sum=pl.lit(0.0))),
        ("measurements", at(_FOG, epe_sum=pl.col("epe_sum") / 2)),
        ("measurements", at(_FOG, height=pl.col("height") + 1)),
        ("measurements", at(_FOG, magnitude_sum=pl.col("magnitude_sum") + 1)),
        ("measurements", at(_FOG, fl_count=pl.lit(0, pl.Int64))),
    ],
)
def test_changed_rows_whose_hashes_fit_fail_a_check(packed, check, edit):
    assert_fails(with_rows(packed, edit), check)


def test_record_with_unplanned_cells_has_no_subject(packed):
    found = verified(with_rows(packed, lambda rows: rows.with_columns(sample=pl.lit("other"))))
    assert failure(found)[0] == "cells"
    assert found.subject is None
    status = {check.name: check.status for check in found.checks}
    assert status["measurements"] == "not checked"


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


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (b"\n", b"\r\n"),
        (b"fog,1,", b"fog,01,"),
        (b"fog,1,", b"fog,1.0,"),
        (b"fog,1,", b'"fog",1,'),
        (b"fog,1,", b"fog, 1,"),
        (b"fog,1,", b"fog,1,extra,"),
        (b"fog,1,", b"fog,"),
        (b"fog,1,", b"fog,1\0,"),
        (b"sample,group", b"group,sample"),
        (b"epe_sum,", b"epe_sum,more,"),
        (b"fog", b"\xff\xfe"),
        (b"fog,1,", b'"fog,1,'),
        (b"\nmotorcycle", b"\n\nmotorcycle"),
    ],
)
def test_rows_in_a_different_notation_fail(packed, old, new):
    entries = entries_of(packed)
    changed = entries["rows.csv"].replace(old, new)
    assert changed != entries["rows.csv"]
    assert_fails(sealed(entries | {"rows.csv": changed}), "rows")


@pytest.mark.parametrize(
    ("path", "value", "check"),
    [
        ((*_PLANNED, "fogg"), [1], "cells"),
        ((*_PLANNED, "fog+"), [1], "cells"),
        ((*_PLANNED, "fog:2"), [1], "cells"),
        ((*_PLANNED, "fog"), [0, 1, 5], "manifest"),
        ((*_PLANNED, "fog"), [1, 5, 6], "manifest"),
        ((*_PLANNED, "fog"), [5, 1], "manifest"),
        (_PLANNED, {}, "manifest"),
        (("planned",), [], "manifest"),
        (("left_out",), {"fog": [5]}, "cells"),
        (("left_out",), {"fogg": [5]}, "cells"),
        (("provenance", "setting"), "OOD", "training"),
        (("provenance", "setting"), "best", "manifest"),
        (("provenance",), {"setting": "OOD", "basis": "declared", "trained_on": ["x"]}, "training"),
        (("identity", "frames", "seed"), 1, "manifest"),
        (("identity", "extra"), 1, "manifest"),
        (("identity_digest",), "0" * 16, "manifest"),
        (("identity_digest",), "../../x", "manifest"),
        (("version",), 4, "manifest"),
        (("version",), True, "manifest"),
        (("places",), {"a host": 3}, "manifest"),
        (("unknown",), 1, "manifest"),
        (("environment", "command"), ["robustflow"], "manifest"),
        (("samples",), {}, "manifest"),
        (("samples", "motorcycle"), [["a.png", "1"]], "manifest"),
        (("samples",), {"x" * 10_000: []}, "manifest"),
        (("seconds",), {"wall": "1"}, "manifest"),
        (("environment", "packages"), {"numpy": "\x1b[31m2"}, "manifest"),
        (("environment", "packages"), {"\x9b31m": "2"}, "manifest"),
        (("started",), "a\nb", "manifest"),
    ],
)
def test_changed_manifest_fails(packed, path, value, check):
    assert_fails(with_json(packed, "manifest.json", put(*path, value=value)), check)


@pytest.mark.parametrize(
    ("edit", "check"),
    [
        (put("model", value={"settings": {"name": "mine"}}), "training"),  # unlike what is known about the name
        (put("frames", "streams", value=0), "manifest"),
        (put("measuring", "rows", value=1), "manifest"),
    ],
)
def test_changed_identity_with_its_digest_fails(packed, edit, check):
    entries = entries_of(packed)
    manifest, record = (json.loads(entries[name]) for name in ("manifest.json", "record.json"))
    edit(manifest["identity"])
    manifest["identity_digest"] = record["run"] = digest_of_value(manifest["identity"])
    changed = {"manifest.json": with_digest(manifest), "record.json": record}
    assert_fails(sealed(entries | {key: json_bytes(value) for key, value in changed.items()}), check)


@pytest.mark.parametrize(
    ("field", "value", "check"),
    [
        *[("version", value, "record") for value in (2, 4, 10**400, "3", True, 0)],
        ("format", "zip", "record"),
        ("more", 1, "record"),
        ("author", "\x1b[31m", "record"),
        ("author", "x" * 201, "record"),
        ("description", "x" * 10_000, "record"),
        ("link", "javascript:alert(1)", "record"),
        ("complete", "yes", "record"),
        ("complete", False, "cells"),
        ("run", "0" * 16, "manifest"),
    ],
)
def test_changed_record_fails(packed, field, value, check):
    assert_fails(with_json(packed, "record.json", put(field, value=value)), check)


@pytest.mark.parametrize("name", ["record.json", "manifest.json"])
@pytest.mark.parametrize(
    "text",
    [
        b"",
        b"[1]\n",
        b"{",
        b"[" * 60_000,
        *(b'{"a":' * depth + b"1" + b"}" * depth for depth in (300, 900, 10_000)),
        b'{"cre": NaN}\n',
        b'{"cre": Infinity}\n',
        b'{"cre": 1e999}\n',
        b'{\n  "cre": 1,\n  "cre": 2\n}\n',
        b'{"a": "\xff"}',
        b'{"a": "\\ud800"}',
        b'{"a": ' + b"9" * 5_000 + b"}",
        b"\xef\xbb\xbf{}\n",
        json_bytes({"a": {"b": {"c": {"d": 1}}}})[:-1],
        json_bytes(reduce(lambda value, _: {"a": value}, range(100), {})),
    ],
)
def test_invalid_json_fails(packed, name, text):
    entries = entries_of(packed)
    written = container_bytes if name == "record.json" else sealed
    assert failure(written(entries | {name: text}))[0] in ("record", "manifest")


def test_too_large_plan_fails(packed):
    """A small manifest that implies more cells than fit into memory is refused before the cells are listed."""

    def edit(manifest):
        manifest["samples"] = {str(index): [] for index in range(20_000)}
        every = {f"c{index}": [1, 2, 3, 4, 5] for index in range(1000)}
        manifest["planned"] = [{"samples": list(manifest["samples"]), "corruptions": every}]

    assert_fails(with_json(packed, "manifest.json", edit), "manifest")


def test_cost_of_a_different_run_fails(packed):
    entries = entries_of(packed)
    cost = dict.fromkeys(("version", "height", "width", "parameters", "macs", "thop_parameters", "thop_macs"), 1)
    cost |= {"run": "0" * 16, "iterations": None, "seconds": None, "peak_bytes": None, "device": None}
    other, negative = (json_bytes(with_digest(cost | change)) for change in ({}, {"parameters": -1}))
    for data in (other, negative, json_bytes(cost)):
        assert "profile.json" in failure(sealed(entries | {"profile.json": data}))[1]
    fitting = cost | {"run": json.loads(entries["record.json"])["run"]}
    assert verified(sealed(entries | {"profile.json": json_bytes(with_digest(fitting))})).ok


@settings(max_examples=60)
@given(st.data())
def test_arbitrary_content_gives_a_failed_check_and_no_exception(packed, data):
    """Records with randomly cut and pasted entries and updated hashes are verified or refused with a message, never
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
    found = verified(sealed(entries | {name: changed}))
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
        {"setting": "knowledge"},
        {"trained_on": ["middlebury"]},
        {"trained_on": ["anything"]},
        {"trained_on": []},
        {"basis": "undeclared"},
        {"basis": "method", "setting": "knowledge", "trained_on": None},
    ):
        forged = with_json(data, "manifest.json", lambda manifest, change=change: manifest["provenance"].update(change))
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
    verified(with_rows(packed, at(_FOG, epe_sum=pl.lit(0.0))))
    assert not list(tmp_path.iterdir())
