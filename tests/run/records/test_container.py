"""Zip files that are not valid records are refused before their contents are read."""

from __future__ import annotations

import io
import os
import struct
import zipfile

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robustflow.core.errors import DataError
from robustflow.run.records.format import LIMITS, container_bytes, read_container, read_file

from ...refusals import refusal
from .forge import assert_fails, entries_of


def _zip(entries: list[tuple[str, bytes]], compress: int = zipfile.ZIP_STORED, **of_rows: object) -> bytes:
    """Write a zip file as records are written, apart from the given header fields of `rows.csv`."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", compress) as file:
        for name, data in entries:
            info = zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0))
            info.create_system, info.external_attr, info.compress_type = 3, 0o100644 << 16, compress
            for field, value in of_rows.items() if name == "rows.csv" else ():
                setattr(info, field, value)
            file.writestr(info, data)
    return out.getvalue()


def _refused(data: bytes) -> None:
    refusal(lambda: read_container(data, "x.robustflow"), DataError, "x.robustflow")
    assert_fails(data, "container")


def test_the_same_entries_are_the_same_bytes(packed):
    entries = entries_of(packed)
    assert container_bytes(dict(reversed(entries.items()))) == packed
    assert zipfile.ZipFile(io.BytesIO(packed)).testzip() is None


def _comment(packed: bytes) -> bytes:
    commented = io.BytesIO(packed)
    with zipfile.ZipFile(commented, "a") as file:
        file.comment = b"hidden"
    return commented.getvalue()


NAMES = ("../evil.json", "/etc/passwd", "rows.csv\0.txt", "\x1b[31mred", "a" * 10_000, "inner.zip", "RECORD.JSON")
NOT_WRITTEN = {
    **{f"named {name[:20]}": lambda entries, name=name: _zip([*entries, (name, b"x")]) for name in NAMES},
    "renamed": lambda entries: _zip([("other.json", entries[0][1]), *entries[1:]]),
    "repeated": lambda entries: _zip([*entries, entries[1]]),
    "missing": lambda entries: _zip(entries[:1] + entries[2:]),
    "none": lambda entries: _zip([]),
    "a zip bomb": lambda entries: _zip([*entries[:2], ("rows.csv", b"0" * 50_000_000)], zipfile.ZIP_DEFLATED),
    "a link": lambda entries: _zip(entries, external_attr=0o120777 << 16),
    "a program": lambda entries: _zip(entries, external_attr=0o100755 << 16),
    "a comment of an entry": lambda entries: _zip(entries, comment=b"\x01\x00\x00\x00"),
    "an extra field": lambda entries: _zip(entries, extra=b"\x01\x00\x00\x00"),
    "bytes behind": lambda entries: _zip(entries) + b"x" * 10,
    "bytes before": lambda entries: b"#!/bin/sh\n" + _zip(entries),
    "a comment": lambda entries: _comment(_zip(entries)),
}
"""Files with the entries of a record that `record pack` does not write."""


@pytest.mark.filterwarnings("ignore:Duplicate name")
@pytest.mark.parametrize("change", NOT_WRITTEN.values(), ids=NOT_WRITTEN)
def test_file_that_pack_does_not_write_is_refused(packed, change):
    entries = list(entries_of(packed).items())
    assert _zip(entries) == packed
    _refused(change(entries))


def test_entry_that_claims_terabytes_is_refused_unread(packed):
    """The central directory claims 16 TB (in a zip64 field) or 4 GB for an entry of the small file."""
    at = packed.rindex(b"PK\x01\x02")
    claimed = bytearray(packed)
    claimed[at + 20 : at + 28] = struct.pack("<II", 0xFFFFFFFE, 0xFFFFFFFE)
    _refused(bytes(claimed))
    huge = io.BytesIO()
    info = zipfile.ZipInfo("rows.csv")
    with zipfile.ZipFile(huge, "w") as file:
        for name, data in entries_of(packed).items():
            file.writestr(name if name != "rows.csv" else info, data)
        info.file_size = info.compress_size = 1 << 44
    _refused(huge.getvalue())


def test_flipped_bit_anywhere_is_refused(packed):
    """Flip every bit of the headers, and bits throughout the data: each run has exactly one valid file, so none of the
    changed files verifies.
    """
    headers = [packed.index(b"PK\x01\x02") + offset for offset in range(46)] + list(range(30))
    flips = [(place, 1 << bit) for place in headers for bit in range(8)]
    flips += [(place, 1 << (place % 8)) for place in range(0, len(packed), 311)]
    for place, bit in flips:
        changed = bytearray(packed)
        changed[place] ^= bit
        refusal(lambda data=bytes(changed): read_container(data, "x.robustflow"), DataError, "x.robustflow")
    assert_fails(bytes(changed), "container")


@settings(max_examples=50)
@given(st.binary(max_size=400), st.integers(0, 2**32))
def test_random_bytes_are_refused_with_a_message(packed, garbage, place):
    place %= len(packed)
    pasted = packed[:place] + garbage
    for data in (garbage, packed[:place], pasted, pasted + packed[len(pasted) :]):
        if data != packed:
            assert_fails(data, "container")


def test_too_large_entries_and_files_are_refused(tmp_path):
    too_large = {"record.json": bytes(LIMITS["record.json"] + 1)}
    refusal(lambda: container_bytes(too_large), DataError, "record.json")
    with open(tmp_path / "sparse", "wb") as file:
        file.truncate(1 << 40)
    os.mkfifo(tmp_path / "pipe")
    for name in ("sparse", "pipe", "nowhere", ""):
        refusal(lambda path=tmp_path / name: read_file(path), DataError, tmp_path / name)
