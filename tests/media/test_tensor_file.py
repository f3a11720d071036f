"""Files of tensors are read as PyTorch reads them; what does more than store weights is refused, within limits of time
and memory that the size of the file sets."""

import argparse
import collections
import io
import json
import pickle
import random
import re
import struct
import time
import tracemalloc
import zipfile
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

import robustflow

torch = pytest.importorskip("torch", reason="needs the torch extra")

from robustflow.media.tensor_file import LARGEST, RefusedError, load_tensors  # noqa: E402

pytestmark = pytest.mark.torch


def archive(pickled, names=("a/data.pkl", "a/version"), **options):
    """Return a file of PyTorch with entries of these names, the first of which is a pickle."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", **options) as out:
        for name, body in zip(names, (pickled, b"3\n"), strict=False):
            out.writestr(name, body)
    return file.getvalue()


def content():
    """Return what training scripts store with the weights."""
    net = torch.nn.Sequential(torch.nn.Conv2d(3, 8, 3), torch.nn.BatchNorm2d(8))
    optimiser = torch.optim.AdamW(net.parameters())
    net(torch.rand(1, 3, 8, 8)).sum().backward()
    optimiser.step()
    transposed, kinds = torch.arange(6.0).view(2, 3).t(), [getattr(torch, name) for name in KINDS]
    return {
        "state_dict": net.state_dict(), "named": dict(net.named_parameters()), "optimiser": optimiser.state_dict(),
        "schedule": torch.optim.lr_scheduler.MultiStepLR(optimiser, [3, 5]).state_dict(),
        "views": [transposed, transposed[1:], torch.zeros(0, 3), torch.ones(())],
        "kinds": [torch.ones(3).to(kind)[1:] for kind in kinds],
        "numbers": [1.5, None, True, 2**40, -3, "x", (1, 2), torch.float16, torch.Size([2, 3])],
    }  # fmt: skip


KINDS = ("int8", "uint8", "bool", "int16", "int32", "int64", "float16", "bfloat16", "float64", "complex64")


def same(ours, theirs):
    if isinstance(theirs, torch.Tensor):
        assert (ours.dtype, ours.shape, ours.stride()) == (theirs.dtype, theirs.shape, theirs.stride())
        assert torch.equal(ours, theirs)
    elif isinstance(theirs, dict):
        assert [*ours] == [*theirs]
        assert getattr(ours, "_metadata", None) == getattr(theirs, "_metadata", None)
        same([*ours.values()], [*theirs.values()])
    elif isinstance(theirs, list | tuple):
        assert len(ours) == len(theirs)
        for our, their in zip(ours, theirs, strict=True):
            same(our, their)
    else:
        assert ours == theirs


@pytest.mark.parametrize("zipped", [True, False])
def test_a_file_gives_what_pytorch_reads(zipped):
    stored, file = content(), io.BytesIO()
    torch.save(stored, file, _use_new_zipfile_serialization=zipped)
    file.seek(0)
    same(load_tensors(file), torch.load(io.BytesIO(file.getvalue()), weights_only=True))


@pytest.mark.parametrize("zipped", [True, False])
def test_objects_of_training_scripts_are_read_as_nothing(zipped):
    file = io.BytesIO()
    stored = {"best": np.float64(3), "args": argparse.Namespace(a=1), "device": torch.device("cpu"), "a": torch.ones(2)}
    torch.save(stored, file, _use_new_zipfile_serialization=zipped)
    read = load_tensors(file)
    assert (read["best"], read["args"], read["device"], read["a"].tolist()) == (None, None, "cpu", [1, 1])


@pytest.mark.parametrize("zipped", [True, False])
def test_a_damaged_file_gives_an_error_or_tensors_of_the_size_of_the_file(zipped):
    file, draw, refused = io.BytesIO(), random.Random(0), 0
    torch.save({"weight": torch.ones(3), "bias": torch.zeros(2)}, file, _use_new_zipfile_serialization=zipped)
    for _ in range(1500):
        changed = bytearray(file.getvalue())
        changed[draw.randrange(len(changed))] ^= 1 << draw.randrange(8)
        if draw.random() < 0.2:
            del changed[draw.randrange(len(changed)) :]
        try:
            read = dict(load_tensors(io.BytesIO(changed)))
        except Exception:
            refused += 1
        else:
            tensors = [value for value in read.values() if isinstance(value, torch.Tensor)]
            assert sum(tensor.nbytes for tensor in tensors) <= len(changed)
    assert refused > 200


class Built:
    """An OrderedDict whose pickle gives it attributes."""

    def __init__(self, attributes):
        self.attributes = attributes

    def __reduce__(self):
        return collections.OrderedDict, (), self.attributes


def test_attributes_never_replace_methods():
    for attributes in ({"items": 5}, {"__class__": 5}, {1: 2}, [1, 2]):
        read = load_tensors(io.BytesIO(archive(pickle.dumps(Built(attributes), 2))))
        assert (type(read), vars(read), [*read.items()]) == (collections.OrderedDict, {}, [])


LONG = [b"\x8a\x09" + (number * (2**61 - 1)).to_bytes(9, "little") for number in range(1, 200)]
STORAGE = b"(X\7\0\0\0storagectorch\nFloatStorage\nX\1\0\0\0%cX\3\0\0\0cpuJ%btQ"
DICT = b"".join(b"X\3\0\0\0%03dN" % number for number in range(200))
ORDERED = b"ccollections\nOrderedDict\n"
MEMO = [(f"q{chr(i)}".encode(), f"h{chr(i)}".encode()) for i in range(60)]
REFUSED = {
    "bytearray of 1 GB": b"\x80\x02c__builtin__\nbytearray\n\x8a\x04" + (10**9).to_bytes(4, "little") + b"\x85R.",
    "nested lists, 2^60 parts": b"\x80\x02(]" + b"".join(put + b"](" + get + get + b"e" for put, get in MEMO) + b"t.",
    "hash of 2^60 parts": b"\x80\x02}K\0" + b"".join(put + get + b"\x86" for put, get in MEMO) + b"K\x01s.",
    "a hundred thousand levels": b"\x80\x02" + b"]" * 10**5 + b"a" * (10**5 - 1) + b".",
    "function in a call": b"cos\nsystem\n(X\2\0\0\0lstR.",
    "attributes of a list": b"\x80\x02]}X\1\0\0\0aK\1sbK\1K\2s.",
    "integers with equal hashes": b"\x80\x02}(" + b"N".join(LONG) + b"Nu.",
    "pairs with equal hashes": ORDERED + b"](" + b"".join(b"](" + n + b"Ne" for n in LONG) + b"e\x85R.",
    "pairs that are texts": ORDERED + b"](X\2\0\0\0abe\x85R.",
    "nested tuple as a key": b"\x80\x02})\x85N\x86K\1s.",
    "list in itself": b"\x80\x02]q\0h\0a.",
    "lists in lists": b"]" * 200 + b"a" * 199 + b".",
    "dict copied often": b"}(" + DICT + b"uq\0" + b"0".join([ORDERED + b"h\0\x85R"] * 20000) + b".",
    "pairs copied often": b"](" + b"](X\1\0\0\0aNe" * 5000 + b"eq\0(" + (ORDERED + b"h\0\x85R") * 600 + b"t.",
    "call with many arguments": b"ctorch\nSize\n(" + b"N" * 99 + b"tR.",
    "storages larger than the file": b"("
    + b"".join(STORAGE % (n, struct.pack("<i", 65)) for n in range(65, 90))
    + b"t.",
    "storage of a negative size": STORAGE % (65, struct.pack("<i", -9)) + b".",
    "tensor without values": b"ctorch._utils\n_rebuild_tensor\n(NK\0K\3\x85K\1\x85tR.",
}


@pytest.mark.parametrize("pickled", REFUSED.values(), ids=REFUSED)
def test_a_pickle_that_does_more_than_store_weights_is_refused(pickled):
    with pytest.raises(RefusedError):
        load_tensors(io.BytesIO(archive(pickled)))


def test_a_tensor_that_repeats_its_values_is_refused_if_it_is_larger_than_the_file():
    for count, refused in ((9, False), (10**6, True)):
        file = io.BytesIO()
        torch.save(torch.ones(1).expand(count), file)
        if refused:
            with pytest.raises(RefusedError):
                load_tensors(file)
        else:
            assert load_tensors(file).tolist() == [1] * count


UNSUITABLE = {
    "compressed": archive(pickle.dumps({"a": 1}, 2), compression=zipfile.ZIP_DEFLATED),
    "no pickle": archive(b"", ("a/data.pk", "a/version")),
    "pickle in a second folder": archive(pickle.dumps({}, 2), ("b/version", "a/data.pkl")),
    "TorchScript": archive(pickle.dumps({}, 2), ("a/data.pkl", "a/constants.pkl")),
    "big-endian": archive(pickle.dumps({}, 2), ("a/data.pkl", "a/byteorder")),
    "empty": b"PK\5\6" + bytes(18),
    "pickle of 3 MiB": archive(b"N" * 3 * 2**20),
    "five pickles of another program": b"".join(pickle.dumps(part, 2) for part in (1, 1001, {}, {"a": 1}, [])),
    "checksum": archive(pickle.dumps({"a": 1}, 2)).replace(b"K\1s", b"K\2s"),
    "encrypted": archive(pickle.dumps({"a": 1}, 2)).replace(b"PK\1\2\x14\3\x14\0\0", b"PK\1\2\x14\3\x14\0\1"),
}


@pytest.mark.parametrize("data", UNSUITABLE.values(), ids=UNSUITABLE)
def test_a_file_of_another_kind_is_refused(data):
    assert load_tensors(io.BytesIO(archive(pickle.dumps({"a": 1}, 2)))) == {"a": 1}
    with pytest.raises(Exception, match=r"."):
        load_tensors(io.BytesIO(data))


DENSE = {
    "None": b"N", "numbers": b"K\1", "marks": b"(", "texts": b"X\0\0\0\0", "numbered": b"q\0h\0", "lists": b"]",
    "lists, sparse": b"NNNN]", "tuples": b"NNNNN\x85", "appends": b"]" + b"K\1(e", "functions": b"ctorch\nSize\n",
    "long keys": b"X\0\0\1\0" + b"x" * 2**16 + b"q\0}(" + b"h\0N" * 2**17 + b"u", "calls": b"ctorch\nSize\n)\x85R",
    "storages": STORAGE % (65, struct.pack("<i", 65)), "shared lists": b"](" + b"h\0" * 1000 + b"eq\0",
}  # fmt: skip


@pytest.mark.parametrize("unit", DENSE.values(), ids=DENSE)
def test_a_pickle_takes_seconds_and_a_multiple_of_its_size(unit):
    pickled = b"\x80\x02]q\0" + unit * (LARGEST // len(unit) - 9)
    start = time.process_time()
    with suppress(RefusedError, ValueError, KeyError):
        load_tensors(io.BytesIO(archive(pickled + b".")))
    assert time.process_time() - start < 5
    tracemalloc.start()
    with suppress(RefusedError, ValueError, KeyError):
        load_tensors(io.BytesIO(archive(pickled[: 2**16])))
    memory = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert memory < 60 * 2**16


def test_a_safetensors_file_of_many_empty_tensors_is_refused():
    entry = {"dtype": "F32", "shape": [0], "data_offsets": [0, 0]}
    for count, refused in ((2000, False), (200_000, True)):
        header = json.dumps({str(number): entry for number in range(count)}).encode()
        file = io.BytesIO(struct.pack("<Q", len(header)) + header)
        if refused:
            with pytest.raises(RefusedError):
                load_tensors(file)
        else:
            assert len(load_tensors(file)) == count


def test_only_one_place_loads_files_of_tensors():
    calls = re.compile(r"torch\.load\(|torch\.jit\.load\(|safetensors\.torch\.load")
    sources = Path(robustflow.__file__).parent.rglob("*.py")
    assert [path.name for path in sources if calls.search(path.read_text(encoding="utf-8"))] == ["tensor_file.py"]
