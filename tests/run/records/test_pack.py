"""A record contains the run, but nothing that identifies a machine."""

import json
import os
import platform
import shutil
import sys
import weakref

import polars as pl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robustflow.api import Result, evaluate
from robustflow.core.errors import DataError, RunError, UsageError
from robustflow.core.files import digest_of_value
from robustflow.metrics.rows import ROW_KEY, ROW_SCHEMA, rows_frame
from robustflow.run.records.format import rows_from_text, rows_to_text, shareable_manifest
from robustflow.run.records.pack import load_any_run, pack, record_bytes
from robustflow.run.records.verify import verify
from robustflow.run.store import write_shard
from robustflow.testing import ZeroFlow
from tests.made_rows import changed_identity

from ...refusals import refusal
from ..edited import edit_rows
from .forge import entries_of, verified, with_json

_FLOATS = st.floats(0, 1e18, allow_nan=False) | st.sampled_from([5e-324, 0.1, 1e16, 1e-7, 123456789.12345679])
_WORDS = st.text(st.characters(exclude_categories=["C", "Z"]), min_size=1, max_size=20) | st.sampled_from(
    ["null", "NaN", "1", 'a"b', "a,b", "#x", "true", "a/b c", "'", '""']
)


@settings(max_examples=60)
@given(
    st.lists(
        st.tuples(_WORDS, _WORDS, st.integers(1, 5), _FLOATS, st.none() | _FLOATS), max_size=6, unique_by=lambda x: x[0]
    )
)
def test_rows_of_any_content_survive_a_round_trip_through_text(made):
    rows = rows_frame(
        dict.fromkeys(ROW_SCHEMA)
        | {"sample": s, "group": g, "corruption": "fog", "severity": level, "n_all": level, "epe_sum": x, "wauc_sum": y}
        for s, g, level, x, y in made
    ).with_columns(frames_digest=pl.lit("0" * 32))
    text = rows_to_text(rows.reverse())
    assert text == rows_to_text(rows)
    if made:
        assert rows_from_text(text).equals(rows.sort(ROW_KEY))


def test_record_has_the_rows_and_means_of_the_run(run, packed):
    entries = entries_of(packed)
    assert rows_from_text(entries["rows.csv"]).equals(run.rows)
    manifests = [json.loads(data) for data in (entries["manifest.json"], run.manifest.document())]
    one, other = ({**manifest, "environment": None, "digest": None} for manifest in manifests)
    assert one == other


def test_record_reveals_no_path_or_command_of_the_machine(run, packed):
    manifest = json.loads(entries_of(packed)["manifest.json"])
    machine = run.manifest.environment.machine
    assert manifest["environment"]["machine"] == {
        "system": platform.platform().partition("-")[0],
        "processor": machine.processor,
        "cores": machine.cores,
    }
    assert "command" not in manifest["environment"]
    words = {str(run.path), str(run.path.parent), sys.prefix, machine.system}
    text = b"".join(entries_of(packed).values()).decode()
    assert [word for word in words if word in text] == []


def test_a_path_in_the_identity_is_not_published(run):
    identity = changed_identity(run.manifest.identity, {"weights": "/home/ada/secret/w.pth"})
    manifest = run.manifest.model_copy(update={"identity": identity})
    refusal(lambda: shareable_manifest(manifest), RunError, "identity.model.settings.weights")
    assert shareable_manifest(manifest, keep_paths=True).identity == identity


def test_record_does_not_depend_on_the_shards_of_the_run(run, tmp_path, packed):
    copy = Result(shutil.copytree(run.path, tmp_path / "copy"))
    rows = copy.rows
    for path in (copy.path / "rows").iterdir():
        path.unlink()
    for index in range(rows.height):
        write_shard(copy.path / "rows", str(rows.height - index), rows[[index]])
    texts = {"author": "Ada", "link": "https://example.org", "description": "A run."}
    assert record_bytes(Result(copy.path), **texts) == packed
    first, second = (pack(copy, tmp_path / f"{name}.robustflow", **texts) for name in "ab")
    assert first.read_bytes() == second.read_bytes() == packed


def test_unfinished_run_is_not_packed(run, tmp_path):
    folder = shutil.copytree(run.path, tmp_path / "part")
    edit_rows(folder, lambda rows: rows.filter(pl.col("severity") != 5))
    assert " 2 " in str(refusal(lambda: pack(Result(folder), tmp_path / "a.robustflow"), RunError, folder))
    path = pack(Result(folder), tmp_path / "a.robustflow", partial=True)
    found = verify(path)
    assert found.ok
    assert not found.facts.complete
    assert not load_any_run(path).measured.complete


def test_a_run_that_would_not_verify_is_not_packed(run, tmp_path):
    folder = shutil.copytree(run.path, tmp_path / "changed")
    edit_rows(folder, lambda rows: rows.with_columns(fl_count=pl.col("n_valid") + 1))
    refusal(lambda: pack(Result(folder), tmp_path / "a.robustflow"), RunError, folder)
    assert not (tmp_path / "a.robustflow").exists()


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("author", "\x1b[31mred"),
        ("author", "x" * 201),
        ("link", "javascript:alert(1)"),
        ("link", "http://example.org"),
        ("description", "x" * 2001),
    ],
)
def test_invalid_texts_of_a_record_are_refused(run, tmp_path, name, text):
    refusal(lambda: pack(run, tmp_path / "a.robustflow", **{name: text}), DataError, f"--{name}")
    assert not list(tmp_path.iterdir())


def test_record_is_named_after_its_run_and_needs_its_suffix(run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert pack(run).name == f"{run.path.name}.robustflow"
    refusal(lambda: pack(run, tmp_path / "a.zip"), UsageError, tmp_path / "a.zip")
    with pytest.raises(DataError):
        pack(run, tmp_path / "nowhere" / "a.robustflow")


class Strange(ZeroFlow):
    """A model whose name contains markup."""

    def identity(self):
        return {"name": "<img src=x onerror=alert(1)> [red]$x$"}


def test_file_of_a_different_kind_is_not_overwritten(run, tmp_path, packed):
    target = tmp_path / "mine.robustflow"

    def of_another_seed(manifest):
        manifest["identity"]["frames"]["seed"] = 1
        manifest["identity_digest"] = digest_of_value(manifest["identity"])

    other = with_json(packed, "manifest.json", of_another_seed)
    assert verified(other).ok
    for held in (b"letters", other):
        target.write_bytes(held)
        refusal(lambda: pack(run, target), RunError, target)
        assert target.read_bytes() == held
    assert pack(run, target, overwrite=True).stat().st_size > 1000
    pack(run, target, author="Grace")  # the same run with different texts
    assert b"Grace" in target.read_bytes()


def test_record_is_accepted_wherever_runs_are_read(run, packed, tmp_path):
    path = tmp_path / "a.robustflow"
    path.write_bytes(packed)
    loaded = load_any_run(path)
    assert loaded.means == run.means
    assert loaded.rows.equals(run.rows)
    strange = evaluate(Strange(), "demo", output=tmp_path / "s", corruptions=["fog"], severities=[1])
    assert load_any_run(pack(strange, tmp_path / "s.robustflow")).name == strange.name


def test_folder_of_a_loaded_record_is_deleted_with_its_run(packed, tmp_path):
    path = tmp_path / "a.robustflow"
    path.write_bytes(packed)
    loaded = load_any_run(path)
    folder, reference = loaded.path, weakref.ref(loaded)
    assert folder.is_dir()
    assert load_any_run(path).path != folder
    del loaded
    assert reference() is None
    assert not folder.exists()


def test_path_that_is_neither_run_nor_record_is_refused(run, packed, tmp_path):
    assert load_any_run(run.path).path == run.path
    (tmp_path / "a.txt").write_text("PK")
    refusal(lambda: load_any_run(tmp_path / "a.txt"), RunError, tmp_path / "a.txt")
    refusal(lambda: load_any_run(tmp_path), RunError, tmp_path)
    os.mkfifo(tmp_path / "pipe.robustflow")
    refusal(lambda: load_any_run(tmp_path / "pipe.robustflow"), RunError, tmp_path / "pipe.robustflow")
    bad = tmp_path / "bad.robustflow"
    bad.write_bytes(with_json(packed, "record.json", lambda record: record.update(complete=False)))
    refusal(lambda: load_any_run(bad), RunError, bad)
