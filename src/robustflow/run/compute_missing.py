"""Start or continue a run: compare its folder with the plan, compute the units that it lacks, and write each one as
soon as it is finished.

To continue, the settings have to be equal, and so do the files of the data, by their digests. That does not cover
everything: for a user's model, the identity includes the source file, but no imported modules or other files, and some
datasets have no files. So one clean row is measured again before anything is written, and so is that of every other
sample when its units continue (`Computation.set_clean`).
"""

from __future__ import annotations

import time
import warnings
from collections import Counter, deque
from collections.abc import Iterable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import polars as pl

from ..core.errors import DataError, RunError
from ..corruptions.condition import condition_of
from ..data.benchmarks.facts import moving_name
from ..data.datasets.dataset import OWN_FRAMES, Depths, FromClips, PreCorrupted
from ..metrics.photometric import Misread, Reading
from ..metrics.rows import CLEAN
from ..models.protocols import FlowLookup
from ..models.provenance import UNDECLARED
from .computation import OF_TRUTH, FinishedUnit
from .data_files import check_listed, file_digests, files_of_sample
from .engines.base import Engine
from .identity import Environment, difference, environment, versions_in_words
from .manifest import Manifest, clips_of, merged_levels, union
from .plan import Plan
from .progress import Progress, TerminalProgress
from .store import RunFolder
from .trust import COMPARED
from .worker import temporary_worker

_ELSEWHERE = "choose another folder with --output"

_UNWRITTEN = 3
"""Maximum number of finished units whose rows are not on disk yet while the model continues."""


def compute_missing(folder: RunFolder, plan: Plan, engine: Engine, progress: Progress) -> None:
    """Compute and write the planned units that do not exist yet. Warn if the model's flow or the ground truth of the
    first pair is not (u right, v down) in pixels from frame 1 to frame 2."""
    before = folder.manifest()
    known = _known_row(folder, plan)
    here = _environment(plan)
    manifest = _continued(folder, plan, before, known, here)
    cells = folder.tidy()
    if units := plan.missing(cells):
        then, now = manifest.environment.versions(), here.versions()
        if cells and then != now:
            warnings.warn(
                f"{folder.path} contains {len(cells)} rows made with other versions ({versions_in_words(then, now)}); "
                "they are kept, and the manifest says which versions made which rows; for rows of the same versions, "
                "install the earlier ones, or choose another folder with --output",
                stacklevel=2,
            )
        manifest = manifest.continued_in(here, cells)
    _check_known_sample(plan, known)
    folder.write_manifest(manifest)
    job = plan.job(
        folder=folder.path,
        kept=_clean_rows(folder, {unit.key for unit in units if unit.corruption != CLEAN}),
        first=next((unit.key for unit in units if unit.corruption == CLEAN), None),
        asked_twice=not isinstance(plan.model.model, FlowLookup),
    )
    if job.attacks:
        from .attack_stage import trained_attacks

        job = replace(job, attacks=trained_attacks(folder, plan, units))
    del cells
    if units and isinstance(progress, TerminalProgress):
        progress.engine(engine.describe(units))
    progress.start(folder.path, plan.count(), plan.count() - len(units))
    left = Counter(unit.key for unit in units)
    seconds = dict(manifest.seconds)
    places, differs_on = dict(manifest.places), manifest.flows_differ_on
    start = time.perf_counter()

    def record(done: FinishedUnit) -> None:
        folder.write_rows(done.unit, done.rows)
        left[done.unit.key] -= 1
        if not left[done.unit.key] and plan.pictures is None:  # examples need the clean flow
            folder.finish_sample(done.unit.key)
        progress.advance(done)

    recorded = deque[Future[None]]()
    # an error while the engine ends is raised, not just printed
    with ThreadPoolExecutor(1) as writer, closing(engine.compute(job, units)) as computed:
        for done in computed if units else ():  # the engine starts with the first unit, which may take seconds
            recorded.append(writer.submit(record, done))
            for whose, wrong in done.misread.items():
                _warn(done.unit.key, whose, wrong)
            if done.differs:
                differs_on = done.unit.key
                _warn_of_chance(differs_on)
            for kind, spent in done.seconds.items():
                seconds[kind] = round(seconds.get(kind, 0.0) + spent, 3)
            if done.place is not None:
                places[done.place] = places.get(done.place, 0) + 1
            while recorded and (len(recorded) > _UNWRITTEN or recorded[0].done()):
                recorded.popleft().result()
    for each in recorded:
        each.result()
    if changed := _changed_files(plan, manifest, left):
        _drop_changed(folder, manifest, changed)
    folder.pack()
    if not units and before is not None and before.finished is not None:
        folder.write_manifest(manifest.model_copy(update={"finished": before.finished}))
        return
    seconds["wall"] = round(seconds.get("wall", 0.0) + time.perf_counter() - start, 3)
    clips = clips_of(job.dataset.clip_records()) if isinstance(job.dataset, FromClips) else manifest.clips
    since = {"seconds": seconds, "finished": _now(), "places": places, "clips": clips, "flows_differ_on": differs_on}
    folder.write_manifest(manifest.model_copy(update=since))


def _environment(plan: Plan) -> Environment:
    """Return the environment, for video corruptions with the versions of the libraries that encode them."""
    if not isinstance(plan.benchmark.dataset, FromClips):
        return environment()
    from ..data.video.codec import encoder_versions

    return environment(encoder_versions())


def _continued(folder: RunFolder, plan: Plan, old: Manifest | None, rows: Iterable[str], here: Environment) -> Manifest:
    """Return a folder's manifest, updated with a plan; raise a RunError if they do not match, or if the files of the
    planned samples, or of those whose rows are measured again, have changed."""
    if old and old.identity != plan.identity:
        if not folder.rows().is_empty():
            differing = difference(plan.identity, old.identity)
            raise RunError(folder.path, f"contains a different run; it differs in: {differing}; {_ELSEWHERE}")
        old = None
    if old is None:
        old = Manifest(
            version=7,
            identity=plan.identity,
            identity_digest=plan.identity.digest(),
            samples={},
            training=plan.model.training,
            planned=(),
            started=_now(),
            finished=None,
            environment=here,
        )
    paths = _files(plan, [*plan.benchmark.keys, *rows, *_samples_to_recognise(folder, plan, old)], old)
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
    training = plan.model.training
    return old.model_copy(
        update={
            "samples": old.samples | samples,
            "training": old.training if training == UNDECLARED else training,
            "planned": union((*old.planned, plan.cells())),
            "left_out": merged_levels(old.left_out, plan.left_out()),
            "name": plan.name or old.name,
            "finished": None,
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


def _files(plan: Plan, keys: Iterable[str], manifest: Manifest) -> dict[str, list[Path]]:
    """Return the files of samples, with those of their depth if the plan, or the run that it continues, reads depth."""
    depths: Depths | None = None
    if any(one.needs_depth for one in (*map(condition_of, manifest.corruptions), *plan.benchmark.conditions)):
        depths = plan.benchmark.depths
    return {key: files_of_sample(plan.benchmark.dataset, key, plan.window, depths) for key in keys}


def _known_row(folder: RunFolder, plan: Plan) -> dict[str, dict[str, Any]]:
    """Return the first clean row of a run, if possible of a planned sample; none if the dataset has no such sample."""
    rows = _clean_rows(folder, plan.benchmark.keys) or _clean_rows(folder, plan.benchmark.dataset.keys())
    return dict(sorted(rows.items())[:1])


def _check_known_sample(plan: Plan, rows: dict[str, dict[str, Any]]) -> None:
    """Measure the clean rows again; do nothing if there are none yet."""
    for key in rows:
        with temporary_worker(plan.job(kept=rows)) as worker:
            worker.sample(key)


def _clean_rows(folder: RunFolder, keys: Iterable[str]) -> dict[str, dict[str, Any]]:
    """Return the clean rows that a run already has for these samples, by sample and with only the compared columns."""
    samples = list(keys)
    if not samples:
        return {}
    rows = folder.rows(("sample", "corruption", "severity", *COMPARED), CLEAN).filter(pl.col("sample").is_in(samples))
    return {row["sample"]: row for row in rows.iter_rows(named=True)}


def _changed_files(plan: Plan, manifest: Manifest, keys: Iterable[str]) -> dict[str, Path]:
    """Return, for each sample, the first file that has changed since the manifest was written."""
    files = {key: paths[: len(manifest.samples[key])] for key, paths in _files(plan, keys, manifest).items()}
    changed = {}
    for key, digests in file_digests(files).items():
        pairs = zip(files[key], digests, manifest.samples[key], strict=True)
        if paths := [path for path, digest, (_, before) in pairs if digest != before]:
            changed[key] = paths[0]
    return changed


def _drop_changed(folder: RunFolder, manifest: Manifest, changed: Mapping[str, Path]) -> None:
    """Remove the rows of samples whose files changed while they were read, because it is unknown which bytes were
    measured; then raise."""
    folder.drop_samples(changed)
    folder.write_manifest(manifest.without(changed))
    key, path = next(iter(changed.items()))
    more = f" and {len(changed) - 1} more" if len(changed) > 1 else ""
    raise DataError(
        path,
        f"changed while the run was reading it, so the rows of sample '{key}'{more} were removed; run the same command "
        "again once no process is writing to the data",
    )


def _warn(key: str, whose: str, wrong: Misread) -> None:
    remedy = "correct the model, and use robustflow check"
    if whose == OF_TRUTH:
        remedy = "correct the dataset; the errors below are not the model's"
    if wrong.reading == Reading(factor=0.5):
        remedy += " (DSEC's PNGs, read as KITTI's, are twice too long)"
    warnings.warn(
        f"{whose} looks {wrong.reading.describe()}: on sample '{key}', {wrong.describe()}; flow is (u right, v down) "
        f"in pixels from frame 1 to frame 2, so {remedy}",
        stacklevel=3,
    )


def _warn_of_chance(key: str) -> None:
    warnings.warn(
        f"the model predicts different flows for the same frames (sample '{key}'), so no run can be repeated exactly; "
        "seed its random numbers, or switch it to evaluation mode",
        stacklevel=3,
    )


def _now() -> str:
    """Return the time in UTC, to the second."""
    return datetime.now(UTC).isoformat(timespec="seconds")
