"""Execution settings shared by all network adapters, and the line of user code at which a model failed."""

from __future__ import annotations

import inspect
import traceback
from collections.abc import Callable
from dataclasses import asdict, dataclass, fields
from functools import wraps
from pathlib import Path
from typing import Any, TypeVar

from ..core.arguments import check_count, check_switch
from ..core.errors import unknown_name
from .conventions import MOST_THREADS

PRECISIONS = ("fp32", "bf16")
Model = TypeVar("Model")


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


def with_execution(factory: Callable[..., Model]) -> Callable[..., Model]:
    """Decorate a factory so that it accepts the fields of `Execution` as options and receives a single `execution`.

    >>> @with_execution
    ... def build(size=3, *, execution):
    ...     return size, execution.device
    >>> build(4, device="cpu")
    (4, 'cpu')
    >>> list(inspect.signature(build).parameters)
    ['size', 'device', 'precision', 'compile', 'threads']
    """
    shared = [
        inspect.Parameter(field.name, inspect.Parameter.KEYWORD_ONLY, default=field.default)
        for field in fields(Execution)
    ]

    @wraps(factory)
    def build(*arguments: Any, **options: Any) -> Model:
        given = {one.name: options.pop(one.name) for one in shared if one.name in options}
        return factory(*arguments, execution=Execution(**given), **options)

    signature = inspect.signature(factory)
    own = [one for name, one in signature.parameters.items() if name != "execution"]
    parameters = sorted([*own, *shared], key=lambda one: one.kind)  # `**options` has to be the last
    build.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
    return build


_PACKAGE = str(Path(__file__).resolve().parent.parent)


def traceback_hint(error: BaseException) -> str:
    """Return the last line of user code in a traceback as " (at net.py:12)"; if there is none, return the last line of
    the traceback.

    >>> try:
    ...     {}["a"]
    ... except KeyError as error:
    ...     print(traceback_hint(error).endswith(":2)"))
    True
    """
    frames = [frame for frame in traceback.extract_tb(error.__traceback__) if frame.lineno]
    if not frames:
        return ""
    user = [frame for frame in frames if not _is_library(frame.filename)]
    outside = [frame for frame in frames if not frame.filename.startswith(_PACKAGE)]
    last = (user or outside or frames)[-1]
    return f" (at {last.filename}:{last.lineno})"


def _is_library(file: str) -> bool:
    return file.startswith(_PACKAGE) or "site-packages" in file or "dist-packages" in file or "/lib/python" in file
