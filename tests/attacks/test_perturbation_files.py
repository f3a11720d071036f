"""Perturbations that `universal` reads from files, which are untrusted."""

from __future__ import annotations

import io
import pickle
import zipfile
from functools import partial

import numpy as np
import pytest

import robustflow as rf
from robustflow.attacks.ball import images_of
from robustflow.core.errors import DataError

from ..refusals import refused
from .small_runs import still

GREY = np.full((2, 8, 10, 3), 128, np.uint8)


def test_the_files_of_pcfa_are_read_one_for_each_frame(tmp_path):
    first, second = np.random.default_rng(0).normal(0, 0.01, (2, 1, 3, 8, 10)).astype(np.float32)
    np.save(tmp_path / "1.npy", first)
    np.save(tmp_path / "2.npy", second)
    both = rf.attack(*GREY, still, f"universal:file={tmp_path}/1.npy:second={tmp_path}/2.npy", budget=127)
    one = rf.attack(*GREY, still, f"universal:file={tmp_path}/1.npy", budget=127)
    assert np.allclose(both.images, images_of(*GREY) + np.concatenate([first, second]), atol=1e-6)
    assert np.allclose(one.images, images_of(*GREY) + first, atol=1e-6)


def _npy(array):
    file = io.BytesIO()
    np.save(file, array, allow_pickle=True)
    return file.getvalue()


def _zip():
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("a.npy", _npy(np.zeros(3)))
    return file.getvalue()


BOMB = _npy(np.zeros((3, 8, 10), np.float32)).replace(b"(3, 8, 10)", b"(3, 8, 99)")


def test_a_perturbation_file_of_an_unknown_user_is_refused():
    with refused(DataError, "there is no such user"):
        rf.attack(*GREY, still, "universal:file=~no_such_user_here/d.npy", 3)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "is not a file"),
        (b"", r"is not a NumPy array \(.npy\)"),
        (_zip(), r"is not a NumPy array \(.npy\)"),
        (pickle.dumps(partial(print, "run")), r"is not a NumPy array \(.npy\)"),
        (_npy(np.array([print, 1], object)), "is damaged, or not an array of numbers"),
        (BOMB, "is damaged, or not an array of numbers"),
        (b"\x93NUMPY\x01\x00\x10\x00{'descr': [[[[[[[", "is damaged, or not an array of numbers"),
        (_npy(np.zeros((3, 8, 10), int)), "an array int64"),
        (_npy(np.zeros((8, 10))), r"an array float64 \(8, 10\)"),
        (_npy(np.zeros((2, 2, 8, 10))), r"an array \(2, 2, 8, 10\)"),
        (_npy(np.full((3, 8, 10), np.nan)), "NaN or infinite"),
        (_npy(np.zeros((3, 9, 10))), "is for frames of 9x10 pixels, but the frames of sample '' are 8x10"),
    ],
)
def test_a_perturbation_file_that_does_not_fit_is_refused_in_one_line(tmp_path, content, message):
    path = tmp_path / "d.npy"
    if content is not None:
        path.write_bytes(content)
    with refused(DataError, message):
        rf.attack(*GREY, still, f"universal:file={path}", 3)
