"""Checkpoints may come from anyone: valid ones are loaded in every layout, malicious ones are rejected without running
their code, and weights that do not match the network are rejected.
"""

import argparse
import hashlib
import os
import pickle
import random
import struct
import zipfile
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("torch", reason="needs the torch extra")

import torch
from safetensors.torch import save_file

from robustflow.core.errors import ModelError, UsageError
from robustflow.models.torch.build import find_checkpoint
from robustflow.models.torch.checkpoint import read_content

from ...refusals import refusal
from .small_net import BelowModel, Net, Payload, load, net_state

pytestmark = pytest.mark.torch


@pytest.fixture
def state():
    return net_state()


@pytest.fixture
def path(tmp_path):
    return tmp_path / "weights.pth"


LAYOUTS = {
    "bare": lambda state: state,
    "state_dict": lambda state: {"epoch": 7, "state_dict": state},
    "model": lambda state: {"model": state, "optimizer": {"lr": 0.1}},
    "model_state_dict": lambda state: {"model_state_dict": state, "optimizer_state_dict": {"state": {}}, "epoch": 3},
    "data parallel": lambda state: {f"module.{key}": value for key, value in state.items()},
    "lightning": lambda state: {"state_dict": {f"model.{key}": value for key, value in state.items()}},
    "ptlflow's csflow": lambda state: {"state_dict": {f"_model.{key}": value for key, value in state.items()}},
    "two wrappers": lambda state: {f"module.model.{key}": value for key, value in state.items()},
    "nested": lambda state: {"epoch": 7, "model": {"state_dict": state}},
    "compiled": lambda state: {f"module._orig_mod.{key}": value for key, value in state.items()},
    "beside numbers": lambda state: {"state_dict": state, "best": np.float64(1.5), "args": argparse.Namespace(lr=1)},
}


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("zipped", [True, False], ids=["zip", "legacy"])
@pytest.mark.parametrize("kind", [Net, BelowModel])
def test_weights_are_found_in_every_layout_of_the_authors(path, state, layout, zipped, kind):
    torch.save(LAYOUTS[layout](state), path, _use_new_zipfile_serialization=zipped)
    net, read, cast = load(path, kind())
    for found, expected in zip(net.state_dict().values(), state.values(), strict=True):
        assert torch.equal(found, expected)
    assert cast is None
    assert read.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()


def test_safetensors_with_any_header_length_are_read(path, state):
    """A header of 0x3c20 bytes starts with a space and "<", like a web page."""
    save_file(state, path)
    content = path.read_bytes()
    length = struct.unpack("<Q", content[:8])[0]
    path.write_bytes(struct.pack("<Q", 0x3C20) + content[8 : 8 + length].ljust(0x3C20) + content[8 + length :])
    net, read, cast = load(path)
    assert all(torch.equal(value, state[key]) for key, value in net.state_dict().items())
    assert (cast, read.trained_on) == (None, None)


def test_only_network_entries_are_read_from_the_checkpoint_of_a_trainer(path, state):
    runner = {f"module.model.{key}": value for key, value in state.items()}
    runner |= {"module.corrector.first.weight": torch.zeros(1), "module.first.weight": torch.zeros(1)}
    torch.save(runner, path)
    net, *_ = load(path, BelowModel(), scope="model.")
    assert torch.equal(net.model.first.weight, state["first.weight"])
    refusal(lambda: load(path), ModelError, path)


def test_names_that_equal_the_networks_are_used_as_they_are(path):
    net = BelowModel()
    net.first = torch.nn.Conv2d(3, 4, 3)  # `first.weight` beside `model.first.weight`
    torch.save(net.state_dict(), path)
    fresh = BelowModel()
    fresh.first = torch.nn.Conv2d(3, 4, 3)
    load(path, fresh)
    assert torch.equal(fresh.first.weight, net.first.weight)
    assert torch.equal(fresh.model.first.weight, net.model.first.weight)


def test_hash_of_a_known_checkpoint_is_checked(path, state):
    torch.save(state, path)
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    assert load(path, sha256=digest)[1].sha256 == digest
    assert load(path, sha256=digest[:8].upper())[1].sha256 == digest
    assert digest in str(refusal(lambda: load(path, sha256="00000000"), ModelError, path))
    for wrong in (digest[:7], "", 12345678, digest + "0", "xyzxyzxyz"):
        refusal(lambda wrong=wrong: load(path, sha256=wrong), UsageError, "sha256")


def crafted_archive(path, pickled: bytes) -> None:
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("a/data.pkl", pickled)
        archive.writestr("a/version", "3\n")


def test_a_state_dict_written_by_python_2_is_read(path):
    """Python 2 stored an OrderedDict as a call with a list of pairs, as in the weights of LPIPS."""
    pairs = b"".join(b"](X\x01\0\0\0" + name + b"K\x01e" for name in (b"a", b"b"))
    crafted_archive(path, b"\x80\x02ccollections\nOrderedDict\n](" + pairs + b"e\x85R.")
    assert read_content(path)[0] == {"a": 1, "b": 1}


@pytest.mark.parametrize("kind", ["zip", "legacy", "safetensors"])
def test_flipped_bit_is_refused_with_the_path_or_read(path, state, kind):
    if kind == "safetensors":
        save_file(state, path)
    else:
        torch.save({"state_dict": state, "lr": [0.1]}, path, _use_new_zipfile_serialization=kind == "zip")
    whole = path.read_bytes()
    draw, culprits = random.Random(0), set()
    for _ in range(200):
        at = draw.randrange(len(whole))
        path.write_bytes(whole[:at] + bytes([whole[at] ^ 1 << draw.randrange(8)]) + whole[at + 1 :])
        try:
            load(path)
        except ModelError as error:
            culprits.add(error.culprit)
    assert culprits == {str(path)}


class Crafted:
    """An object with an allowed name, whose state must not be restored."""

    def __init__(self, payload) -> None:
        self.payload = payload

    def __reduce__(self):
        return argparse.Namespace, (), {"__class__": 1, "x": self.payload}


@pytest.mark.parametrize("kind", ["zip", "legacy", "plain pickle"])
@pytest.mark.parametrize("place", ["value", "beside", "behind an allowed name", "whole"])
def test_a_payload_is_refused_and_not_run(tmp_path, path, state, kind, place, recwarn):
    payload = Payload(tmp_path / "ran")
    content = {
        "value": {**state, "x": payload},
        "beside": {"state_dict": state, "x": payload},
        "behind an allowed name": {"state_dict": state, "args": Crafted(payload)},
        "whole": payload,
    }[place]
    if kind == "plain pickle":
        path.write_bytes(pickle.dumps(content))
    else:
        torch.save(content, path, _use_new_zipfile_serialization=kind == "zip")
    refusal(lambda: load(path), ModelError, path)
    assert not (tmp_path / "ran").exists()
    assert not [one.message for one in recwarn if one.category is not ResourceWarning]


def with_itself() -> dict:
    content: dict = {"epoch": 7}
    content["model"] = content
    return content


NO_WEIGHTS = {
    "html": b"<!DOCTYPE html><html><body>Sign in</body></html>",
    "html with a mark": b"\xef\xbb\xbf\n  <html><head></head></html>",
    "xml": b"<?xml version='1.0'?><Error><Code>AccessDenied</Code></Error>",
    "lfs": b"version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 1\n",
    "empty": b"",
    "blank": b" \n",
    "text": b"Not found",
    "zip": b"PK\x03\x04 and then nothing",
    "noise": random.Random(0).randbytes(5000),
    "a list": [1, 2],
    "nothing": {},
    "no entries": {"state_dict": {}},
    "a number": {"epoch": 3},
    "a key that is no name": {3: torch.zeros(2)},
    "itself": with_itself(),
    "a module": torch.nn.Linear(2, 2),
}


@pytest.mark.parametrize("content", NO_WEIGHTS.values(), ids=NO_WEIGHTS)
def test_file_without_weights_is_refused(path, content):
    if isinstance(content, bytes):
        path.write_bytes(content)
    else:
        torch.save(content, path)
    refusal(lambda: load(path), ModelError, path)


@pytest.mark.parametrize("zipped", [True, False], ids=["zip", "legacy"])
def test_truncated_checkpoint_is_refused(path, state, zipped):
    torch.save(state, path, _use_new_zipfile_serialization=zipped)
    whole = path.read_bytes()
    for length in [*range(1, len(whole), max(1, len(whole) // 40)), len(whole) - 1]:
        path.write_bytes(whole[:length])
        refusal(lambda: load(path), ModelError, path)


def test_a_changed_byte_or_an_encrypted_archive_is_refused(path, state):
    torch.save(state, path)
    whole = path.read_bytes()
    changed, encrypted = bytearray(whole), bytearray(whole)
    changed[changed.index(state["first.weight"].numpy().tobytes()) + 5] ^= 1
    for header, flags in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        encrypted[encrypted.index(header) + flags] |= 1
    for content in (changed, encrypted):
        path.write_bytes(content)
        refusal(lambda: load(path), ModelError, path)


def test_checkpoint_that_is_no_regular_file_is_refused_at_once(tmp_path, path):
    refusal(lambda: load(path), ModelError, path)
    refusal(lambda: load(tmp_path), ModelError, tmp_path)
    os.mkfifo(path)
    refusal(lambda: load(path), ModelError, path)


def test_missing_and_unknown_weights_are_counted_and_the_first_are_named(path, state):
    changed = {**state, "head.weight": state["first.weight"], "first.bias": torch.zeros(5)}
    del changed["first.weight"]
    torch.save(changed, path)
    net = Net()
    before = {key: value.clone() for key, value in net.state_dict().items()}
    message = str(refusal(lambda: load(path, net), ModelError, path))
    assert all(name in message for name in ("first.weight", "head.weight", "first.bias 5"))
    assert all(torch.equal(value, before[key]) for key, value in net.state_dict().items())
    torch.save({f"layer{i}.weight": torch.zeros(1) for i in range(500)}, path)
    message = str(refusal(lambda: load(path), ModelError, path))
    assert all(part in message for part in ("500", "layer2.weight", "497"))
    assert len(message) < 500 + len(str(path))


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16, torch.float64])
def test_weights_of_other_float_types_are_cast_and_reported(path, state, dtype):
    other = {key: value.to(dtype) if value.is_floating_point() else value for key, value in state.items()}
    torch.save(other, path)
    net, _, cast = load(path)
    assert cast == str(dtype).removeprefix("torch.")
    assert net.first.weight.dtype == torch.float32
    assert torch.equal(net.first.weight, other["first.weight"].float())


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), -float("inf"), 1e300])
def test_values_that_are_not_finite_in_float32_are_refused(path, state, bad):
    state["first.weight"] = state["first.weight"].double()
    state["first.weight"][1, 2, 0, 1] = bad
    torch.save(state, path)
    assert "'first.weight'" in str(refusal(lambda: load(path), ModelError, path))


@pytest.mark.parametrize(
    "value",
    [
        torch.zeros(4, dtype=torch.int32),
        torch.zeros(4, dtype=torch.complex64),
        torch.zeros(4).to_sparse(),
        torch.zeros(4, device="meta"),
        torch.zeros(1).expand(1 << 40),
    ],
    ids=["integers", "complex", "sparse", "meta", "huge of one stored value"],
)
def test_values_of_a_different_kind_are_refused(path, state, value):
    torch.save({**state, "first.bias": value}, path)
    assert path.stat().st_size < 100_000
    refusal(lambda: load(path), ModelError, path)


PUBLISHED = {"things": "https://example.org/net-things-0123abcd.pth", "kitti": "https://example.org/kitti.pth"}


def find(checkpoint, published=PUBLISHED):
    return find_checkpoint("net", checkpoint, published, "the authors' file")


def test_path_of_a_checkpoint_is_used_unchanged(tmp_path, monkeypatch):
    path = tmp_path / "mine-0123abcd.pth"
    path.touch()
    assert find(path) == find(str(path)) == (path, None)
    monkeypatch.setenv("HOME", str(tmp_path))
    assert find("~/mine-0123abcd.pth") == (path, None)


def test_published_name_takes_precedence_over_a_file_of_that_name(tmp_path, monkeypatch):
    monkeypatch.setattr(torch.hub, "get_dir", lambda: str(tmp_path / "hub"))
    monkeypatch.chdir(tmp_path)
    fetched = []

    def fetch(url, path, hash_prefix, progress):
        Path(path).touch()
        fetched.append((url, hash_prefix))

    monkeypatch.setattr(torch.hub, "download_url_to_file", fetch)
    Path("things").touch()
    cached = tmp_path / "hub" / "checkpoints"
    for _ in range(2):
        assert find("things") == (cached / "net-things-0123abcd.pth", "0123abcd")
        assert find("kitti") == (cached / "kitti.pth", None)
    assert fetched == [(PUBLISHED["things"], "0123abcd"), (PUBLISHED["kitti"], None)]
    assert find("./things") == (Path("things"), None)


@pytest.mark.parametrize(
    ("checkpoint", "error", "culprit"),
    [
        (None, ModelError, "net"),
        ("thing", UsageError, "thing"),
        ("/nowhere/thing.pth", ModelError, "/nowhere/thing.pth"),
    ],
)
def test_missing_checkpoint_is_refused_with_where_to_get_it(checkpoint, error, culprit):
    assert "things" in str(refusal(lambda: find(checkpoint), error, culprit))
    if checkpoint is None:
        assert "the authors' file" in str(refusal(lambda: find(None, {}), error, culprit))
