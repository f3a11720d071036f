"""Evaluate the available variants, each in a folder named after its weights, so that an interrupted evaluation can be
resumed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from ..api import Result, evaluate
from ..benchmarks import Benchmark
from ..errors import RobustFlowError, RunError, UsageError
from ..runs.store import RunFolder
from ..text import first_of
from .artefacts import Artefact
from .plan import Missing, Runnable

_MOST_NAMED = 4


def check_selection(choices: Sequence[Runnable | Missing], output: Path, chosen: Benchmark) -> None:
    """Check that existing runs contain only what is asked for now; a run is extended to it, but never reduced, so its
    averages would be over more than was asked for.

    Args:
        choices: result of `plan.choose`.
        output: folder as for `measure_variants`.
        chosen: benchmark with the pairs, corruptions and severities to measure.

    Raises:
        UsageError: a run contains more.
    """
    for choice in choices:
        if isinstance(choice, Missing):
            continue
        folder = output / chosen.name / choice.folder
        try:
            manifest = RunFolder(folder).manifest()
        except RunError:
            continue  # reported when the variant is evaluated
        if manifest is None:
            continue
        selection = manifest.selection
        for what, there, asked in (
            ("pairs", manifest.samples, chosen.keys),
            ("corruptions", selection.corruptions, chosen.corruptions),
            ("severities", selection.severities, chosen.severities),
        ):
            if more := [str(name) for name in there if name not in asked]:
                raise UsageError(
                    f"the run in {folder} also contains {what} {first_of(more, _MOST_NAMED)}; ask for all of them, or "
                    "choose another folder with --output"
                )


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
