"""Run folders of imaginary models, with all files that `run` writes: manifest, row shards and summary."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import polars as pl

from robustflow.api import evaluate
from robustflow.core.arguments import SEVERITIES
from robustflow.corruptions.registry import IMAGE_PAIR
from robustflow.metrics.rows import ROW_SCHEMA
from robustflow.models.provenance import Training
from robustflow.run.identity import ModelIdentity
from robustflow.run.manifest import Cells, Manifest
from robustflow.run.plan import Unit
from robustflow.run.run import Run
from robustflow.run.store import RunFolder
from robustflow.stats.results import CLEAN

_SCALED = [name for name in ROW_SCHEMA if name.startswith(("epe_sum", "rcre_sum"))]


def synthetic_runs(folder: Path, count: int, pairs: int) -> list[Path]:
    """Write `count` run folders for the same `pairs` pairs, with every image-pair corruption at every severity.

    The errors are those of DIS on the embedded pair, multiplied by factors for the pair, the model, the corruption and
    the severity, so that every model has different errors.
    """
    first = evaluate("dis", "demo", output=folder / "template", corruptions=["contrast"], severities=[1])
    keys = [f"{index:06d}" for index in range(pairs)]
    (files,) = first.manifest.samples.values()
    manifest = first.manifest.model_copy(
        update={
            "samples": dict.fromkeys(keys, files),
            "planned": (Cells(samples=tuple(keys), corruptions=dict.fromkeys(IMAGE_PAIR, SEVERITIES)),),
        }
    )
    cells = [(CLEAN, 0), *((name, severity) for name in IMAGE_PAIR for severity in SEVERITIES)]
    shared = _rows(first.rows, keys, cells)
    hard = np.random.default_rng(0).lognormal(0, 0.5, pairs).repeat(len(cells))
    severities = shared["severity"].to_numpy()
    paths = []
    for index in range(count):
        rng = np.random.default_rng(1 + index)
        grows = np.tile(rng.uniform(0.05, 0.4, len(cells)), pairs) * severities
        factor = hard * rng.lognormal(0, 0.1, len(hard)) * (1 + 0.01 * index) * (1 + grows)
        rows = shared.with_columns(pl.col(name) * pl.Series(factor) for name in _SCALED)
        paths.append(_write(folder / f"run-{index:04d}", manifest, rows, index, keys[0]))
    return paths


def _rows(template: pl.DataFrame, keys: list[str], cells: list[tuple[str, int]]) -> pl.DataFrame:
    (row,) = template.filter(pl.col("corruption") != CLEAN).head(1).to_dicts()
    rows = [
        row
        | {"sample": key, "group": key, "corruption": name, "severity": level}
        | {"frames_digest": f"{key}{name}{level}"}
        for key in keys
        for name, level in cells
    ]
    return pl.DataFrame(rows, schema=ROW_SCHEMA)


def _write(path: Path, manifest: Manifest, rows: pl.DataFrame, index: int, key: str) -> Path:
    identity = manifest.identity.model_copy(
        update={
            "frames": manifest.identity.frames.model_copy(update={"benchmark": "kitti-fc"}),
            "model": ModelIdentity(settings={"name": f"model-{index:04d}"}),
        }
    )
    sets = (("flyingchairs",), ("kitti2015:train",), None)[index % 3]
    own = manifest.model_copy(
        update={
            "identity": identity,
            "identity_digest": identity.digest(),
            "training": Training(sets=sets, basis="declared"),
        }
    )
    folder = RunFolder(path)
    folder.lock()
    folder.write_manifest(own)
    folder.write_rows(Unit(key, "all", SEVERITIES), rows.to_dicts())
    folder.unlock()
    Run(path).write_means()
    return path
