"""Register user-defined corruptions, given as an object, a class or `module:Attribute`.

The results of a user-defined corruption are checked on every call, so that mistakes cause clear errors instead of wrong
numbers; `robustflow.testing.check_corruption` performs additional checks (determinism, random draws).
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from ..core.arguments import SEVERITIES
from ..core.errors import UsageError
from ..core.plugins import called, checked_name, described, own_name
from ..core.rng import Rng
from ..core.source_digest import source_digest
from ..core.types import TRUTHS, Frame, SceneDepth, described_array, read_only
from .corruption import BGR, VARIANTS, Corruption
from .registry import CORRUPTIONS, ON_DISK, SHIPPED

Made = Any
"""A corruption class, or an instance of one."""

_own: dict[str, Made] = {}
_GUIDE = "see the guide 'add your corruption'"


class OwnCorruption(Corruption):
    """Wraps a user-defined corruption and checks its arguments and results."""

    def __init__(self, made: Any, variant: str = "default") -> None:
        self.name = own_name(made)
        self.temporal = bool(getattr(made, "temporal", False))
        self.needs_depth = bool(getattr(made, "needs_depth", False))
        self.truth = getattr(made, "truth", "unchanged")
        if self.truth not in TRUTHS:
            raise UsageError(self.name, f"its `truth` is {self.truth!r:.60}; set {' or '.join(TRUTHS)}")
        levels = getattr(made, "severities", getattr(made, "paper_severities", SEVERITIES))
        try:
            self.paper_severities = tuple(levels)
        except TypeError:
            raise UsageError(self.name, f"its `severities` are {levels!r:.60}; give a tuple of 5") from None
        self.made = made
        if variant not in (*VARIANTS, BGR):
            raise UsageError(variant, f"not a variant; choose from {', '.join((*VARIANTS, BGR))}")
        super().__init__()
        self.variant = variant

    @property
    def source(self) -> str:
        return source_digest(self.made)

    def __reduce__(self) -> tuple[Any, ...]:
        return _restored, (_own.get(self.name, self.made), self.variant)  # an object of a class may not be picklable

    def draw(self, rng: Rng, severity: int, shape: tuple[int, int]) -> Any:
        self.parameter(severity)
        return self._call("draw", lambda: self.made.draw(rng, severity, shape))

    def draw_scene(self, rng: Rng, severity: int, depth: SceneDepth) -> Any:
        self.parameter(severity)
        scene = _scene_read_only(depth)
        return self._call("draw_scene", lambda: self.made.draw_scene(rng, severity, scene))

    def apply(self, frame: Frame, state: Any, index: int) -> Frame:
        copy = read_only(np.ascontiguousarray(frame))
        out = self._call("apply", lambda: self.made.apply(copy, state, index))
        if not isinstance(out, np.ndarray) or out.dtype != np.uint8 or out.shape != frame.shape:
            raise UsageError(
                self.name, f"returned {described_array(out)}; apply must return a uint8 array of shape {frame.shape}"
            )
        return np.array(out)

    def _call(self, method: str, function: Callable[[], Any]) -> Any:
        what = "the frame or the depth" if self.needs_depth else "the frame"
        return called(self.name, method, function, read_only=what)


def register_custom(made: Made) -> str:
    """Register a class or an object under its name and return the name; a later registration replaces an earlier
    one.
    """
    _check_methods(made)
    name = checked_name(made, "corruption", (*SHIPPED, *ON_DISK).__contains__)
    _own[name] = made
    return name


def own_corruption(name: str, variant: str) -> OwnCorruption | None:
    """Return the corruption that the user or an installed package registered under a name."""
    if name in SHIPPED or name in ON_DISK:
        return None
    corruption = _own.get(name)
    if corruption is None:
        corruption = CORRUPTIONS.get(name)
        _check_methods(corruption)
        if own_name(corruption) != name:
            raise UsageError(
                name, f"this entry point provides a corruption named '{own_name(corruption)}'; the names must match"
            )
    return OwnCorruption(_build(corruption, variant) if inspect.isclass(corruption) else corruption, variant)


def _restored(made: Made, variant: str) -> OwnCorruption | None:
    """Register a corruption in a worker process, and return it."""
    return own_corruption(register_custom(made), variant)


def is_known(name: str) -> bool:
    """Return whether this package, an installed package or the user provides a corruption with this name."""
    return name in _own or name in CORRUPTIONS.names()


def _check_methods(made: Made) -> None:
    for method in ("draw_scene" if getattr(made, "needs_depth", False) else "draw", "apply"):
        if not callable(getattr(made, method, None)):
            raise UsageError(described(made), f"has no method {method}, so it is not a corruption; {_GUIDE}")


def _scene_read_only(depth: SceneDepth) -> SceneDepth:
    """Return read-only views of the depth maps, because all corruptions of the pair use the same arrays."""
    (first, second), (measured, also_measured), camera = depth.maps, depth.measured, depth.camera
    if camera.rotation is not None and camera.translation is not None:
        camera = replace(camera, rotation=read_only(camera.rotation), translation=read_only(camera.translation))
    return SceneDepth((read_only(first), read_only(second)), (read_only(measured), read_only(also_measured)), camera)


def _build(kind: type[Any], variant: str) -> Any:
    def build() -> Any:
        takes = inspect.signature(kind).parameters
        return kind(variant=variant) if "variant" in takes and variant in VARIANTS else kind()

    advice = "give every argument a default value, or pass an instance"
    return called(own_name(kind), "its constructor", build, advice)
