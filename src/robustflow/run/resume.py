"""Start or continue a run: the existing manifest, updated with the request, if model, settings and data are the same.

The settings have to be equal, and so do the files of the data, by their digests. That does not cover everything: for a
user's model, the identity includes the source file, but no imported modules or other files, and some datasets have no
files. So one clean row is measured again. Frames and ground truth are always compared; the prediction is compared
unless the model is identified by a hash of its content. All other samples are compared in the same way when their units
continue (see `Computation.open`).
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import polars as pl

from ..core.errors import RunError
from ..corruptions.stack import needs_depth
from ..data.benchmarks.facts import moving_name
from ..data.datasets.base import OWN_FRAMES, Depths, FromClips, PreCorrupted
from ..metrics.rows import CLEAN
from ..models.provenance import UNDECLARED
from .cells import merged_levels, union
from .data_files import check_listed, file_digests, files_of_sample
from .identity import difference, environment
from .manifest import Manifest
from .plan import Plan, Unit
from .store import RunFolder
from .trust import COMPARED, check_same
from .worker import Job, NoMotion, temporary_worker

_HASH = re.compile(r"[0-9a-f]{64}")
_ELSEWHERE = "choose another folder with --output"


def open_manifest(folder: RunFolder, plan: Plan) -> Manifest:
    """Return the folder's manifest, updated with a plan; raise a RunError if they do not match."""
    identity = plan.identity()
    old = folder.manifest()
    if old and old.identity != identity:
        if not folder.rows().is_empty():
            differing = difference(identity, old.identity)
            raise RunError(folder.path, f"contains a different run; it differs in: {differing}; {_ELSEWHERE}")
        old = None
    if old is None:
        old = Manifest(
            version=6,
            identity=identity,
            identity_digest=identity.digest(),
            samples={},
            training=plan.training,
            planned=(),
            started=now(),
            finished=None,
            environment=environment(),
        )
    paths = _files(plan, [*plan.benchmark.keys, *_samples_to_recognise(folder, plan, old)], _depths_read(plan, old))
    digests = file_digests(paths)
    _compare_with_list(plan, {path: digests[key][i] for key in paths for i, path in enumerate(paths[key])})
    samples = {
        key: tuple((path.name, digest) for path, digest in zip(paths[key], digests[key], strict=True)) for key in paths
    }
    known = {key: files for key, files in old.samples.items() if key in samples}
    # a run that did not read depth knows fewer files of a sample
    if changed := [key for key, files in known.items() if files != samples[key][: len(files)]]:
        more = f" and of {len(changed) - 1} more" if len(changed) > 1 else ""
        raise RunError(folder.path, f"was made from different files of sample '{changed[0]}'{more}; {_ELSEWHERE}")
    return old.model_copy(
        update={
            "samples": old.samples | samples,
            "training": old.training if plan.training == UNDECLARED else plan.training,
            "planned": union((*old.planned, plan.cells())),
            "left_out": merged_levels(old.left_out, plan.left_out()),
            "name": plan.name or old.name,
            "finished": None,
            "environment": environment(),
        }
    )


def _samples_to_recognise(folder: RunFolder, plan: Plan, old: Manifest) -> list[str]:
    """Return the samples of a run that are not in the plan, if the data can be recognised only by their files, because
    the frames of all clips have the same names.
    """
    if moving_name(plan.benchmark.name) != OWN_FRAMES:
        return []
    known = set(plan.benchmark.dataset.keys())
    if absent := [key for key in old.samples if key not in known]:
        raise RunError(folder.path, f"was made from different frames that include a sample '{absent[0]}'; {_ELSEWHERE}")
    return [key for key in old.samples if key not in plan.benchmark.keys]


def _compare_with_list(plan: Plan, digests: dict[Path, str]) -> None:
    """Compare the files that a run reads, including corrupted frames, with the list of digests beside them."""
    dataset = plan.benchmark.dataset
    if not isinstance(dataset, PreCorrupted) or isinstance(dataset, FromClips):
        check_listed(digests)
        return
    units = (unit for unit in plan.units() if dataset.has_corrupted(unit.corruption))
    check_listed(digests, (path for unit in units for cell in unit.cells for path in dataset.corrupted_files(*cell)))


def changed_files(plan: Plan, manifest: Manifest, keys: Iterable[str]) -> dict[str, Path]:
    """Return, for each sample, the first file that has changed since the manifest was written."""
    every = _files(plan, keys, _depths_read(plan, manifest))
    files = {key: paths[: len(manifest.samples[key])] for key, paths in every.items()}
    changed = {}
    for key, digests in file_digests(files).items():
        pairs = zip(files[key], digests, manifest.samples[key], strict=True)
        if paths := [path for path, digest, (_, before) in pairs if digest != before]:
            changed[key] = paths[0]
    return changed


def _files(plan: Plan, keys: Iterable[str], depths: Depths | None) -> dict[str, list[Path]]:
    return {key: files_of_sample(plan.benchmark.dataset, key, plan.options.window, depths) for key in keys}


def _depths_read(plan: Plan, manifest: Manifest | None = None) -> Depths | None:
    """Return the source of the depth that a plan, or the run that it continues, reads; None if neither reads depth."""
    earlier = manifest.corruptions if manifest is not None else ()
    return plan.benchmark.depths if any(map(needs_depth, (*earlier, *plan.benchmark.corruptions))) else None


def check_before_resuming(folder: RunFolder, job: Job, plan: Plan) -> None:
    """Measure one clean row of a run again and compare it; do nothing if there is no row yet."""
    stored = stored_clean_rows(folder, plan.benchmark.keys)
    if not stored:
        return
    before = stored[min(stored)]
    only_data = job.options.window is None and is_named_by_content(plan.model_identity)
    model = NoMotion() if only_data else job.load_model()
    alone = job.options.measuring.model_copy(update={"confidence": None})
    options = replace(job.options, measuring=alone) if only_data else job.options
    with temporary_worker(job.dataset, model, options) as worker:
        (now,) = worker.run(Unit(before["sample"], CLEAN, (0,)))
    check_same(before, now, model=not only_data)


def stored_clean_rows(folder: RunFolder, keys: Iterable[str]) -> dict[str, dict[str, Any]]:
    """Return the clean rows that a run already has for these samples, by sample and with only the compared columns."""
    samples = list(keys)
    if not samples:
        return {}
    rows = folder.rows(("sample", "corruption", "severity", *COMPARED), CLEAN).filter(pl.col("sample").is_in(samples))
    return {row["sample"]: row for row in rows.iter_rows(named=True)}


def is_named_by_content(identity: dict[str, Any]) -> bool:
    """Return whether a model is identified by the SHA-256 of its weights or files, and has no user code."""
    users = "source" in identity or "object" in identity
    return not users and any(isinstance(value, str) and _HASH.fullmatch(value) for value in identity.values())


def now() -> str:
    """Return the time in UTC, to the second."""
    return datetime.now(UTC).isoformat(timespec="seconds")
