"""Edit the rows and manifest of a run as someone who knows the format could, so that all digests remain valid."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import polars as pl

from robustflow.core.files import digest_of_value, sealed
from robustflow.run.store import list_shards, read_shard, shard_name, write_shard

Edit = Callable[[pl.DataFrame], pl.DataFrame]


def edit_rows(run: Path, edit: Edit) -> None:
    """Rewrite every shard of a run with edited rows."""
    for path in list_shards(run / "rows"):
        rows = edit(read_shard(path))
        path.unlink()
        write_shard(path.parent, shard_name(path), rows)


def edit_manifest(run: Path, edit: Callable[[dict[str, Any]], Any]) -> None:
    """Rewrite the manifest of a run after an edit."""
    path = run / "manifest.json"
    edited = edit(json.loads(path.read_text()))
    path.write_text(json.dumps(fitting(edited)))


def fitting(manifest: Any) -> Any:
    """A manifest of any shape, with matching digests."""
    if not isinstance(manifest, dict):
        return manifest
    if isinstance(manifest.get("identity_digest"), str) and isinstance(manifest.get("identity"), dict):
        manifest = {**manifest, "identity_digest": digest_of_value(manifest["identity"])}
    return sealed(manifest)
