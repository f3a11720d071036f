"""Determine the default folder of a run."""

from __future__ import annotations

import warnings
from pathlib import Path

from ..benchmarks.facts import moving_name
from ..datasets.folder import OWN_FRAMES
from ..errors import RunError
from ..layout import user_path
from ..models.loading import ModelSpec
from ..runs.plan import Plan
from ..runs.store import RunFolder
from ..text import file_name


def default_folder(plan: Plan, spec: ModelSpec | None, data: str | Path | None = None) -> Path:
    """Return the default folder of a run: `runs/<benchmark>_<model>_<identity>`, followed by the name of the data
    for a user's own frames, because the identity does not depend on which frames they are."""
    name = spec.name if spec is not None else plan.model_identity.get("name", "model")
    benchmark = plan.benchmark.name
    if moving_name(benchmark) == OWN_FRAMES and data is not None:
        benchmark += f"-{file_name(user_path(data).absolute().stem)[-40:]}"
    return Path("runs") / f"{benchmark}_{file_name(str(name))[-40:]}_{plan.digest()[:8]}"


def warn_of_a_fresh_start(folder: Path, plan: Plan) -> None:
    """Warn that a run starts in a new folder because the source of one of the user's corruptions was edited."""
    identity = plan.identity()
    if folder.exists() or not identity.frames.corruptions:
        return
    for other in sorted(folder.parent.glob(f"{folder.name.rpartition('_')[0]}_*")):
        try:
            manifest = RunFolder(other).manifest()
        except RunError:
            continue
        if manifest is None:
            continue
        if edited := identity.edited_corruptions(manifest.identity):
            warnings.warn(
                f"the source of the corruption {', '.join(edited)} has changed since {other}; a new run starts in "
                f"{folder}",
                stacklevel=3,
            )
            return
