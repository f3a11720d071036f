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


@pytest.mark.filterwarnings("ignore:Duplicate name")
@pytest.mark.parametrize(
    "name",
    [
        "../evil.json",
        "/etc/passwd",
        "C:\\evil.json",
        "rows.csv/../../evil",
        "sub/rows.csv",
        "rows.csv\0.txt",
        "\x1b[2J\x1b[31mred",
        "a" * 10_000,
        "inner.zip",
        "RECORD.JSON",
    ],
)
def test_any_other_name_is_refused(packed, name):
    entries = list(entries_of(packed).items())
    for data in (_zip([*entries, (name, b"x")]), _zip([(name, b"x"), *entries]), _zip([(name, entries[0][1])])):
        _refused(data)


@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_repeated_missing_or_compressed_entry_is_refused(packed):
    """A zip bomb is refused because it is compressed, whatever sizes it claims."""
    entries = list(entries_of(packed).items())
    bomb = _zip(list((dict(entries) | {"rows.csv": b"0" * 50_000_000}).items()), zipfile.ZIP_DEFLATED)
    assert len(bomb) < 100_000
    missing = (_zip(entries[:index] + entries[index + 1 :]) for index in range(len(entries)))
    for data in (bomb, _zip([*entries, entries[1]]), _zip([]), *missing):
        _refused(data)


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


@pytest.mark.parametrize(
    ("field", "value"),
    [("external_attr", mode << 16) for mode in (0o120777, 0o040755, 0o100755, 0o010644)]
    + [("comment", b"\x01\x00\x00\x00"), ("extra", b"\x01\x00\x00\x00")],
    ids=["a link", "a folder", "a program", "a pipe", "a comment", "an extra field"],
)
def test_an_entry_that_is_not_plain_is_refused(packed, field, value):
    entries = list(entries_of(packed).items())
    assert _zip(entries) == packed
    _refused(_zip(entries, **{field: value}))


def test_extra_bytes_around_or_between_entries_are_refused(packed):
    _refused(packed + b"x" * 10)
    _refused(b"#!/bin/sh\n" + packed)
    commented = io.BytesIO(packed)
    with zipfile.ZipFile(commented, "a") as file:
        file.comment = b"hidden"
    _refused(commented.getvalue())


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


@settings(max_examples=40)
@given(st.data())
def test_truncated_record_is_refused(packed, data):
    _refused(packed[: data.draw(st.integers(0, len(packed) - 1))])


@settings(max_examples=50)
@given(st.binary(max_size=400), st.integers(0, 2**32))
def test_random_bytes_are_refused_with_a_message(packed, garbage, place):
    place %= len(packed)
    for data in (garbage, packed[:place] + garbage, packed[:place] + garbage + packed[place + len(garbage) :]):
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
