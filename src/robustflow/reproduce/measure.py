"""Run the variants that can be run, each in the folder of its weights, so that a stopped call goes on."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from ..api import Result, evaluate
from ..errors import RobustFlowError
from ..models import ModelSpec
from .artefacts import Artefact
from .plan import Missing, Runnable


def measure_variants(
    artefact: Artefact,
    choices: Sequence[Runnable | Missing],
    output: Path,
    device: str | None = None,
    **options: Any,
) -> Iterator[tuple[Runnable, Result] | Missing]:
    """Run, or go on with, what can be run; in the order of the choices, what is missing in its place.

    Random weights of a method replace it in both settings and are run once. A variant that fails is missing, with
    the reason; the others are run.

    Args:
        artefact: what is measured again.
        choices: from `plan.choose`.
        output: holds a folder per benchmark, and in it one per model and weights; tables and figures of one benchmark
            share them.
        device: of the learned models.
        options: of `robustflow.evaluate`.
    """
    done: dict[str, Result] = {}
    for choice in choices:
        if isinstance(choice, Missing):
            yield choice
            continue
        try:
            if choice.folder not in done:
                folder = output / artefact.benchmark / choice.folder
                done[choice.folder] = evaluate(_on(choice.spec, device), artefact.benchmark, output=folder, **options)
        except RobustFlowError as error:
            yield Missing(choice.variant, f"failed: {error}", "")
        else:
            yield choice, done[choice.folder]


def _on(spec: ModelSpec, device: str | None) -> ModelSpec:
    return spec.on(device) if device is not None and spec.options else spec
