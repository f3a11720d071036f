"""A file of tensors is checked as the bytes that PyTorch will load, at a cost that its size bounds."""

import collections
import io
import json
import pickle
import random
import re
import struct
import time
import tracemalloc
import zlib
from pathlib import Path

import pytest

import robustflow
from robustflow.core.pickle_opcodes import LARGEST, RefusedError, scan_pickle
from robustflow.core.pickle_scan import load_tensors, scan_torch_file

HARMLESS = pickle.dumps({"a": 1}, 2)
OTHER = pickle.dumps({"b": 2}, 2)


def archive(pickled, at=0, names=("a/data.pkl", "a/version"), lengths=None, change=lambda entry, place: entry):
    """Return stored entries and their directory, for position `at`; `change` edits the fields of both headers."""
    out, directory = b"", b""
    for name, body in zip(names, (pickled, b"3\n", b"?"), strict=False):
        size = lengths or len(body)
        entry = [0, 0, 0, 0x21, zlib.crc32(body), size, size, len(name), 0]
        local, central = change(list(entry), "local"), change(list(entry), "central")
        directory += struct.pack("<4sH5H3L5H2L", b"PK\1\2", 20, 20, *central, *[0] * 4, at + len(out)) + name.encode()
        out += struct.pack("<4sH4H3L2H", b"PK\3\4", 20, *local) + name.encode() + body
    return out, directory, len(names)


def end(count, length, begin, comment=b""):
    return struct.pack("<4s4H2LH", b"PK\5\6", 0, 0, count, count, length, begin, len(comment)) + comment


def end64(count, length, begin):
    return struct.pack("<4sQ2H2L4Q", b"PK\6\6", 44, 45, 45, 0, 0, count, count, length, begin)


def whole(pickled=HARMLESS, comment=b"", **options):
    out, directory, count = archive(pickled, **options)
    return out + directory + end(count, len(directory), len(out), comment)


def two_directories(saturated=False, records=2):
    """Python's zipfile reads the second directory, PyTorch the one at which the ZIP64 locator points."""
    out, directory, count = archive(OTHER)
    first = out + directory
    at = len(first)
    first += end64(count, len(directory), len(out))
    out, directory, count = archive(HARMLESS, len(first))
    fields = (count, len(directory), len(first) + len(out))
    second = end64(*fields) if records == 2 else b""
    locator = struct.pack("<4sLQL", b"PK\6\7", 0, at, 1)
    return first + out + directory + second + locator + end(*((0xFFFF, 2**32 - 1, 2**32 - 1) if saturated else fields))


def edited(place, index, value):
    def change(entry, where):
        entry[index] = value if where == place else entry[index]
        return entry

    return change


AMBIGUOUS = {
    "two directories": two_directories(),
    "two directories, saturated": two_directories(saturated=True),
    "locator without its record": two_directories(records=1),
    "comment with an archive": whole(comment=whole(OTHER)),
    "archive behind an archive": whole(OTHER) + whole(),
    "bytes before the end": (lambda data: data[:-22] + b"PK\5\6" * 6 + data[-22:])(whole()),
    "name twice": whole(names=("a/data.pkl", "a/data.pkl")),
    "name twice in another case": whole(names=("a/data.pkl", "A/DATA.PKL")),
    "other name in the directory": whole().replace(b"a/data.pkl", b"a/data.pk2", 1),
    "name with a zero byte": whole(names=("a/data.pkl", "a/data.pkl\0x")),
    "name of other characters": whole(names=("a/data.pkl", "a/\xe9")),
    "overlapping entries": whole(lengths=60),
    "other size in front of the entry": whole(change=edited("local", 5, 1)),
    "size of 4 GiB": whole(change=edited("central", 6, 2**32 - 1)),
    "compressed in the directory": whole(change=edited("central", 1, 8)),
    "compressed in front of the entry": whole(change=edited("local", 1, 8)),
    "checksum": whole(change=edited("central", 4, 5)),
    "encrypted": whole(change=lambda entry, place: [1, *entry[1:]]),
    "entry that is a folder": whole().replace(b"\0" * 10 + b"a/data.pkl", bytes([0, 0, 16, *[0] * 7]) + b"a/data.pkl"),
    "name of a folder": whole(names=("a/data.pkl", "a/version/")),
    "no pickle": whole(names=("a/data.pk", "a/version")),
    "pickle in a second folder": whole(names=("b/version", "a/data.pkl")),
    "empty": end(0, 0, 0),
}


@pytest.mark.parametrize("data", AMBIGUOUS.values(), ids=AMBIGUOUS)
def test_an_archive_that_programs_may_read_differently_is_refused(data):
    scan_torch_file(io.BytesIO(whole()))
    with pytest.raises((RefusedError, ValueError, KeyError, EOFError, struct.error)):
        scan_torch_file(io.BytesIO(data))


@pytest.mark.torch
def test_pytorch_reads_the_pickle_that_was_scanned(monkeypatch):
    torch = pytest.importorskip("torch", reason="needs the torch extra")
    file, scanned = io.BytesIO(), []
    torch.save({"weight": torch.ones(3), "bias": torch.zeros(2)}, file)
    monkeypatch.setattr("robustflow.core.pickle_scan.scan_pickle", lambda data, size: scanned.append(data) or 1)
    draw, accepted = random.Random(0), 0
    for data in (whole(), file.getvalue()):
        for _ in range(1500):
            changed = bytearray(data)
            at = draw.choice((draw.randrange(len(data)), len(data) - draw.randrange(1, 300)))
            changed[at] = draw.choice((changed[at] ^ 1 << draw.randrange(8), 0xFF, 0))
            try:
                scan_torch_file(io.BytesIO(changed))
            except (RefusedError, ValueError, EOFError, struct.error):
                continue
            if changed[:4] != b"PK\3\4":
                continue
            accepted += 1
            assert torch._C.PyTorchFileReader(io.BytesIO(changed)).get_record("data.pkl") == scanned[-1]
    assert accepted > 100


class Built:
    """An OrderedDict whose pickle gives it attributes."""

    def __init__(self, attributes):
        self.attributes = attributes

    def __reduce__(self):
        return collections.OrderedDict, (), self.attributes


LONG = [b"\x8a\x09" + (number * (2**61 - 1)).to_bytes(9, "little") for number in range(1, 200)]
STORAGE = b"(X\7\0\0\0storagectorch\nFloatStorage\nX\1\0\0\0%cX\3\0\0\0cpuK\x50tQ"
TEXT = b"X\xe7\3\0\0" + b"x" * 999 + b"q\0"
DICT = b"".join(b"X\3\0\0\0%03dN" % number for number in range(200))
MEMO = [(f"q{chr(i)}".encode(), f"h{chr(i)}".encode()) for i in range(60)]
REFUSED = {
    "methods of a dict": pickle.dumps(Built({"items": 5}), 2),
    "class of a dict": pickle.dumps(Built({"__class__": 5}), 2),
    "attributes named by numbers": pickle.dumps(Built({1: 2}), 2),
    "attributes in a list": pickle.dumps(Built([1, 2]), 2),
    "attributes of a list": b"\x80\x02]}X\1\0\0\0aK\1sb.",
    "integers with equal hashes": b"\x80\x02}(" + b"N".join(LONG) + b"Nu.",
    "pairs with equal hashes": b"ccollections\nOrderedDict\n]("
    + b"".join(b"](" + n + b"Ne" for n in LONG)
    + b"e\x85R.",
    "pairs that are texts": b"ccollections\nOrderedDict\n](X\2\0\0\0abe\x85R.",
    "nested tuple as a key": b"\x80\x02})\x85N\x86K\1s.",
    "list in itself": b"\x80\x02]q\0h\0a.",
    "texts copied often": TEXT + b"c_codecs\nencode\nq\1X\6\0\0\0latin1q\2" + b"h\1h\0h\2\x86R" * 99 + b".",
    "tuple copied often": b"(" + b"N" * 999 + b"t\x85q\0ctorch\nSize\nq\1" + b"h\1h\0R" * 99 + b".",
    "dict copied often": b"}(" + DICT + b"uq\0" + b"ccollections\nOrderedDict\n)Rh\0b" * 99 + b".",
    "call with many arguments": b"ctorch\nSize\n(" + b"N" * 99 + b"tR.",
    "object number far away": b"\x80\x02]r\xff\xff\xff\x7f.",
    "bytearray of 1 GB": b"\x80\x02c__builtin__\nbytearray\n\x8a\x04" + (10**9).to_bytes(4, "little") + b"\x85R.",
    "nested lists, 2^60 parts": b"\x80\x02(]" + b"".join(put + b"](" + get + get + b"e" for put, get in MEMO) + b"t.",
    "hash of 2^60 parts": b"\x80\x02}K\0" + b"".join(put + get + b"\x86" for put, get in MEMO) + b"K\x01s.",
    "a hundred thousand levels": b"\x80\x02" + b"]" * 10**5 + b"a" * (10**5 - 1) + b".",
    "storages larger than the file": b"(" + b"".join(STORAGE % number for number in range(65, 70)) + b"t.",
}


@pytest.mark.parametrize("pickled", REFUSED.values(), ids=REFUSED)
def test_a_pickle_that_does_more_than_store_weights_is_refused(pickled):
    for allowed in (pickle.dumps(Built({"_metadata": {}}), 2), b"(" + STORAGE % 65 * 9 + b"t."):
        assert scan_pickle(allowed, 400) == len(allowed)
    with pytest.raises(RefusedError):
        scan_pickle(pickled, 400)


DENSE = {
    "None": b"N",
    "empty tuples": b")",
    "marks": b"(",
    "numbers": b"K\1",
    "texts": b"X\0\0\0\0",
    "numbered": b"q\0h\0",
    "lists": b"]",
    "lists, sparse": b"NNNN]",
    "tuples": b"NNNNN\x85",
    "empty appends": b"]" + b"K\1(e",
    "long keys": b"X\0\0\1\0" + b"x" * 2**16 + b"q\0}(" + b"h\0N" * 2**17 + b"u",
    "functions": b"ctorch\nSize\n",
    "calls": b"ctorch\nSize\n)R",
    "storages": STORAGE % 65,
}


@pytest.mark.parametrize("unit", DENSE.values(), ids=DENSE)
def test_a_scan_takes_less_than_a_second_and_ten_times_the_size(unit):
    pickled = b"\x80\x02N" + unit * (2 * LARGEST // len(unit))
    start = time.process_time()
    for length in (LARGEST - 100, 2 * LARGEST):
        with pytest.raises((RefusedError, EOFError, ValueError)):
            scan_pickle(pickled[:length], 10**6)
    assert time.process_time() - start < 2
    tracemalloc.start()
    with pytest.raises((RefusedError, EOFError, ValueError)):
        scan_pickle(pickled[: 2**16], 10**6)
    memory = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert memory < 9 * 2**16  # the pickle itself is the tenth


@pytest.mark.torch
def test_a_safetensors_file_of_many_empty_tensors_is_refused():
    pytest.importorskip("torch", reason="needs the torch extra")
    entry = {"dtype": "F32", "shape": [0], "data_offsets": [0, 0]}
    for count, refused in ((2000, False), (200_000, True)):
        header = json.dumps({str(number): entry for number in range(count)}).encode()
        file = io.BytesIO(struct.pack("<Q", len(header)) + header)
        if refused:
            with pytest.raises(RefusedError):
                load_tensors(file)
        else:
            assert len(load_tensors(file)) == count


@pytest.mark.torch
@pytest.mark.parametrize("kind", ["tar", "torchscript", "tar that begins with pickles"])
def test_a_file_of_a_kind_that_runs_code_is_refused(tmp_path, kind):
    torch = pytest.importorskip("torch", reason="needs the torch extra")
    path = tmp_path / "x.pth"
    if kind == "torchscript":
        path.write_bytes(whole(names=("a/data.pkl", "a/constants.pkl")))
    else:
        pickles = [torch.serialization.MAGIC_NUMBER, torch.serialization.PROTOCOL_VERSION, {}, {"a": 1}, []]
        name = b"".join(pickle.dumps(part, 2) for part in pickles) if kind != "tar" else b"pickle"
        block = bytearray(name.ljust(148, b"\0") + b" " * 8 + b"0" + bytes(355))
        block[148:156] = b"%06o\0 " % sum(block)
        path.write_bytes(block + bytes(1024))
    with open(path, "rb") as file, pytest.raises(Exception, match=r"."):
        load_tensors(file)


def test_only_one_place_loads_files_of_tensors():
    calls = re.compile(r"torch\.load\(|torch\.jit\.load\(|safetensors\.torch\.load")
    sources = Path(robustflow.__file__).parent.rglob("*.py")
    assert [path.name for path in sources if calls.search(path.read_text(encoding="utf-8"))] == ["pickle_scan.py"]
