"""Determine the constructor arguments of a ptlflow model. Importable without ptlflow."""

from __future__ import annotations

import inspect
from collections.abc import Sequence
from typing import Any, get_origin

from ...errors import UsageError
from ..option_checks import check_count

_ITERATIONS = ("iters", "decoder_depth")
"""Argument names for the number of iterations in ptlflow's models."""


def constructor_options(name: str, reference: type, iterations: int | None) -> tuple[dict[str, Any], int | None]:
    """Return the constructor arguments for predicting complete frames with the given number of iterations; sequences
    are passed as lists, and no backbone is downloaded.
    """
    parameters = constructor_parameters(reference)
    # ptlflow's own loader also passes lists, and some constructors modify them.
    options: dict[str, Any] = {
        key: list(parameter.default)
        for key, parameter in parameters.items()
        if get_origin(parameter.annotation) is Sequence and isinstance(parameter.default, (list, tuple))
    }
    if "use_tile_input" in parameters:
        options["use_tile_input"] = False
    if "backbone_weights" in parameters:
        options["backbone_weights"] = None  # no need to download weights: the checkpoint replaces them
    keyword = next((key for key in _ITERATIONS if key in parameters), None)
    counted = keyword is not None and isinstance(parameters[keyword].default, int)
    if iterations is not None:
        check_count("iterations", iterations)
        if not counted:
            raise UsageError(f"model '{name}' does not have exactly one number of iterations; omit iterations")
    if keyword is None or not counted:
        return options, None
    rounds = int(parameters[keyword].default) if iterations is None else iterations
    return options | {keyword: rounds}, rounds


def constructor_parameters(reference: type) -> dict[str, inspect.Parameter]:
    """Return the arguments of a class, including those that it passes to its base classes through `**kwargs`.

    >>> class Base:
    ...     def __init__(self, depth=3, width=64): ...
    >>> class Net(Base):
    ...     def __init__(self, width=32, **kwargs): ...
    >>> {key: parameter.default for key, parameter in constructor_parameters(Net).items()}
    {'width': 32, 'depth': 3}
    """
    merged: dict[str, inspect.Parameter] = {}
    for base in reference.__mro__:
        if "__init__" not in vars(base):
            continue
        _, *parameters = inspect.signature(vars(base)["__init__"]).parameters.values()
        kinds = {parameter.kind for parameter in parameters}
        for parameter in parameters:
            if parameter.kind not in (parameter.VAR_KEYWORD, parameter.VAR_POSITIONAL):
                merged.setdefault(parameter.name, parameter)
        if inspect.Parameter.VAR_KEYWORD not in kinds:
            break
    return merged
