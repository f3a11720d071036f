"""Records that were damaged, changed or forged: each is noticed, by the check that should notice it."""

from __future__ import annotations

import json
import shutil

import polars as pl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robustflow.api import evaluate, load_run
from robustflow.atomic import json_bytes
from robustflow.digest import digest_of_value
from robustflow.metrics.rows import CONFIDENCE, ROW_KEY, ROW_SCHEMA
from robustflow.records.container import container_bytes
from robustflow.records.pack import record_bytes
from robustflow.records.verify import VERIFICATION_CHECKS, verify
from robustflow.sealed import sealed as with_digest
from robustflow.testing import ZeroFlow

from .forge import entries_of, failure, sealed, verified, with_json, with_rows

_FOG = (pl.col("corruption") == "fog") & (pl.col("severity") == 5)


def _set(*path, value):
    def edit(document):
        for name in path[:-1]:
            document = document[name]
        document[path[-1]] = value

    return edit


def _at(condition, **values):
    return lambda rows: rows.with_columns(
        pl.when(condition).then(value).otherwise(pl.col(name)).alias(name) for name, value in values.items()
    )


def test_a_record_verifies(packed, tmp_path):
    (tmp_path / "a.robustflow").write_bytes(packed)
    found = verify(tmp_path / "a.robustflow")
    assert found.ok, found.first_failure()
    assert [check.name for check in found.checks] == list(VERIFICATION_CHECKS)[:-3]
    assert found.facts is not None
    assert found.facts.author == "Ada"


def test_a_missing_file_is_a_failed_check(tmp_path):
    found = verify(tmp_path / "nowhere.robustflow")
    assert [check.status for check in found.checks] == ["failed", *["not checked"] * (len(found.checks) - 1)]


@pytest.mark.parametrize("name", ["manifest.json", "rows.csv", "summary.json"])
def test_an_entry_changed_without_its_hash(packed, name):
    entries = entries_of(packed)
    changed = bytearray(entries[name])
    changed[len(changed) // 2] ^= 1
    assert failure(container_bytes(entries | {name: bytes(changed)})) == (
        "hashes",
        f"{name} has another SHA-256 than record.json gives: it was changed or damaged",
    )


@pytest.mark.parametrize(
    ("path", "value"),
    [
        (("cre",), 0.0),
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
def test_a_better_mean(packed, path, value):
    name, says = failure(with_json(packed, "summary.json", _set(*path, value=value)))
    assert name == "summary"
    assert str(path[-1]) in says


def test_a_mean_changed_by_little(packed):
    cre = json.loads(entries_of(packed)["summary.json"])["cre"]
    assert verified(with_json(packed, "summary.json", _set("cre", value=cre * (1 + 1e-11)))).ok
    assert failure(with_json(packed, "summary.json", _set("cre", value=cre * (1 + 1e-7))))[0] == "summary"


def test_better_rows(packed):
    """Rows that were made better, hashes fitting: the means no longer follow, or the rows cannot be."""
    half = _at(_FOG, epe_sum=pl.col("epe_sum") / 2)
    found = verified(with_rows(packed, half))
    failed = {check.name: check.message for check in found.checks if check.status == "failed"}
    assert set(failed) == {"measurements", "summary"}
    assert "regions do not add up" in failed["measurements"]
    assert "corruptions.fog" in failed["summary"]
    for values in (
        {"rcre_sum": pl.lit(0.0)},
        {"height": pl.col("height") + 1},
        {"magnitude_sum": pl.col("magnitude_sum") + 1},
        {"fl_count": pl.lit(0, pl.Int64)},
    ):
        assert failure(with_rows(packed, _at(_FOG, **values)))[0] == "measurements"


@pytest.mark.parametrize(
    ("edit", "says"),
    [
        (_at(_FOG, epe_sum=pl.lit(float("nan"))), "negative, not finite"),
        (_at(_FOG, epe_sum=pl.lit(float("inf"))), "negative, not finite"),
        (_at(_FOG, epe_sum=pl.lit(-1.0)), "negative, not finite"),
        (_at(_FOG, n_valid=pl.lit(-1, pl.Int64)), "below 0"),
        (_at(_FOG, n_all=pl.lit(2**60, pl.Int64)), "too large"),
        (_at(_FOG, n_all=pl.lit(None, pl.Int64)), "empty"),
        (_at(_FOG, pred_magnitude_sum=pl.lit(None, pl.Float64)), "empty"),
        (_at(_FOG, frames_digest=pl.lit("../x")), "32 hexadecimal"),
        (_at(_FOG, frames_digest=pl.lit("A" * 32)), "32 hexadecimal"),
        (_at(_FOG, sample=pl.lit("\x1b]0;owned\x07")), "cannot be shown"),
        (_at(_FOG, group=pl.lit("a\u202eb")), "cannot be shown"),
        (_at(_FOG, corruption=pl.lit("x" * 10_000)), "10000 characters"),
        (_at(_FOG, sample=pl.lit("x" * 1_000)), "1000 characters"),
        (lambda rows: pl.concat([rows, rows.filter(_FOG)]), "appears twice"),
        (lambda rows: rows.clear(), "has 0 lines"),
    ],
)
def test_rows_that_are_none(packed, edit, says):
    name, said = failure(with_rows(packed, edit))
    assert name == "rows"
    assert says in said


@pytest.mark.parametrize(
    ("digest", "says"),
    [
        (pl.lit("0" * 32), "zeros"),
        (pl.lit("ab" * 16), "the same frames_digest"),
        (pl.col("frames_digest").first(), "the same frames_digest"),
    ],
)
def test_digests_that_no_frames_have(packed, digest, says):
    name, message = failure(with_rows(packed, lambda rows: rows.with_columns(frames_digest=digest)))
    assert name == "cells"
    assert says in message


def test_a_few_equal_frames_are_possible(packed):
    """A corruption that changes nothing (a flat frame, a stream in which no bit was hit) is not a forgery."""
    same = with_rows(packed, _at(_FOG & (pl.col("severity") == 5), frames_digest=pl.col("frames_digest").first()))
    assert verified(same).ok


def test_what_a_verified_record_is_about(run, packed):
    verification = verified(packed)
    assert verification.subject is not None
    assert verification.subject.cre == pytest.approx(run.cre)
    assert verification.subject.sentence().startswith("Farneback on demo (knowledge), 1 pair x 2 corruptions x 2 sev")
    assert [claim.partition(":")[0] for claim in verification.unproven[:2]] == [
        "that the rows were measured on these data",
        "that this model made the predictions",
    ]
    assert verified(with_json(packed, "summary.json", _set("epe", value=9.0))).subject.epe == pytest.approx(run.epe)


@pytest.mark.parametrize(
    "column",
    # the pair has no map of occlusions, the run no confidence, and a record holds no attacks
    [
        name
        for name, kind in ROW_SCHEMA.items()
        if kind is not pl.String
        and not name.endswith(("_noc", "_occ"))
        and not name.startswith("attack_")
        and name not in CONFIDENCE
    ],
)
@pytest.mark.parametrize("where", [_FOG, pl.col("corruption") == "clean"])
def test_a_number_taken_out_is_noticed(packed, column, where):
    assert failure(with_rows(packed, _at(where, **{column: pl.lit(None, ROW_SCHEMA[column])})))


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
def test_rows_written_otherwise(packed, old, new):
    entries = entries_of(packed)
    changed = entries["rows.csv"].replace(old, new)
    assert changed != entries["rows.csv"]
    assert failure(sealed(entries | {"rows.csv": changed}))[0] == "rows"


def test_rows_nobody_planned(packed):
    more = with_rows(
        packed, lambda rows: pl.concat([rows, rows.filter(_FOG).with_columns(severity=pl.lit(3, pl.Int64))])
    )
    assert failure(more) == ("cells", "1 rows were not planned, the first of sample 'motorcycle', fog severity 3")
    assert "1 of 5 rows are missing" in failure(with_rows(packed, lambda rows: rows.filter(~_FOG)))[1]
    other = with_rows(packed, _at(_FOG, sample=pl.lit("other")))
    assert failure(other)[0] == "cells"
    no_clean = with_rows(packed, lambda rows: rows.filter(corruption="fog"))
    assert "clean frames" in failure(no_clean)[1]
    invalid = with_rows(packed, _at(_FOG, n_invalid=pl.lit(1, pl.Int64), n_all=pl.col("n_all") - 1))
    assert "did not allow" in failure(invalid)[1]


@pytest.mark.parametrize(
    ("path", "value", "check", "says"),
    [
        (("selection", "corruptions"), ["fog", "contrast", "fogg"], "cells", "'fogg' is unknown"),
        (("selection", "corruptions"), ["fog", "contrast", "fog+"], "cells", "'fog+' is unknown"),
        (("selection", "corruptions"), ["fog", "contrast", "fog"], "cells", "selected twice"),
        (("selection", "severities"), [0, 1, 5], "cells", "they are 1 to 5"),
        (("selection", "severities"), [1, 5, 6], "manifest", "less than or equal to 5"),
        (("selection", "corruptions"), [], "manifest", "at least 1"),
        (("left_out",), {"fog": [5]}, "cells", "the paper scale lacks []"),
        (("left_out",), {"snow": [5]}, "cells", "not selected"),
        (("provenance", "setting"), "OOD", "training", "it is knowledge"),
        (("provenance", "setting"), "best", "manifest", "provenance.setting"),
        (("provenance",), {"setting": "OOD", "basis": "declared", "trained_on": ["x"]}, "training", "it is knowledge"),
        (("identity", "frames", "seed"), 1, "manifest", "that of the identity is"),
        (("identity", "extra"), 1, "manifest", "identity.extra"),
        (("identity_digest",), "0" * 16, "manifest", "in manifest.json"),
        (("identity_digest",), "../../x", "manifest", "identity_digest"),
        (("schema",), 2, "manifest", "schema"),
        (("schema",), True, "manifest", "schema"),
        (("unknown",), 1, "manifest", "unknown"),
        (("environment", "command"), ["robustflow"], "manifest", "environment.command"),
        (("samples",), {}, "manifest", "samples"),
        (("samples", "motorcycle"), [["a.png", "1"]], "manifest", "samples.motorcycle"),
        (("samples",), {"x" * 10_000: []}, "manifest", "10000 characters"),
        (("seconds",), {"wall": "1"}, "manifest", "seconds.wall"),
        (("environment", "packages"), {"numpy": "\x1b[31m2"}, "manifest", "cannot be shown"),
        (("environment", "packages"), {"\x9b31m": "2"}, "manifest", "cannot be shown"),
        (("started",), "a\nb", "manifest", "cannot be shown"),
    ],
)
def test_a_changed_manifest(packed, path, value, check, says):
    name, said = failure(with_json(packed, "manifest.json", _set(*path, value=value)))
    assert name == check
    assert says in said


def test_a_changed_identity_with_its_digest(packed):
    """A forger may rename the model consistently; what the catalog knows of the name must then fit as well."""
    entries = entries_of(packed)
    manifest, record, summary = (json.loads(entries[name]) for name in ("manifest.json", "record.json", "summary.json"))
    manifest["identity"]["model"] = {"settings": {"name": "mine"}}
    digest = digest_of_value(manifest["identity"])
    manifest["identity_digest"] = record["run"] = summary["run"] = digest
    changed = {"manifest.json": manifest, "record.json": record, "summary.json": summary}
    name, says = failure(sealed(entries | {key: json_bytes(value) for key, value in changed.items()}))
    assert name == "training"
    assert "undeclared" in says


@pytest.mark.parametrize(
    ("path", "value", "says"),
    [
        (("version",), 3, "upgrade robustflow"),
        (("version",), 10**400, "upgrade robustflow"),
        (("version",), "1", "not a record of a run"),
        (("version",), True, "not a record of a run"),
        (("version",), 0, "not a record of a run"),
        (("format",), "zip", "not a record of a run"),
        (("more",), 1, "more"),
        (("author",), "\x1b[31m", "cannot be shown"),
        (("author",), "x" * 201, "author"),
        (("description",), "x" * 10_000, "10000 characters"),
        (("link",), "javascript:alert(1)", "https://"),
        (("complete",), "yes", "complete"),
    ],
)
def test_a_changed_record(packed, path, value, says):
    name, said = failure(with_json(packed, "record.json", _set(*path, value=value)))
    assert name == "record"
    assert says in said


def test_a_run_declared_complete_or_not(packed):
    assert failure(with_json(packed, "record.json", _set("complete", value=False)))[0] == "cells"
    assert failure(with_json(packed, "record.json", _set("run", value="0" * 16)))[0] == "manifest"


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
    ],
)
def test_json_that_is_none(packed, name, text):
    entries = entries_of(packed)
    data = sealed(entries | {name: text}) if name != "record.json" else _raw(entries, text)
    assert failure(data)[0] in ("record", "manifest", "rows")


def _raw(entries, text):
    return container_bytes(entries | {"record.json": text})


def test_json_too_deep(packed):
    value: dict = {}
    for _ in range(100):
        value = {"a": value}
    entries = entries_of(packed)
    assert "deep" in failure(sealed(entries | {"summary.json": json_bytes(value)}))[1]


def test_an_endless_plan(packed):
    """A small manifest whose samples times corruptions would fill the memory is refused before they are multiplied."""

    def edit(manifest):
        manifest["samples"] = {str(index): [] for index in range(20_000)}
        manifest["selection"] = {"corruptions": [f"c{index}" for index in range(1000)], "severities": [1, 2, 3, 4, 5]}

    name, says = failure(with_json(packed, "manifest.json", edit))
    assert name == "manifest"
    assert "rows are planned" in says


def test_a_cost_of_another_run(packed):
    entries = entries_of(packed)
    cost = {
        "run": "0" * 16,
        "version": 1,
        "height": 4,
        "width": 4,
        "parameters": 1,
        "macs": 1,
        "thop_parameters": 1,
        "thop_macs": 1,
    }
    other, negative = (json_bytes(with_digest(cost | change)) for change in ({}, {"parameters": -1}))
    assert "another run" in failure(sealed(entries | {"profile.json": other}))[1]
    assert "parameters" in failure(sealed(entries | {"profile.json": negative}))[1]
    assert "damaged" in failure(sealed(entries | {"profile.json": json_bytes(cost)}))[1]
    fitting = cost | {"run": json.loads(entries["record.json"])["run"]}
    assert verified(sealed(entries | {"profile.json": json_bytes(with_digest(fitting))})).ok


@settings(max_examples=60)
@given(st.data())
def test_no_content_breaks_the_reader(packed, data):
    """Entries cut and pasted at random, hashes fitting: verified or refused in words, never an exception."""
    entries = entries_of(packed)
    name = data.draw(st.sampled_from([n for n in entries if n != "record.json"]))
    text = entries[name]
    start = data.draw(st.integers(0, len(text)))
    stop = data.draw(st.integers(start, min(len(text), start + 40)))
    words = [b"", b",", b"\n", b'"', b"null", b"-1", b"1e400", b"9" * 30, b"{", b"]", b"\0", b"\xff", b"NaN", b"true"]
    pasted = data.draw(st.sampled_from(words) | st.binary(max_size=8))
    changed = text[:start] + pasted + text[stop:]
    if not verified(sealed(entries | {name: changed})).ok:
        assert changed != text
        failure(sealed(entries | {name: changed}))


def test_declared_training_sets(tmp_path):
    class Mine(ZeroFlow):
        trained_on = "C+T"

        def identity(self):
            return {"name": "mine"}

    run = evaluate(Mine(), "demo", output=tmp_path / "run", corruptions=["fog"], severities=[1])
    data = record_bytes(run)
    assert verified(data).ok
    for change, says in (
        ({"setting": "knowledge"}, "it is OOD"),
        ({"trained_on": ["middlebury"]}, "it is LEAKED"),
        ({"trained_on": ["anything"]}, "cannot be read"),
        ({"trained_on": []}, "cannot be read"),
        ({"basis": "undeclared"}, "it is UNKNOWN"),
        ({"basis": "method", "setting": "knowledge", "trained_on": None}, "it is UNKNOWN"),
    ):
        name, said = failure(with_json(data, "manifest.json", lambda m, change=change: m["provenance"].update(change)))
        assert name == "training"
        assert says in said


def test_severities_that_a_scale_lacks(tmp_path):
    options = {"corruptions": ["saturate", "fog"], "severities": [1, 5], "severity_scale": "calibrated"}
    run = evaluate("dis", "demo", output=tmp_path / "run", **options)
    assert run.left_out
    data = record_bytes(run)
    assert verified(data).ok
    name, says = failure(with_json(data, "manifest.json", lambda m: m.update(left_out={"fog": [5], **run.left_out})))
    assert name == "cells"
    assert "fog was left out" in says
    assert failure(with_json(data, "manifest.json", lambda m: m.pop("left_out")))[0] == "cells"


def test_nothing_is_left_behind(packed, tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    assert verified(packed).ok
    verified(with_rows(packed, _at(_FOG, epe_sum=pl.lit(0.0))))
    assert not list(tmp_path.iterdir())
    shutil.rmtree(tmp_path)


@pytest.fixture(scope="module")
def attacked_run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("attacked") / "run"
    chosen = {"corruptions": "contrast", "severities": 1, "attacks": "square:queries=3"}
    return evaluate("farneback", "demo", output=folder, **chosen)


@pytest.fixture(scope="module")
def attacked(attacked_run) -> bytes:
    return record_bytes(attacked_run)


def test_a_record_holds_the_rows_of_attacks(attacked_run, attacked, tmp_path):
    found = verified(attacked)
    (tmp_path / "run.robustflow").write_bytes(attacked)
    loaded = load_run(tmp_path / "run.robustflow")

    assert found.ok, found.first_failure()
    assert any("no check repeats them" in sentence for sentence in found.unproven)
    assert loaded.attack_rows.sort(ROW_KEY).equals(attacked_run.attack_rows.sort(ROW_KEY))
    assert loaded.rows.sort(ROW_KEY).equals(attacked_run.rows.sort(ROW_KEY))
    assert loaded.summary == attacked_run.summary


_SQUARE = pl.col("corruption") == "square:queries=3"


@pytest.mark.parametrize(
    ("where", "change", "check", "says"),
    [
        (_SQUARE, {"attack_linf": 1.5}, "measurements", "beyond its budget"),
        (pl.col("corruption") == "random_gauss", {"attack_rms": 0.51}, "measurements", "beyond its budget"),
        (_SQUARE, {"attack_capped_sum": 1e9}, "measurements", "above the error"),
        (_SQUARE, {"attack_warnings": "fine"}, "measurements", "a warning that there is not"),
        (_SQUARE, {"attack_rms": None}, "measurements", "numbers of the attack are missing"),
        (_SQUARE, {"attack_way_gone": 2.0}, "measurements", "beyond its target"),
        (_SQUARE, {"attack_evaluations": -1}, "rows", "below 0"),
        (_SQUARE, {"epe_sum": 0.0}, "measurements", ""),
        (pl.col("corruption") == "contrast", {"attack_linf": 0.0}, "measurements", "of an attack and is none"),
    ],
)
def test_a_forged_row_of_an_attack_is_noticed(attacked, where, change, check, says):
    values = {name: pl.lit(value, ROW_SCHEMA[name]) for name, value in change.items()}
    failed, message = failure(with_rows(attacked, _at(where, **values)))
    assert failed == check
    assert says in message


def test_attacks_that_are_missing_or_unknown_are_noticed(attacked):
    def attacks(names):
        return lambda manifest: manifest["selection"].update(attacks=names)

    kept = ["random_sign", "random_gauss", "square:queries=3"]
    assert failure(with_rows(attacked, lambda rows: rows.filter(~_SQUARE)))[0] == "cells"
    assert "attacks without random_sign" in failure(with_json(attacked, "manifest.json", attacks(kept[1:])))[1]
    assert failure(with_json(attacked, "manifest.json", attacks([*kept, kept[2]])))[1] == "an attack is selected twice"
    assert failure(with_json(attacked, "manifest.json", attacks([*kept, "os:system"])))[0] == "manifest"
