"""Checkpoints may come from anyone: valid ones are loaded in every layout, and malicious ones are rejected without
running their code.
"""

import argparse
import hashlib
import os
import pickle
import random
import zipfile

import numpy as np
import pytest

pytest.importorskip("torch", reason="needs the torch extra")

import torch

from robustflow.errors import ModelError, UsageError

from .small_net import BelowModel, Net, Payload, load, net_state, one_line

pytestmark = pytest.mark.torch


@pytest.fixture
def state():
    return net_state()


LAYOUTS = {
    "bare": lambda state: state,
    "state_dict": lambda state: {"epoch": 7, "state_dict": state},
    "model": lambda state: {"model": state, "optimizer": {"lr": 0.1}},
    "model_state_dict": lambda state: {"model_state_dict": state, "optimizer_state_dict": {"state": {}}, "epoch": 3},
    "data parallel": lambda state: {f"module.{key}": value for key, value in state.items()},
    "lightning": lambda state: {"state_dict": {f"model.{key}": value for key, value in state.items()}},
    "ptlflow's csflow": lambda state: {"state_dict": {f"_model.{key}": value for key, value in state.items()}},
    "two wrappers": lambda state: {f"module.model.{key}": value for key, value in state.items()},
    "beside numbers": lambda state: {"state_dict": state, "best": np.float64(1.5), "args": argparse.Namespace(lr=1)},
}


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("zipped", [True, False], ids=["zip", "legacy"])
@pytest.mark.parametrize("kind", [Net, BelowModel])
def test_layouts_of_the_authors(tmp_path, state, layout, zipped, kind):
    path = tmp_path / "weights.pth"
    torch.save(LAYOUTS[layout](state), path, _use_new_zipfile_serialization=zipped)
    net, read, cast = load(path, kind())
    for (_, found), expected in zip(net.state_dict().items(), state.values(), strict=True):
        assert torch.equal(found, expected)
    assert cast is None
    assert read.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()


def test_only_the_networks_own_entries_of_a_training_runner(tmp_path, state):
    runner = {f"module.model.{key}": value for key, value in state.items()}
    runner |= {"module.corrector.first.weight": torch.zeros(1), "module.first.weight": torch.zeros(1)}
    torch.save(runner, tmp_path / "runner.pt")
    net, *_ = load(tmp_path / "runner.pt", BelowModel(), scope="model.")
    assert torch.equal(net.model.first.weight, state["first.weight"])
    with pytest.raises(ModelError, match=r"under two prefixes"):
        load(tmp_path / "runner.pt")


def test_the_hash_is_checked_where_it_is_known(tmp_path, state):
    path = tmp_path / "weights.pth"
    torch.save(state, path)
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    assert load(path, sha256=digest)[1].sha256 == digest
    assert load(path, sha256=digest[:8].upper())[1].sha256 == digest
    with pytest.raises(ModelError, match=f"its SHA-256 is {digest} instead of 00000000") as error:
        load(path, sha256="00000000")
    one_line(error)
    for wrong in (digest[:7], "", 12345678, digest + "0", "xyzxyzxyz"):
        with pytest.raises(UsageError, match=r"is not a SHA-256 \(64 hexadecimal digits\)"):
            load(path, sha256=wrong)


@pytest.mark.parametrize("zipped", [True, False], ids=["zip", "legacy"])
@pytest.mark.parametrize("place", ["value", "beside", "whole"])
def test_a_payload_is_refused_and_not_run(tmp_path, state, zipped, place):
    marker = tmp_path / "ran"
    payload = Payload(marker)
    content = {"value": {**state, "x": payload}, "beside": {"state_dict": state, "x": payload}, "whole": payload}[place]
    path = tmp_path / "weights.pth"
    torch.save(content, path, _use_new_zipfile_serialization=zipped)
    with pytest.raises(ModelError, match=r"not loaded, because it contains more than plain weights.*system") as error:
        load(path)
    one_line(error)
    assert not marker.exists()


def test_a_plain_pickle_with_a_payload_is_refused_and_not_run(tmp_path, recwarn):
    marker = tmp_path / "ran"
    (tmp_path / "weights.pkl").write_bytes(pickle.dumps({"x": Payload(marker)}))
    with pytest.raises(ModelError, match="not loaded"):
        load(tmp_path / "weights.pkl")
    assert not marker.exists()
    assert not recwarn.list


def test_what_stands_for_things_beside_weights_runs_nothing(tmp_path, state):
    """Allowed names must not cause the objects with these names to be imported."""
    marker = tmp_path / "ran"

    class Crafted:
        def __reduce__(self):
            return argparse.Namespace, (), {"__class__": 1, "x": Payload(marker)}

    torch.save({"state_dict": state, "args": Crafted()}, tmp_path / "weights.pth")
    with pytest.raises(ModelError, match="not loaded, because it contains more than plain weights"):
        load(tmp_path / "weights.pth")
    assert not marker.exists()


def test_a_whole_module_is_refused(tmp_path):
    torch.save(torch.nn.Linear(2, 2), tmp_path / "module.pth")
    with pytest.raises(ModelError, match=r"more than plain weights.*save only its state_dict") as error:
        load(tmp_path / "module.pth")
    one_line(error)


def test_a_zip_bomb_is_refused_before_it_is_unpacked(tmp_path, state):
    torch.save(state, tmp_path / "good.pth")
    bomb = tmp_path / "bomb.pth"
    with (
        zipfile.ZipFile(tmp_path / "good.pth") as good,
        zipfile.ZipFile(bomb, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as out,
    ):
        for record in good.infolist():
            out.writestr(record.filename, good.read(record))
        with out.open("good/data/99", "w", force_zip64=True) as record:
            for _ in range(64):
                record.write(bytes(1 << 20))
    with pytest.raises(ModelError, match=r"would unpack to \d{8,}") as error:
        load(bomb)
    one_line(error)


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"<!DOCTYPE html><html><body>Sign in</body></html>", "is a web page"),
        (b"\xef\xbb\xbf\n  <html><head></head></html>", "is a web page"),
        (b"<?xml version='1.0'?><Error><Code>AccessDenied</Code></Error>", "is a web page"),
        (b"version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 1\n", "Git LFS pointer"),
        (b"", "is empty"),
        (b" \n", "is empty"),
        (b"Not found", "contains more than plain weights|truncated or damaged"),
        (b"PK\x03\x04 and then nothing", "truncated or damaged"),
        (random.Random(0).randbytes(5000), "contains more than plain weights|truncated or damaged"),
    ],
)
def test_what_is_not_a_checkpoint(tmp_path, content, says):
    (tmp_path / "weights.pth").write_bytes(content)
    with pytest.raises(ModelError, match=says) as error:
        load(tmp_path / "weights.pth")
    assert str(tmp_path / "weights.pth") in one_line(error)


@pytest.mark.parametrize("zipped", [True, False], ids=["zip", "legacy"])
def test_a_file_cut_anywhere_is_refused(tmp_path, state, zipped):
    path = tmp_path / "weights.pth"
    torch.save(state, path, _use_new_zipfile_serialization=zipped)
    whole = path.read_bytes()
    for kept in [*range(1, len(whole), max(1, len(whole) // 40)), len(whole) - 1]:
        path.write_bytes(whole[:kept])
        with pytest.raises(ModelError) as error:
            load(path)
        one_line(error)


def test_a_changed_byte_is_noticed(tmp_path, state):
    path = tmp_path / "weights.pth"
    torch.save(state, path)
    changed = bytearray(path.read_bytes())
    weight = state["first.weight"].numpy().tobytes()
    changed[changed.index(weight) + 5] ^= 1
    path.write_bytes(changed)
    with pytest.raises(ModelError, match=r"damaged .*checksum") as error:
        load(path)
    one_line(error)


def test_an_encrypted_archive_is_refused(tmp_path, state):
    path = tmp_path / "weights.pth"
    torch.save(state, path)
    content = bytearray(path.read_bytes())
    for header, flags in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        content[content.index(header) + flags] |= 1
    path.write_bytes(content)
    with pytest.raises(ModelError, match="damaged") as error:
        load(path)
    one_line(error)


def test_a_pipe_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "weights.pth")
    with pytest.raises(ModelError, match="a pipe or a device, not a file"):
        load(tmp_path / "weights.pth")


def test_missing_or_a_folder(tmp_path):
    with pytest.raises(ModelError, match=r"nothing\.pth: no such checkpoint; put the authors' file there"):
        load(tmp_path / "nothing.pth")
    with pytest.raises(ModelError, match=r"cannot be read: (Is a directory|Permission)"):
        load(tmp_path)


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ([1, 2], "contains list, not named weights"),
        ({}, "contains dict, not named weights"),
        ({"state_dict": {}}, "contains dict, not named weights"),
        ({"epoch": 3}, "entry 'epoch' is int, not a tensor"),
        ({3: torch.zeros(2)}, "entry '3' is under a non-string key"),
    ],
)
def test_files_without_weights(tmp_path, content, says):
    torch.save(content, tmp_path / "weights.pth")
    with pytest.raises(ModelError, match=says) as error:
        load(tmp_path / "weights.pth")
    one_line(error)
