"""Forge records: change any entry."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import reduce
from operator import getitem
from typing import Any

import polars as pl

from robustflow.core.files import json_bytes
from robustflow.core.files import sealed as with_digest
from robustflow.run.records.format import container_bytes, read_container, rows_from_text, rows_to_text
from robustflow.run.records.read import Reader
from robustflow.run.records.verify import Verification, verify_read

Edit = Callable[[dict], object]


def entries_of(data: bytes) -> dict[str, bytes]:
    return read_container(data, "test")


def with_json(data: bytes, name: str, edit: Edit) -> bytes:
    """Edit a JSON entry in place."""
    entries = entries_of(data)
    value = json.loads(entries[name])
    edit(value)
    value = with_digest(value) if name == "manifest.json" else value
    return container_bytes(entries | {name: json_bytes(value)})


def with_rows(data: bytes, edit: Callable[[pl.DataFrame], pl.DataFrame]) -> bytes:
    """Edit the rows."""
    entries = entries_of(data)
    return container_bytes(entries | {"rows.csv": rows_to_text(edit(rows_from_text(entries["rows.csv"])))})


def put(*path: str | int, value: object) -> Edit:
    """Make an edit that sets the value at a path in a JSON document."""

    def edit(document: Any) -> None:
        reduce(getitem, path[:-1], document)[path[-1]] = value

    return edit


def at(condition: pl.Expr, **values: pl.Expr) -> Callable[[pl.DataFrame], pl.DataFrame]:
    """Make an edit that changes columns of the rows that satisfy a condition."""
    return lambda rows: rows.with_columns(
        pl.when(condition).then(value).otherwise(pl.col(name)).alias(name) for name, value in values.items()
    )


def verified(data: bytes) -> Verification:
    return verify_read(Reader(data, "test.robustflow"))


def failure(data: bytes | Verification) -> tuple[str, str]:
    """Return the first check that fails and its message, which must be a single printable line."""
    found = verified(data) if isinstance(data, bytes) else data
    assert not found.ok
    check = next(check for check in found.checks if check.status == "failed")
    for one in found.checks:
        assert one.message.isprintable() or "\ufffd" in one.message
        assert "\x1b" not in one.message
        assert "\n" not in one.message
        assert len(one.message) <= 600
    return check.name, check.message


def assert_fails(data: bytes, check: str) -> None:
    """Assert that the given check is the first to fail."""
    name, message = failure(data)
    assert name == check, message
