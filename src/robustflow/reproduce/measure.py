"""Evaluate the available variants, each in a folder named after its weights, so that an interrupted evaluation can be
resumed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from ..api import Result, evaluate
from ..errors import RobustFlowError
from .artefacts import Artefact
from .plan import Missing, Runnable


def measure_variants(
    artefact: Artefact,
    choices: Sequence[Runnable | Missing],
    output: Path,
    device: str | None = None,
    **options: Any,
) -> Iterator[tuple[Runnable, Result] | Missing]:
    """Evaluate the available variants, or resume their evaluation, in the order of `choices`.

    The result also contains the missing variants, in the same order.

    A model with random weights represents a method in both settings and is evaluated only once. A variant that fails
    counts as missing, with the reason; the remaining variants still run.

    Args:
        artefact: table or figure to reproduce.
        choices: result of `plan.choose`.
        output: folder with one subfolder per benchmark, which contains one folder per model and weights; tables and
            figures of the same benchmark share these runs.
        device: device of the learned models.
        options: keyword options of `robustflow.evaluate`.
    """
    done: dict[str, Result] = {}
    for choice in choices:
        if isinstance(choice, Missing):
            yield choice
            continue
        try:
            if choice.folder not in done:
                folder = output / artefact.benchmark / choice.folder
                spec = choice.spec.on(device) if device is not None and choice.spec.options else choice.spec
                done[choice.folder] = evaluate(spec, artefact.benchmark, output=folder, **options)
        except RobustFlowError as error:
            yield Missing(choice.variant, f"failed: {error}", "", failed=True)
        else:
            yield choice, done[choice.folder]
