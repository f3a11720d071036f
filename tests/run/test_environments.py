"""A run that is continued with other versions of its libraries says so, and keeps each environment with its rows."""

import numpy as np
import pytest

import robustflow as rf
from robustflow.core.errors import RunError
from robustflow.run import compute_missing, identity
from robustflow.run.records.pack import record_bytes
from robustflow.run.records.read import Reader
from robustflow.run.records.verify import verify_read

from ..refusals import refusal

STATE = {"factor": 1.0}


def _flow(frame1, frame2):
    return STATE["factor"] * np.stack([frame1[..., 0], frame2[..., 1]], axis=2).astype(np.float32)


@pytest.fixture
def run(tmp_path, monkeypatch):
    """Return a function that continues one run with versions of packages."""
    original = dict(identity._versions())

    def call(severities, **versions):
        monkeypatch.setattr(identity, "_versions", lambda: original | versions)
        rf.evaluate(_flow, output=tmp_path / "run", corruptions=["contrast"], severities=severities)

    return call


def _told(recwarn):
    return [str(one.message) for one in recwarn if "other versions" in str(one.message)]


def _made(manifest):
    return [
        {level for cells in part.made for _, name, level in cells.every() if name == "contrast"}
        for part in manifest.earlier
    ]


def test_each_environment_is_kept_with_the_rows_that_it_made(run, tmp_path, recwarn):
    run([1], numpy="1.0")
    run([1, 2], numpy="1.0")
    assert _told(recwarn) == []
    run([1, 2, 3], numpy="1.1", scipy="0.1")
    (message,) = _told(recwarn)
    assert all(word in message for word in ("numpy", "1.0", "1.1", "scipy", "3 rows", str(tmp_path / "run")))
    run([1, 2, 3, 4], numpy="1.2")
    manifest = rf.load_run(tmp_path / "run").manifest
    assert [part.packages["numpy"] for part in (*manifest.earlier, manifest.environment)] == ["1.0", "1.1", "1.2"]
    assert _made(manifest) == [{1, 2}, {3}]
    whole = rf.load_run(tmp_path / "run")
    reader = Reader(record_bytes(whole), "record")
    assert verify_read(reader).ok
    assert [part.made for part in reader.plan.earlier] == [part.made for part in manifest.earlier]
    assert all(part.command == () for part in reader.plan.earlier)


def test_an_environment_that_computes_nothing_is_not_recorded(run, tmp_path, recwarn):
    run([1], numpy="1.0")
    run([1], numpy="1.1")
    assert _told(recwarn) == []
    assert rf.load_run(tmp_path / "run").manifest.environment.packages["numpy"] == "1.0"


@pytest.mark.parametrize("package", ["polars", "onnxruntime", "ptlflow"])
def test_versions_that_decide_neither_bytes_nor_flows_are_not_compared(run, monkeypatch, recwarn, package):
    monkeypatch.delitem(identity.sys.modules, package if package != "polars" else "", raising=False)
    run([1], **{package: "1.0"})
    run([2], **{package: "1.1"})
    assert _told(recwarn) == []


def test_versions_are_named_before_the_model_is_measured_again_and_nothing_is_written(run, tmp_path, monkeypatch):
    run([1], numpy="1.0")
    files = {path: path.read_bytes() for path in (tmp_path / "run").rglob("*") if path.is_file()}
    monkeypatch.setitem(STATE, "factor", 1.5)
    with pytest.warns(UserWarning, match=r"numpy 1\.0, now 1\.1"):
        refusal(lambda: run([2], numpy="1.1"), RunError, "motorcycle")
    assert files == {path: path.read_bytes() for path in files}


def test_rows_of_removed_samples_are_removed_from_their_environment(run, tmp_path):
    run([1], numpy="1.0")
    run([2], numpy="1.1")
    manifest = rf.load_run(tmp_path / "run").manifest
    assert manifest.without(["motorcycle"]).earlier == ()
    assert manifest.without([]).earlier == manifest.earlier


@pytest.mark.parametrize("edit", ["more rows than planned", "another sample", "no rows"])
def test_an_environment_whose_rows_cannot_exist_is_refused(run, tmp_path, edit):
    run([1], numpy="1.0")
    run([2], numpy="1.1")
    manifest = rf.load_run(tmp_path / "run").manifest
    (part,) = manifest.earlier
    made = {
        "more rows than planned": part.made * 9,
        "another sample": tuple(cells.among(["other"]) for cells in part.made),
        "no rows": (),
    }[edit]
    changed = manifest.model_copy(update={"earlier": (part.model_copy(update={"made": made}),)})
    path = tmp_path / "run" / "manifest.json"
    path.write_bytes(changed.document())
    refusal(lambda: rf.load_run(tmp_path / "run"), RunError, path)


def test_the_encoder_of_video_corruptions_is_part_of_the_environment():
    class Clips:
        def with_variant(self, variant):
            return self

        def clip_records(self):
            return []

    plan = type("Plan", (), {"benchmark": type("Benchmark", (), {"dataset": Clips()})})
    assert {"libavcodec", "libx264"} <= compute_missing._environment(plan).packages.keys()
    plan.benchmark.dataset = None
    assert "libx264" not in compute_missing._environment(plan).packages
