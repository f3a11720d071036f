"""Atomic writing, targets that are not files, and damage to sealed content."""

from __future__ import annotations

import json
import os
from threading import Thread

import numpy as np

from robustflow.core.errors import DataError
from robustflow.core.files import json_bytes, sealed, sealed_bytes, unsealed, unsealed_bytes, write_bytes
from robustflow.corruptions.scale import read_table, shipped

from ..refusals import refusal


def test_a_pipe_receives_the_bytes_and_stays_a_pipe(tmp_path):
    pipe, received = tmp_path / "pipe", []
    os.mkfifo(pipe)
    reader = Thread(target=lambda: received.append(pipe.read_bytes()), daemon=True)
    reader.start()
    write_bytes(pipe, b"means")
    reader.join(5)
    assert (received, pipe.is_fifo(), os.listdir(tmp_path)) == ([b"means"], True, ["pipe"])


def test_a_link_to_a_file_descriptor_stays_a_link(tmp_path):
    with open(tmp_path / "redirected", "wb") as redirected:
        link = tmp_path / "stdout"
        link.symlink_to(f"/proc/self/fd/{redirected.fileno()}")
        write_bytes(link, b"means")
    assert link.is_symlink()
    assert (tmp_path / "redirected").read_bytes() == b"means"


def test_a_folder_is_not_replaced_and_nothing_is_left_beside_it(tmp_path):
    folder = tmp_path / "folder"
    folder.mkdir()
    refusal(lambda: write_bytes(folder, b"means"), DataError, folder)
    assert os.listdir(tmp_path) == ["folder"]


def flips(data: bytes, count: int = 200):
    rng = np.random.default_rng(0)
    for place, bit in zip(rng.integers(0, len(data), count), rng.integers(0, 8, count), strict=True):
        flipped = bytearray(data)
        flipped[place] ^= 1 << bit
        yield bytes(flipped)


def test_sealed_content_with_a_flipped_bit_is_rejected_or_equal():
    content = {"a": [1, 2.5, "text"], "b": {"c": None}, "small": 1e-9}
    for flipped in flips(json_bytes(sealed(content)), 1000):
        rest = unsealed(flipped)
        assert rest is None or json.loads(rest) == content
    for flipped in flips(sealed_bytes(b"some bytes", "x")):
        assert unsealed_bytes(flipped, "x") is None


def test_a_calibration_with_a_flipped_bit_is_refused(tmp_path):
    path = tmp_path / "table.json"
    whole = json_bytes(sealed(shipped().model_dump(mode="json")))
    path.write_bytes(whole)
    assert read_table(path) == shipped()
    for flipped in flips(whole):
        path.write_bytes(flipped)
        refusal(lambda: read_table(path), DataError, path)
