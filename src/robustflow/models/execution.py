"""Execution settings shared by all network adapters."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from ..core.arguments import check_count, check_switch
from ..core.errors import unknown_name
from .conventions import MOST_THREADS

PRECISIONS = ("fp32", "bf16")


@dataclass(frozen=True)
class Execution:
    """The execution settings of a PyTorch network."""

    device: str = "auto"
    precision: str = "fp32"
    compile: bool = False
    threads: int = 1

    def __post_init__(self) -> None:
        if self.precision not in PRECISIONS:
            raise unknown_name("precision", str(self.precision), PRECISIONS)
        check_count("threads", self.threads, most=MOST_THREADS)
        check_switch("compile", self.compile)

    def record(self, device: str) -> dict[str, Any]:
        """Return the settings for a model's identity; `device` is the type of the device that is used."""
        return {**asdict(self), "device": device}
