"""Evaluate the available variants, each in a folder named after its weights, so that an interrupted evaluation can be
resumed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from ..api import Result, evaluate
from ..core.errors import RobustFlowError
from .plan import Artefact, Missing, Runnable


def measure_variants(
    artefact: Artefact,
    choices: Sequence[Runnable | Missing],
    output: Path,
    device: str | None = None,
    **options: Any,
) -> Iterator[tuple[Runnable, Result] | Missing]:
    """Evaluate the available variants, or resume their evaluation, in the order of `choices`."""
    done: dict[str, Result] = {}
    for choice in choices:
        if isinstance(choice, Missing):
            yield choice
            continue
        try:
            if choice.folder not in done:
                folder = output / artefact.benchmark / choice.folder
                ref = choice.ref.on(device) if device is not None and choice.ref.checkpoint is not None else choice.ref
                done[choice.folder] = evaluate(ref, artefact.benchmark, output=folder, **options)
        except RobustFlowError as error:
            yield Missing(choice.variant, f"failed: {error}", "", failed=True)
        else:
            yield choice, done[choice.folder]
