"""Damaged, edited and outdated manifests are refused by their path, and never overwritten."""

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

from ..refusals import refusal
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
    "empty": lambda manifest: {},
    "no version": _removing("version"),
    "another version": _setting(5, "version"),
    "another version of the rows": _setting(1, "identity", "measuring", "rows"),
    "another version of the identity": _setting(1, "identity", "measuring", "version"),
    "no identity": _removing("identity"),
    "no samples": _removing("samples"),
    "no plan": _removing("planned"),
    "no seed": _removing("identity", "frames", "seed"),
    "a sample a number": _setting(7, "samples", "motorcycle"),
    "severity 9": _setting([9], "planned", 0, "corruptions", "contrast"),
    "a severity twice": _setting([1, 1], "planned", 0, "corruptions", "contrast"),
    "a sample that is not planned": _setting([], "samples", "other"),
    "a sample planned twice": _setting(["motorcycle"] * 2, "planned", 0, "samples"),
    "no basis": _removing("training", "basis"),
    "deep": _setting(json.loads("[" * 900 + "]" * 900), "identity", "frames", "protocol", "x"),
}


TEXTS = {
    "nothing": lambda text: "",
    "half": lambda text: text[: len(text) // 2],
    "too deep": lambda text: "[" * 100_000,
    "a long number": lambda text: '{"version": 1' + "0" * 5000 + "}",
    "seed edited": lambda text: text.replace('"seed": 0', '"seed": 7'),
    "seed edited with a digest": lambda text: json.dumps(sealed(json.loads(text.replace('"seed": 0', '"seed": 7')))),
} | {name: lambda text, edit=edit: json.dumps(fitting(edit(json.loads(text)))) for name, edit in SHAPES.items()}


@pytest.mark.parametrize("edit", TEXTS.values(), ids=TEXTS)
def test_damaged_manifest_is_refused_by_its_path_and_not_overwritten(edit, whole, tmp_path):
    folder = tmp_path / "run"
    shutil.copytree(whole, folder)
    path = folder / "manifest.json"
    path.write_text(edit(path.read_text()))
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file() and path.name != ".lock"}
    refusal(lambda: Run(folder), RunError, path)
    refusal(lambda: rf.evaluate("dis", output=folder, **CELL), RunError, path)
    assert before == {path: path.read_bytes() for path in before}


def test_a_flipped_bit_in_a_manifest_is_detected(whole, tmp_path):
    data = (whole / "manifest.json").read_bytes()
    rng = np.random.default_rng(0)
    for place, bit in zip(rng.integers(0, len(data), 400), rng.integers(0, 8, 400), strict=True):
        flipped = bytearray(data)
        flipped[place] ^= 1 << bit
        (tmp_path / "manifest.json").write_bytes(flipped)
        refusal(lambda: Run(tmp_path), RunError, tmp_path / "manifest.json")


def test_manifest_reads_back_equal(whole):
    assert Run(whole).manifest.document() == (whole / "manifest.json").read_bytes()


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
    refusal(lambda: RunSource.read(tmp_path), RunError, tmp_path / "source.json")


def test_data_options_that_json_lacks_are_written_as_text_and_none_stays_none(tmp_path):
    options = {"textures": None, "readout": float("inf"), "root": Path("a"), "step": 2, "motion": 0.5}
    RunSource(data_options=options).write(tmp_path)
    assert RunSource.read(tmp_path).data_options == options | {"readout": "inf", "root": "a"}
