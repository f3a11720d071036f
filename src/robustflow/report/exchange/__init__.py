"""Export a run as Croissant metadata or as Hugging Face evaluation results.

Exports are deterministic, so `check_exported` can compare a file with the run's record byte for byte.
"""

from __future__ import annotations

import re
from pathlib import PurePosixPath

from ...errors import UsageError, unknown_name
from ...runs.run import Run
from .croissant import croissant_files
from .facts import RunFacts
from .huggingface import huggingface_files

Files = dict[PurePosixPath, bytes]

EXCHANGE_FORMATS = ("croissant", "huggingface")

HUB_NAME = r"[A-Za-z0-9_.-]{1,96}/[A-Za-z0-9_.-]{1,96}"


def exchange_files(run: Run, format: str, hub_dataset: str | None = None) -> Files:
    """Export a run in one of the formats; return file contents by relative path."""
    if format not in EXCHANGE_FORMATS:
        raise unknown_name("exchange format", format, EXCHANGE_FORMATS)
    facts = RunFacts(run)
    if format == "croissant":
        return croissant_files(facts)
    if hub_dataset is None or not re.fullmatch(HUB_NAME, hub_dataset):
        raise UsageError(
            "--format huggingface needs the benchmark's dataset on the Hub: give --hub-dataset ORGANISATION/NAME"
        )
    return huggingface_files(facts, hub_dataset)
