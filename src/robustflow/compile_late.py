"""Compiled functions of fixed types that are compiled, or read from numba's cache, when they are first called.

numba does that with a function's definition if it is given types. A process would then compile every such function of
every file it imports, up to two seconds each, though most are called in other processes.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, wraps
from typing import Any

from numba import njit

Function = Callable[..., Any]


def njit_late(signature: Any, **options: Any) -> Callable[[Function], Function]:
    """`numba.njit`, late.

    Args:
        signature: the types, in which read-only arrays are named as such. Compiled code cannot call the function.
        options: of `numba.njit`.

    >>> @njit_late("float64(float64)")
    ... def half(x):
    ...     return x / 2
    >>> half(3)
    1.5
    """

    def decorate(function: Function) -> Function:
        compiled = cache(lambda: njit(signature, **options)(function))

        @wraps(function)
        def call(*arguments: Any) -> Any:
            return compiled()(*arguments)

        return call

    return decorate
