"""Where a run goes that is given no folder."""

from __future__ import annotations

import warnings
from pathlib import Path

from ..corruptions.sources import OWN
from ..errors import RunError
from ..models import ModelSpec
from ..runs.identity import edited_corruptions
from ..runs.plan import Plan
from ..runs.store import RunFolder
from ..text import file_name


def default_folder(plan: Plan, spec: ModelSpec | None) -> Path:
    """Where a run goes that is given no folder: `runs/<benchmark>_<model>_<identity>`."""
    name = spec.name if spec is not None else plan.model_identity.get("name", "model")
    return Path("runs") / f"{plan.benchmark.name}_{file_name(str(name))[-40:]}_{plan.digest()[:8]}"


def warn_of_edited_corruptions(folder: Path, plan: Plan) -> None:
    """Warn that a run starts in a folder of its own because the source of a corruption of the user's was edited.

    Args:
        folder: the `default_folder` of the run.
        plan: of the run.
    """
    identity = plan.identity()
    if folder.exists() or OWN not in identity:
        return
    for other in sorted(folder.parent.glob(f"{folder.name.rpartition('_')[0]}_*")):
        try:
            before = RunFolder(other).manifest()
        except RunError:
            continue
        edited = [] if before is None else edited_corruptions(identity, before["identity"])
        if edited:
            warnings.warn(
                f"the source of the corruption {', '.join(edited)} has changed since {other}; a new run starts "
                f"in {folder}",
                stacklevel=3,
            )
            return
