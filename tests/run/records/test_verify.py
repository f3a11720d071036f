"""Damaged, changed and forged records are detected, each by the right check."""

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
from robustflow.metrics.rows import COVERAGES, ROW_SCHEMA
from robustflow.run.records.container import container_bytes
from robustflow.run.records.pack import record_bytes
from robustflow.run.records.verify import VERIFICATION_CHECKS, verify
from robustflow.testing import ZeroFlow

from .forge import assert_fails, at, entries_of, failure, put, sealed, verified, with_json, with_rows

_FOG = (pl.col("corruption") == "fog") & (pl.col("severity") == 5)
_PLANNED = ("planned", 0, "corruptions")


def test_valid_record_verifies_and_states_its_subject(run, packed, tmp_path):
    (tmp_path / "a.robustflow").write_bytes(packed)
    found = verify(tmp_path / "a.robustflow")
    assert found.ok, found.first_failure()
    assert [check.name for check in found.checks] == list(VERIFICATION_CHECKS)[:-3]
    assert found.facts.author == "Ada"
    assert found.subject.cre == pytest.approx(run.cre)
    assert found.subject.sentence().startswith("Farneback on demo (knowledge), 1 pair x 2 corruptions x 2 sev")
    assert [claim.partition(":")[0] for claim in found.unproven[:2]] == [
        "that the rows were measured on these data",
        "that this model made the predictions",
    ]
    assert verified(with_json(packed, "summary.json", put("epe", value=9.0))).subject.epe == pytest.approx(run.epe)


def test_a_missing_file_is_a_failed_check(tmp_path):
    found = verify(tmp_path / "nowhere.robustflow")
    assert [check.status for check in found.checks] == ["failed", *["not checked"] * (len(found.checks) - 1)]


@pytest.mark.parametrize("name", ["manifest.json", "rows.csv", "summary.json"])
def test_entry_changed_without_its_hash_fails(packed, name):
    entries = entries_of(packed)
    changed = bytearray(entries[name])
    changed[len(changed) // 2] ^= 1
    assert failure(container_bytes(entries | {name: bytes(changed)})) == (
        "hashes",
        f"{name} does not match its SHA-256 in record.json: it was changed or damaged",
    )


@pytest.mark.parametrize(
    ("path", "value"),
    [
        (("version",), 0),
        (("cre",), 0.0),
        (("cre",), 10**400),
        (("crer",), None),
        (("corruptions", "fog", "by_severity", "epe", 1), 1.0),
        (("pooled", "rcre"), 0.5),
        (("setting",), "OOD"),
        (("complete",), False),
        (("samples",), 80),
        (("new",), 1),
        (("corruptions", "snow"), {}),
    ],
)
def test_improved_mean_fails(packed, path, value):
    assert_fails(with_json(packed, "summary.json", put(*path, value=value)), "summary", str(path[-1]))


def test_slightly_changed_mean_fails(packed):
    cre = json.loads(entries_of(packed)["summary.json"])["cre"]
    assert verified(with_json(packed, "summary.json", put("cre", value=cre * (1 + 1e-11)))).ok
    assert_fails(with_json(packed, "summary.json", put("cre", value=cre * (1 + 1e-7))), "summary")


def test_improved_rows_with_new_hashes_fail(packed):
    """If a forger improves rows and updates the hashes, the means no longer match or the rows are impossible."""
    half = at(_FOG, epe_sum=pl.col("epe_sum") / 2)
    found = verified(with_rows(packed, half))
    failed = {check.name: check.message for check in found.checks if check.status == "failed"}
    assert set(failed) == {"measurements", "summary"}
    assert "regions do not add up" in failed["measurements"]
    assert "corruptions.fog" in failed["summary"]


@pytest.mark.parametrize(
    ("check", "edit", "says"),
    [
        ("rows", at(_FOG, epe_sum=pl.lit(float("nan"))), "negative, not finite"),
        ("rows", at(_FOG, epe_sum=pl.lit(float("inf"))), "negative, not finite"),
        ("rows", at(_FOG, epe_sum=pl.lit(-1.0)), "negative, not finite"),
        ("rows", at(_FOG, n_valid=pl.lit(-1, pl.Int64)), "negative"),
        ("rows", at(_FOG, n_all=pl.lit(2**60, pl.Int64)), "too large"),
        ("rows", at(_FOG, n_all=pl.lit(None, pl.Int64)), "empty"),
        ("rows", at(_FOG, pred_magnitude_sum=pl.lit(None, pl.Float64)), "empty"),
        ("rows", at(_FOG, frames_digest=pl.lit("../x")), "32 hexadecimal"),
        ("rows", at(_FOG, frames_digest=pl.lit("A" * 32)), "32 hexadecimal"),
        ("rows", at(_FOG, sample=pl.lit("\x1b]0;owned\x07")), "cannot be displayed"),
        ("rows", at(_FOG, group=pl.lit("a\u202eb")), "cannot be displayed"),
        ("rows", at(_FOG, corruption=pl.lit("x" * 10_000)), "10000 characters"),
        ("rows", at(_FOG, sample=pl.lit("x" * 1_000)), "1000 characters"),
        ("rows", lambda rows: pl.concat([rows, rows.filter(_FOG)]), "appears twice"),
        ("rows", lambda rows: rows.clear(), "has 0 lines"),
        ("cells", at(pl.lit(True), frames_digest=pl.lit("0" * 32)), "zeros"),
        ("cells", at(pl.lit(True), frames_digest=pl.lit("ab" * 16)), "the same frames_digest"),
        ("cells", at(pl.lit(True), frames_digest=pl.col("frames_digest").first()), "the same frames_digest"),
        (
            "cells",
            lambda rows: pl.concat([rows, rows.filter(_FOG).with_columns(severity=pl.lit(3, pl.Int64))]),
            "1 rows were not planned; the first one is for sample 'motorcycle', fog severity 3",
        ),
        ("cells", lambda rows: rows.filter(~_FOG), "1 of 5 rows are missing"),
        ("cells", at(_FOG, sample=pl.lit("other")), ""),
        ("cells", lambda rows: rows.filter(corruption="fog"), "clean frames"),
        ("cells", at(_FOG, n_invalid=pl.lit(1, pl.Int64), n_all=pl.col("n_all") - 1), "did not allow"),
        ("rows", at(_FOG, truth=pl.lit("moved")), "truth 'moved'"),
        ("measurements", at(_FOG, truth=pl.lit("none")), ""),
        ("measurements", at(_FOG, rcre_sum=pl.lit(0.0)), ""),
        ("measurements", at(_FOG, height=pl.col("height") + 1), ""),
        ("measurements", at(_FOG, magnitude_sum=pl.col("magnitude_sum") + 1), ""),
        ("measurements", at(_FOG, fl_count=pl.lit(0, pl.Int64)), ""),
    ],
)
def test_changed_rows_whose_hashes_fit_fail_a_check(packed, check, edit, says):
    assert_fails(with_rows(packed, edit), check, says)


def test_record_with_unplanned_cells_has_no_subject_and_no_check_of_its_means(packed):
    found = verified(with_rows(packed, lambda rows: rows.with_columns(sample=pl.lit("other"))))
    assert failure(found)[0] == "cells"
    assert found.subject is None
    status = {check.name: check.status for check in found.checks}
    assert {status[name] for name in ("measurements", "summary")} == {"not checked"}


@pytest.mark.parametrize(("count", "more"), [(3, ""), (4, "; and 1 more"), (5, "; and 2 more")])
def test_failed_check_states_three_problems_and_the_number_of_the_others(packed, count, more):
    """Each unknown corruption is a problem."""
    names = [f"unknown_{number}" for number in range(count)]
    unknown = {name: [1] for name in names}
    check, message = failure(with_json(packed, "manifest.json", put(*_PLANNED, value=unknown)))
    assert check == "cells"
    assert [name in message for name in names] == [True] * min(count, 3) + [False] * (count - 3)
    assert message.partition("; and ")[1:] == (more and "; and ", more.removeprefix("; and "))


def test_a_few_equal_frames_are_possible(packed):
    """A corruption that changes nothing (a flat frame, a stream in which no bit was flipped) is not a forgery."""
    same = with_rows(packed, at(_FOG & (pl.col("severity") == 5), frames_digest=pl.col("frames_digest").first()))
    assert verified(same).ok


_MEASURED = [  # the pair has no occlusion map, the run has no confidence, and the record contains no attacks
    name
    for name, kind in ROW_SCHEMA.items()
    if kind is not pl.String
    and not name.endswith(("_noc", "_occ"))
    and not name.startswith("attack_")
    and not name.endswith(tuple(f"_at_{share}" for share in COVERAGES))
    and name not in ("ause", "confidence_spearman", "rejected_count", "spread_sum")
]


@pytest.mark.parametrize(
    ("column", "where"),
    [(name, _FOG) for name in _MEASURED]
    + [(name, pl.col("corruption") == "clean") for name in ("n_all", "n_valid", "epe_sum", "fl_count_s10_40")],
)
def test_removed_number_is_detected(packed, column, where):
    assert failure(with_rows(packed, at(where, **{column: pl.lit(None, ROW_SCHEMA[column])})))


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
    ("path", "value", "check", "says"),
    [
        ((*_PLANNED, "fogg"), [1], "cells", "'fogg' is unknown"),
        ((*_PLANNED, "fog+"), [1], "cells", "'fog+' is unknown"),
        ((*_PLANNED, "fog:2"), [1], "cells", "fog:2 is planned at severities [1]"),
        ((*_PLANNED, "fog"), [0, 1, 5], "manifest", "greater than or equal to 1"),
        ((*_PLANNED, "fog"), [1, 5, 6], "manifest", "less than or equal to 5"),
        ((*_PLANNED, "fog"), [5, 1], "manifest", "ascending"),
        (_PLANNED, {}, "manifest", "no corruption or attack"),
        (("planned",), [], "manifest", "exactly one part"),
        (("left_out",), {"fog": [5]}, "cells", "which the paper scale has"),
        (("left_out",), {"fogg": [5]}, "cells", "'fogg' is unknown"),
        (("provenance", "setting"), "OOD", "training", "it should be knowledge"),
        (("provenance", "setting"), "best", "manifest", "provenance.setting"),
        (
            ("provenance",),
            {"setting": "OOD", "basis": "declared", "trained_on": ["x"]},
            "training",
            "it should be knowledge",
        ),
        (("identity", "frames", "seed"), 1, "manifest", "but the identity has"),
        (("identity", "extra"), 1, "manifest", "identity.extra"),
        (("identity_digest",), "0" * 16, "manifest", "in manifest.json"),
        (("identity_digest",), "../../x", "manifest", "identity_digest"),
        (("schema",), 2, "manifest", "schema"),
        (("schema",), True, "manifest", "schema"),
        (("unknown",), 1, "manifest", "unknown"),
        (("environment", "command"), ["robustflow"], "manifest", "environment.command"),
        (("samples",), {}, "manifest", "every sample"),
        (("samples", "motorcycle"), [["a.png", "1"]], "manifest", "samples.motorcycle"),
        (("samples",), {"x" * 10_000: []}, "manifest", "10000 characters"),
        (("seconds",), {"wall": "1"}, "manifest", "seconds.wall"),
        (("environment", "packages"), {"numpy": "\x1b[31m2"}, "manifest", "cannot be displayed"),
        (("environment", "packages"), {"\x9b31m": "2"}, "manifest", "cannot be displayed"),
        (("started",), "a\nb", "manifest", "cannot be displayed"),
    ],
)
def test_changed_manifest_fails(packed, path, value, check, says):
    assert_fails(with_json(packed, "manifest.json", put(*path, value=value)), check, says)


def test_changed_identity_with_its_digest_fails(packed):
    """A forger may rename the model consistently, but then the catalogue's facts about the name must match, too."""
    entries = entries_of(packed)
    manifest, record, summary = (json.loads(entries[name]) for name in ("manifest.json", "record.json", "summary.json"))
    manifest["identity"]["model"] = {"settings": {"name": "mine"}}
    digest = digest_of_value(manifest["identity"])
    manifest["identity_digest"] = record["run"] = summary["run"] = digest
    changed = {"manifest.json": manifest, "record.json": record, "summary.json": summary}
    assert_fails(sealed(entries | {key: json_bytes(value) for key, value in changed.items()}), "training", "undeclared")


@pytest.mark.parametrize(
    ("field", "value", "check", "says"),
    [
        ("version", 3, "record", "upgrade robustflow"),
        ("version", 10**400, "record", "upgrade robustflow"),
        ("version", "1", "record", "not a record of a run"),
        ("version", True, "record", "not a record of a run"),
        ("version", 0, "record", "not a record of a run"),
        ("format", "zip", "record", "not a record of a run"),
        ("more", 1, "record", "more"),
        ("author", "\x1b[31m", "record", "cannot be displayed"),
        ("author", "x" * 201, "record", "author"),
        ("description", "x" * 10_000, "record", "10000 characters"),
        ("link", "javascript:alert(1)", "record", "https://"),
        ("complete", "yes", "record", "complete"),
        ("complete", False, "cells", ""),
        ("run", "0" * 16, "manifest", ""),
    ],
)
def test_changed_record_fails(packed, field, value, check, says):
    assert_fails(with_json(packed, "record.json", put(field, value=value)), check, says)


@pytest.mark.parametrize("name", ["record.json", "manifest.json", "summary.json"])
@pytest.mark.parametrize(
    "text",
    [
        b"",
        b"[1]\n",
        b"{",
        b"[" * 60_000,
        b'{"a":' * 10_000 + b"1" + b"}" * 10_000,
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
    assert failure(written(entries | {name: text}))[0] in ("record", "manifest", "rows")


def test_too_large_plan_fails(packed):
    """A small manifest that implies more cells than fit into memory is refused before the cells are listed."""

    def edit(manifest):
        manifest["samples"] = {str(index): [] for index in range(20_000)}
        every = {f"c{index}": [1, 2, 3, 4, 5] for index in range(1000)}
        manifest["planned"] = [{"samples": list(manifest["samples"]), "corruptions": every}]

    assert_fails(with_json(packed, "manifest.json", edit), "manifest", "rows are planned")


def test_cost_of_a_different_run_fails(packed):
    entries = entries_of(packed)
    cost = dict.fromkeys(("version", "height", "width", "parameters", "macs", "thop_parameters", "thop_macs"), 1)
    cost |= {"run": "0" * 16}
    other, negative = (json_bytes(with_digest(cost | change)) for change in ({}, {"parameters": -1}))
    assert "a different run" in failure(sealed(entries | {"profile.json": other}))[1]
    assert "parameters" in failure(sealed(entries | {"profile.json": negative}))[1]
    assert "damaged" in failure(sealed(entries | {"profile.json": json_bytes(cost)}))[1]
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
    for change, says in (
        ({"setting": "knowledge"}, "it should be OOD"),
        ({"trained_on": ["middlebury"]}, "it should be LEAKED"),
        ({"trained_on": ["anything"]}, "cannot be read"),
        ({"trained_on": []}, "cannot be read"),
        ({"basis": "undeclared"}, "it should be UNKNOWN"),
        ({"basis": "method", "setting": "knowledge", "trained_on": None}, "it should be UNKNOWN"),
    ):
        forged = with_json(data, "manifest.json", lambda manifest, change=change: manifest["provenance"].update(change))
        assert_fails(forged, "training", says)


def test_plan_that_contradicts_the_severities_of_its_scale_fails(tmp_path):
    options = {"corruptions": ["saturate", "fog"], "severities": [1, 5], "severity_scale": "calibrated"}
    run = evaluate("dis", "demo", output=tmp_path / "run", **options)
    assert run.left_out
    data = record_bytes(run)
    assert verified(data).ok
    without_fog = put("left_out", value={"fog": [5], **run.left_out})
    assert_fails(with_json(data, "manifest.json", without_fog), "cells", "fog was left out")
    assert_fails(with_json(data, "manifest.json", put(*_PLANNED, "saturate", value=[1, 5])), "cells", "is planned at")


def test_verification_leaves_no_temporary_file(packed, tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    assert verified(packed).ok
    verified(with_rows(packed, at(_FOG, epe_sum=pl.lit(0.0))))
    assert not list(tmp_path.iterdir())
