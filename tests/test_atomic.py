"""Atomic writing, and targets that are not files."""

from __future__ import annotations

import os
from threading import Thread

import pytest

from robustflow.core.errors import DataError
from robustflow.core.files import write_bytes


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
    (tmp_path / "folder").mkdir()
    with pytest.raises(DataError, match=r"cannot write .*folder"):
        write_bytes(tmp_path / "folder", b"means")
    assert os.listdir(tmp_path) == ["folder"]
