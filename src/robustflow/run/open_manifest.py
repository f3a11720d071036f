"""Open the manifest of a new or continued run: the existing manifest, updated with the request."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from datetime import UTC, datetime
from pathlib import Path

from ..core.errors import RunError
from ..corruptions.stack import needs_depth
from ..data.benchmarks.facts import moving_name
from ..data.datasets.base import Depths, FromClips, PreCorrupted
from ..data.datasets.folder import OWN_FRAMES
from .cells import merged_levels, union
from .file_digests import check_listed, file_digests, is_under_a_list
from .identity import Identity, environment
from .manifest import Manifest, files_of_sample
from .plan import Plan
from .store import RunFolder


def open_manifest(folder: RunFolder, plan: Plan) -> Manifest:
    """Return the folder's manifest, updated with a plan; raise a RunError if they do not match."""
    identity = plan.identity()
    old = folder.manifest()
    if old and old.identity != identity and folder.rows().is_empty():
        old = None
    if old is None:
        old = _empty_manifest(plan, identity)
    elif old.identity != identity:
        raise RunError(
            f"{folder.path} contains a different run ({identity.difference(old.identity)}); "
            "choose another folder with --output"
        )
    depths = _depths_read(plan, old)
    files = {key: _files(plan, key, depths) for key in (*plan.benchmark.keys, *_unplanned_samples(folder, plan, old))}
    samples = {key: tuple((name, stat.st_size) for name, stat in _stats(paths)) for key, paths in files.items()}
    digests = {key: tuple(each) for key, each in file_digests(files).items()}
    _compare_with_list(plan, files, digests)
    without = {key: len(_files(plan, key, None)) for key in files}
    changed = sorted(
        key
        for key in samples
        if old.samples.get(key, samples[key]) not in (samples[key], samples[key][: without[key]])
        or old.file_digests.get(key, digests[key]) not in (digests[key], digests[key][: without[key]])
    )
    if changed:
        raise RunError(
            f"{folder.path} was made from different files for sample '{changed[0]}' ({len(changed)} differ); "
            "choose another folder with --output"
        )
    return old.model_copy(
        update={
            "samples": old.samples | samples,
            "file_digests": old.file_digests | digests,
            "provenance": old.provenance if plan.provenance.basis == "undeclared" else plan.provenance,
            "planned": union((*old.planned, plan.cells())),
            "left_out": merged_levels(old.left_out, plan.left_out()),
            "name": plan.name or old.name,
            "finished": None,
            "environment": environment(),
        }
    ).judged()


def _empty_manifest(plan: Plan, identity: Identity) -> Manifest:
    """Return the manifest of a run without samples."""
    return Manifest(
        identity=identity,
        identity_digest=identity.digest(),
        samples={},
        provenance=plan.provenance,
        planned=(),
        started=now(),
        finished=None,
        environment=environment(),
    )


def _unplanned_samples(folder: RunFolder, plan: Plan, old: Manifest) -> list[str]:
    """Return the samples of a run that are not in the plan, if the data can be recognised only by their files, because
    the frames of all clips have the same names.
    """
    if moving_name(plan.benchmark.name) != OWN_FRAMES:
        return []
    known = set(plan.benchmark.dataset.keys())
    for key in old.samples:
        if key not in known:
            raise RunError(
                f"{folder.path} was made from different frames that include a sample '{key}'; choose another "
                "folder with --output"
            )
    return [key for key in old.samples if key not in plan.benchmark.keys]


def _compare_with_list(plan: Plan, files: dict[str, list[Path]], digests: dict[str, tuple[str, ...]]) -> None:
    """Compare the files that a run reads, including corrupted frames, with the list of digests next to its data, if
    available."""
    known: dict[Path, str | None] = {}
    for key, paths in files.items():
        known |= zip(paths, digests[key], strict=True)
    if not any(map(is_under_a_list, {path.parent for path in known})):
        return
    dataset = plan.benchmark.dataset
    if isinstance(dataset, PreCorrupted) and not isinstance(dataset, FromClips):
        for unit in plan.units():
            if dataset.has_corrupted(unit.corruption):
                for cell in unit.cells:
                    known = dict.fromkeys(dataset.corrupted_files(*cell)) | known
    check_listed(known)


def changed_files(plan: Plan, manifest: Manifest, keys: Iterable[str]) -> dict[str, Path]:
    """Return, for each sample, the first file that has changed since the manifest was written."""
    depths = _depths_read(plan, manifest)
    files = {key: _files(plan, key, depths)[: len(manifest.file_digests[key])] for key in keys}
    before, now = manifest.file_digests, file_digests(files)
    each = {key: zip(files[key], before[key], now[key], strict=True) for key in files}
    changed = {key: [path for path, then, today in of_key if then != today] for key, of_key in each.items()}
    return {key: paths[0] for key, paths in changed.items() if paths}


def last_changed(plan: Plan, keys: Iterable[str]) -> str:
    """Return the sample with the most recently changed files, by the file system's change time, which cannot be
    copied along with a file, unlike its modification time."""
    return max(
        keys,
        key=lambda key: max((stat.st_ctime_ns for _, stat in _stats(_files(plan, key, _depths_read(plan)))), default=0),
    )


def _files(plan: Plan, key: str, depths: Depths | None) -> list[Path]:
    return files_of_sample(plan.benchmark.dataset, key, plan.options.window, depths)


def _depths_read(plan: Plan, manifest: Manifest | None = None) -> Depths | None:
    """Return the source of the depth that a plan, or the run that it continues, reads; None if neither reads depth."""
    earlier = manifest.corruptions if manifest is not None else ()
    return plan.benchmark.depths if any(map(needs_depth, (*earlier, *plan.benchmark.corruptions))) else None


def _stats(files: Sequence[Path]) -> list[tuple[str, os.stat_result]]:
    try:
        return [(path.name, path.stat()) for path in files]
    except OSError as error:
        raise RunError(f"cannot read {error.filename}: {error.strerror}") from error


def now() -> str:
    """Return the time in UTC, to the second."""
    return datetime.now(UTC).isoformat(timespec="seconds")
