"""Warn if the flow of a run's first pair is not (u right, v down) in pixels from frame 1 to frame 2. Check, before
a run continues, that the model and the data are unchanged since its rows were measured. Compute the units that
are missing from a run folder, and write each one as soon as it is finished.

An identity does not cover everything: for a user's model it includes the source file, but no imported modules or other
files; for data, only the names and sizes of files. So one clean row is measured again, for the sample with the most
recently changed files. Frames and ground truth are always compared; the prediction is compared unless the model is
identified by a hash of its content. All other samples are compared in the same way when their units continue (see
`Worker`).
"""

from __future__ import annotations

import re
import time
import warnings
from collections import Counter
from collections.abc import Mapping
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

from ..core.errors import DataError
from ..core.processes import one_opencv_thread
from ..data.datasets.base import FromClips
from ..metrics.photometric import misread
from ..metrics.rows import CLEAN
from .attack_stage import learned_patterns
from .engines.base import Engine, Job
from .manifest import Manifest, clips_of
from .measure_stage import check_same_data, check_same_model, stored_clean_rows
from .open_manifest import changed_files, last_changed, now, open_manifest
from .plan import Plan, Unit, unfinished_samples
from .progress import Progress, TerminalProgress
from .setup import Setup
from .store import RunFolder
from .worker import NoMotion, temporary_worker


def check_first_pair(job: Job, key: str) -> None:
    """Compare the clean flow of a pair, which an engine has stored or else is predicted here, with its frames."""
    with one_opencv_thread():
        worker = job.worker()
        sample, flow = worker.sample(key), worker.clean_flow(key)
    wrong = misread([(sample.frames[0], sample.frames[1], flow)])
    if wrong is not None:
        warnings.warn(
            f"the model's flow looks {wrong.reading.describe()}: on sample '{key}', frame 2 warped by the flow differs "
            f"from frame 1 by {wrong.given:.1f} grey levels, and by {wrong.error:.1f} if the flow is corrected for "
            "this; a model must return (u right, v down) in pixels from frame 1 to frame 2, so correct the model, and "
            "use robustflow check",
            stacklevel=3,
        )


_HASH = re.compile(r"[0-9a-f]{64}")


def check_before_resuming(folder: RunFolder, job: Job, plan: Plan) -> None:
    """Measure one clean row of a run again and compare it; do nothing if there is no row yet."""
    stored = stored_clean_rows(folder, plan.benchmark.keys)
    if not stored:
        return
    before = stored[last_changed(plan, stored)]
    only_data = job.options.window is None and is_named_by_content(plan.model_identity)
    model = NoMotion() if only_data else job.load_model()
    alone = job.options.measuring.model_copy(update={"confidence": None})
    options = replace(job.options, measuring=alone) if only_data else job.options
    with temporary_worker(job.dataset, model, options) as worker:
        (now,) = worker.run(Unit(before["sample"], CLEAN, (0,)))
    check_same_data(before, now)
    if not only_data:
        check_same_model(before, now)


def is_named_by_content(identity: dict[str, Any]) -> bool:
    """Return whether a model's identity includes the SHA-256 of its weights or files, and the model has no user
    code.
    """
    users = "source" in identity or "object" in identity
    return not users and any(isinstance(value, str) and _HASH.fullmatch(value) for value in identity.values())


def compute_missing(folder: RunFolder, setup: Setup, engine: Engine, batch_size: int, progress: Progress) -> None:
    """Compute and write the planned units that do not exist yet."""
    plan, named = setup.plan, setup.model
    job = Job(setup.dataset, named.spec or named.model, plan.options, folder.path, batch_size, named.model)
    before = folder.manifest()
    manifest = open_manifest(folder, plan)
    cells = folder.tidy()
    check_before_resuming(folder, job, plan)
    folder.write_manifest(manifest)
    folder.settle(manifest.samples, unfinished_samples(manifest, cells), cells)
    units = plan.missing(cells)
    learned = learned_patterns(folder, plan, named.model, units, batch_size)
    job = replace(job, options=replace(plan.options, learned=learned, run=manifest.identity_digest))
    job = replace(job, kept=stored_clean_rows(folder, {unit.key for unit in units if unit.corruption != CLEAN}))
    del cells
    if units and isinstance(progress, TerminalProgress):
        progress.engine(engine.describe(units))
    progress.start(folder.path, plan.count(), plan.count() - len(units))
    left = Counter(unit.key for unit in units)
    seconds = dict(manifest.seconds)
    places = dict(manifest.places)
    checked = False
    start = time.perf_counter()
    with closing(engine.compute(job, units)) as computed:  # an error while the engine ends is raised, not just printed
        for done in computed if units else ():  # the engine starts with the first unit, which may take seconds
            folder.write_rows(done.unit, done.rows)
            if done.unit.corruption == CLEAN and not checked:
                check_first_pair(job, done.unit.key)
                checked = True
            left[done.unit.key] -= 1
            if not left[done.unit.key]:
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
        f"{path} changed while the run was reading it, so the rows of sample '{key}'{more} were removed; run the same "
        "command again once no process is writing to the data"
    )
