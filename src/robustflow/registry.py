"""A generic registry that maps names to objects, or to `module:attribute` targets that are imported on first use."""

from __future__ import annotations

from collections.abc import Iterator
from importlib import import_module
from importlib.metadata import entry_points
from typing import Any, Generic, TypeVar, cast

from .errors import RobustFlowError, UsageError, first_line, unknown_name

T = TypeVar("T")

_SELF = __name__.partition(".")[0]


class Registry(Generic[T]):
    """Registry of the names of one kind of object. Keeps the order of registration and rejects duplicate names.

    >>> colours = Registry[str]("colour")
    >>> colours.add("red", "string:ascii_lowercase")
    >>> colours.get("red")[:3]
    'abc'
    >>> colours.get("rad")
    Traceback (most recent call last):
    robustflow.errors.UsageError: unknown colour 'rad': did you mean 'red'? Known: red
    """

    def __init__(self, kind: str, entry_point_group: str | None = None) -> None:
        self.kind = kind
        self._targets: dict[str, str] = {}
        self._loaded: dict[str, T] = {}
        self._group = entry_point_group

    def add(self, name: str, target: str) -> None:
        """Register `name` for the lazy target `"module:attribute"`."""
        if self._targets.get(name, target) != target:
            raise RobustFlowError(
                f"{self.kind} '{name}' is registered twice, for {self._targets[name]} and for {target}; rename one"
            )
        self._targets[name] = target

    def __contains__(self, name: object) -> bool:
        """Return whether this name is registered."""
        return name in self.names()

    def __iter__(self) -> Iterator[str]:
        return iter(self.names())

    def __len__(self) -> int:
        return len(self.names())

    def names(self) -> list[str]:
        """Return all names in the order of registration; names from installed packages come last."""
        self._discover()
        return list(self._targets)

    def get(self, name: str) -> T:
        """Return the object registered under a name, imported on first use."""
        if name not in self._loaded:
            if name not in self._targets:
                self._discover()
            if name not in self._targets:
                raise unknown_name(self.kind, name, self._targets)
            self._loaded[name] = cast(T, self._imported(name))
        return self._loaded[name]

    def _imported(self, name: str) -> Any:
        target = self._targets[name]
        module, _, attribute = target.partition(":")
        try:
            return getattr(import_module(module), attribute)
        except Exception as error:
            if isinstance(error, RobustFlowError) or module.partition(".")[0] == _SELF:
                raise
            raise UsageError(
                f"the entry point '{name} = {target}' of an installed package cannot be imported: "
                f"{type(error).__name__}: {first_line(error)}; repair or uninstall the package"
            ) from error

    def _discover(self) -> None:
        if self._group is None:
            return
        for point in entry_points(group=self._group):
            self.add(point.name, f"{point.module}:{point.attr}")
        self._group = None
