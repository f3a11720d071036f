"""A manifest with the wrong structure is rejected with a one-sentence message that names the file and the remedy."""

from __future__ import annotations

import json
import shutil
from functools import reduce
from operator import getitem
from pathlib import Path

import numpy as np
import pytest

import robustflow as rf
from robustflow.core.errors import RunError
from robustflow.core.files import sealed
from robustflow.run.run import Run
from robustflow.run.source import RunSource

from .edited import fitting

CELL = {"corruptions": ["contrast"], "severities": [1]}


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    folder = tmp_path_factory.mktemp("manifest") / "run"
    rf.evaluate("dis", output=folder, **CELL)
    return folder


def _removing(*path):
    def edit(manifest):
        del reduce(getitem, path[:-1], manifest)[path[-1]]
        return manifest

    return edit


def _setting(value, *path):
    def edit(manifest):
        reduce(getitem, path[:-1], manifest)[path[-1]] = value
        return manifest

    return edit


SHAPES = {
    "a list": lambda manifest: [manifest],
    "a number": lambda manifest: 3,
    "empty": lambda manifest: {},
    "nothing but the schema": lambda manifest: {"schema": 4},
    "no identity": _removing("identity"),
    "no digest": _removing("identity_digest"),
    "no samples": _removing("samples"),
    "no plan": _removing("planned"),
    "no model": _removing("identity", "model"),
    "no seed": _removing("identity", "frames", "seed"),
    "identity a list": _setting([], "identity"),
    "model a text": _setting("dis", "identity", "model"),
    "digest a number": _setting(5, "identity_digest"),
    "samples a list": _setting(["motorcycle"], "samples"),
    "a sample a number": _setting(7, "samples", "motorcycle"),
    "corruptions null": _setting(None, "planned", 0, "corruptions"),
    "severity 9": _setting([9], "planned", 0, "corruptions", "contrast"),
    "a severity twice": _setting([1, 1], "planned", 0, "corruptions", "contrast"),
    "a sample that is not planned": _setting([], "samples", "other"),
    "a sample planned twice": _setting(["motorcycle"] * 2, "planned", 0, "samples"),
    "provenance a list": _setting([1], "provenance"),
    "no basis": _removing("provenance", "basis"),
    "seconds a text": _setting("long", "seconds"),
    "packages a list": _setting(["numpy"], "environment", "packages"),
    "left out a list": _setting([1], "left_out"),
    "deep": _setting(json.loads("[" * 900 + "]" * 900), "identity", "frames", "protocol", "x"),
}


def damaged(whole, tmp_path, text: str):
    folder = tmp_path / "run"
    shutil.copytree(whole, folder)
    (folder / "manifest.json").write_text(text)
    return folder, {path: path.read_bytes() for path in folder.rglob("*") if path.is_file() and path.name != ".lock"}


def refused(folder, before, match: str) -> None:
    for use in (Run, lambda path: rf.evaluate("dis", output=path, **CELL)):
        with pytest.raises(RunError, match=match) as error:
            use(folder)
        assert "\n" not in str(error.value)
        assert "choose another folder" in str(error.value)
    assert before == {path: path.read_bytes() for path in before}


@pytest.mark.parametrize("shape", SHAPES)
def test_manifest_of_a_different_structure_is_refused_and_not_overwritten(shape, whole, tmp_path):
    manifest = json.loads((whole / "manifest.json").read_text())
    refused(*damaged(whole, tmp_path, json.dumps(fitting(SHAPES[shape](manifest)))), r"manifest\.json is damaged")


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("", "is damaged"),
        ("{", "is damaged"),
        ("[" * 100_000, "is damaged"),
        ('{"schema": 1' + "0" * 5000 + "}", "is damaged"),
        ("\ufeff{}", "is damaged"),
        ('{"schema": 1}', "was written with run schema 1, but this version reads 4"),
    ],
)
def test_manifest_of_invalid_json_or_an_older_schema_is_refused_and_not_overwritten(text, match, whole, tmp_path):
    refused(*damaged(whole, tmp_path, text), rf"manifest\.json {match}")


def test_rows_of_a_different_version_are_refused_in_one_sentence(whole, tmp_path):
    manifest = json.loads((whole / "manifest.json").read_text())
    before = manifest["identity"]["measuring"]["rows"] - 1
    edited = fitting(_setting(before, "identity", "measuring", "rows")(manifest))
    refused(
        *damaged(whole, tmp_path, json.dumps(edited)),
        rf"was written with version {before} of the rows, but .* reads {before + 1}",
    )


@pytest.mark.parametrize("fits", [False, True])
def test_edited_identity_in_a_manifest_is_refused(whole, tmp_path, fits):
    manifest = _setting(7, "identity", "frames", "seed")(json.loads((whole / "manifest.json").read_text()))
    refused(*damaged(whole, tmp_path, json.dumps(sealed(manifest) if fits else manifest)), "was changed after")


def test_a_flipped_bit_in_a_manifest_is_detected(whole, tmp_path):
    folder, _ = damaged(whole, tmp_path, "")
    data = (whole / "manifest.json").read_bytes()
    rng = np.random.default_rng(0)
    for place, bit in zip(rng.integers(0, len(data), 400), rng.integers(0, 8, 400), strict=True):
        flipped = bytearray(data)
        flipped[place] ^= 1 << bit
        (folder / "manifest.json").write_bytes(flipped)
        with pytest.raises(RunError, match=r"manifest\.json (is damaged|was changed|was written with run schema)"):
            Run(folder)


def test_manifest_reads_back_equal(whole):
    assert sealed(Run(whole).manifest.record()) == json.loads((whole / "manifest.json").read_text())


@pytest.mark.parametrize(
    "text",
    [
        "[]",
        "[" * 100_000,
        '{"model": 3, "data": null, "data_options": {}}',
        '{"model": {"name": "raft", "options": {"checkpoint": ["/x"]}}, "data": null, "data_options": {}}',
        '{"model": null, "data": null, "data_options": {"depth": {"folder": "/x"}}}',
    ],
)
def test_source_of_a_different_structure_is_refused_in_one_sentence(text, tmp_path):
    (tmp_path / "source.json").write_text(text)
    with pytest.raises(RunError, match=r"source\.json is damaged; delete it, and give --model and --data instead"):
        RunSource.read(tmp_path)


def test_data_options_that_json_lacks_are_written_as_text_and_none_stays_none(tmp_path):
    options = {"textures": None, "readout": float("inf"), "root": Path("a"), "step": 2, "motion": 0.5}
    RunSource(data_options=options).write(tmp_path)
    assert RunSource.read(tmp_path).data_options == options | {"readout": "inf", "root": "a"}
