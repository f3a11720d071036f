"""Compute the units that a run lacks, and write each one as soon as it is finished. Warn if the flow of the first pair
is not (u right, v down) in pixels from frame 1 to frame 2."""

from __future__ import annotations

import time
import warnings
from collections import Counter
from collections.abc import Mapping
from contextlib import closing
from dataclasses import replace
from pathlib import Path

from ..core.errors import DataError
from ..data.datasets.base import FromClips
from ..metrics.photometric import Misread
from ..metrics.rows import CLEAN
from .engines.base import Engine
from .manifest import Manifest, clips_of
from .plan import unfinished_samples
from .progress import Progress, TerminalProgress
from .resume import changed_files, check_before_resuming, now, open_manifest, stored_clean_rows
from .setup import Setup
from .store import RunFolder
from .worker import Job


def _warn(key: str, wrong: Misread) -> None:
    warnings.warn(
        f"the model's flow looks {wrong.reading.describe()}: on sample '{key}', frame 2 warped by the flow differs "
        f"from frame 1 by {wrong.given:.1f} grey levels, and by {wrong.error:.1f} if the flow is corrected for this; a "
        "model must return (u right, v down) in pixels from frame 1 to frame 2, so correct the model, and use "
        "robustflow check",
        stacklevel=3,
    )


def compute_missing(folder: RunFolder, setup: Setup, engine: Engine, batch_size: int, progress: Progress) -> None:
    """Compute and write the planned units that do not exist yet."""
    plan, named = setup.plan, setup.model
    job = Job(setup.dataset, named.spec or named.model, plan.options, folder.path, batch_size, named.model)
    before = folder.manifest()
    manifest = open_manifest(folder, plan)
    cells = folder.tidy()
    check_before_resuming(folder, job, plan)
    folder.write_manifest(manifest)
    folder.keep_clean(key for key in unfinished_samples(manifest, cells) if (key, CLEAN, 0) in cells)
    units = plan.missing(cells)
    job = replace(job, options=replace(plan.options, run=manifest.identity_digest))
    if plan.options.attacks:
        from .attack_stage import learned_patterns

        learned = learned_patterns(folder, plan, named.model, units, batch_size)
        job = replace(job, options=replace(job.options, learned=learned))
    job = replace(job, kept=stored_clean_rows(folder, {unit.key for unit in units if unit.corruption != CLEAN}))
    job = replace(job, first=next((unit.key for unit in units if unit.corruption == CLEAN), None))
    del cells
    if units and isinstance(progress, TerminalProgress):
        progress.engine(engine.describe(units))
    progress.start(folder.path, plan.count(), plan.count() - len(units))
    left = Counter(unit.key for unit in units)
    seconds = dict(manifest.seconds)
    places = dict(manifest.places)
    start = time.perf_counter()
    with closing(engine.compute(job, units)) as computed:  # an error while the engine ends is raised, not just printed
        for done in computed if units else ():  # the engine starts with the first unit, which may take seconds
            folder.write_rows(done.unit, done.rows)
            if done.misread is not None:
                _warn(done.unit.key, done.misread)
            left[done.unit.key] -= 1
            if not left[done.unit.key] and plan.options.pictures is None:  # examples need the clean flow
                folder.finish_sample(done.unit.key)
            for kind, spent in done.seconds.items():
                seconds[kind] = round(seconds.get(kind, 0.0) + spent, 3)
            if done.place is not None:
                places[done.place] = places.get(done.place, 0) + 1
            progress.advance(done)
    if changed := changed_files(plan, manifest, left):
        _drop_changed(folder, manifest, changed)
    folder.pack()
    if not units and before is not None and before.finished is not None:
        since = {name: getattr(before, name) for name in ("finished", "environment")}
        folder.write_manifest(manifest.model_copy(update=since))
        return
    seconds["wall"] = round(seconds.get("wall", 0.0) + time.perf_counter() - start, 3)
    clips = clips_of(job.dataset.clip_records()) if isinstance(job.dataset, FromClips) else manifest.clips
    since = {"seconds": seconds, "finished": now(), "places": places, "clips": clips}
    folder.write_manifest(manifest.model_copy(update=since))


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
