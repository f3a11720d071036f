"""A changed byte of a file is noticed where its format cannot tell, and runs without digests go on."""

from __future__ import annotations

import json

import pytest
from PIL import Image
from skimage import data

import robustflow as rf
from robustflow.errors import RunError
from robustflow.testing import ZeroFlow

CHOSEN = {"corruptions": ["contrast"], "severities": [1]}


@pytest.fixture
def frames(tmp_path):
    folder = tmp_path / "frames"
    folder.mkdir()
    for index in range(2):
        Image.fromarray(data.astronaut()[index : 64 + index, :96]).save(folder / f"{index}.bmp")
    return folder


def flip(path):
    content = bytearray(path.read_bytes())
    content[-5] ^= 1
    path.write_bytes(bytes(content))


def test_a_changed_byte_of_a_bmp_is_another_run(frames, tmp_path):
    result = rf.evaluate(ZeroFlow(), "folder", frames, tmp_path / "run", **CHOSEN)
    assert [len(digest) for digest in result.manifest["file_digests"]["0"]] == [16, 16]
    assert rf.evaluate(ZeroFlow(), "folder", frames, tmp_path / "run", **CHOSEN).rows.equals(result.rows)
    flip(frames / "1.bmp")
    with pytest.raises(RunError, match="made from other files for sample '0'"):
        rf.evaluate(ZeroFlow(), "folder", frames, tmp_path / "run", **CHOSEN)


def test_a_run_of_before_continues(frames, tmp_path):
    rf.evaluate(ZeroFlow(), "folder", frames, tmp_path / "run", **CHOSEN)
    path = tmp_path / "run" / "manifest.json"
    manifest = json.loads(path.read_text())
    del manifest["file_digests"]
    path.write_text(json.dumps(manifest))
    result = rf.evaluate(ZeroFlow(), "folder", frames, tmp_path / "run", **CHOSEN)
    assert set(result.manifest["file_digests"]) == {"0"}
