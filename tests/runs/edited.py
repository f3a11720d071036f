"""Change rows and manifest of a run as somebody who knows the format would, with the right digests."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import polars as pl

from robustflow.digest import digest_of_value
from robustflow.runs.manifest import manifest_file
from robustflow.runs.shards import list_shards, read_shard, shard_name, write_shard

Edit = Callable[[pl.DataFrame], pl.DataFrame]


def edit_rows(run: Path, edit: Edit) -> None:
    """Write every shard of a run again with its rows edited."""
    for path in list_shards(run / "rows"):
        rows = edit(read_shard(path))
        path.unlink()
        write_shard(path.parent, shard_name(path), rows)


def edit_manifest(run: Path, edit: Callable[[dict[str, Any]], Any]) -> None:
    """Write the manifest of a run again, edited."""
    path = run / "manifest.json"
    edited = edit(json.loads(path.read_text()))
    path.write_text(json.dumps(fitting(edited)))


def fitting(manifest: Any) -> Any:
    """A manifest, whatever its shape, with digests that fit."""
    if not isinstance(manifest, dict):
        return manifest
    if isinstance(manifest.get("identity_digest"), str) and isinstance(manifest.get("identity"), dict):
        manifest = {**manifest, "identity_digest": digest_of_value(manifest["identity"])}
    return manifest_file(manifest)
