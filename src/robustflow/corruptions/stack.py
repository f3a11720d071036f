"""Apply several corruptions in sequence as a stack: `"fog+jpeg_compression"`, `"fog:2+jpeg_compression:4"`.

Real footage is foggy *and* compressed; the paper lists this as its first limitation. A part without a severity uses the
severity of the stack; a part with a severity keeps its own. The parts are applied in the specified order, and each uses
a separate random stream, which is named after its position.
"""

from __future__ import annotations

from typing import Any

from ..core.arguments import SEVERITIES, check_severity
from ..core.errors import UsageError
from ..core.plugins import import_target, is_target
from ..core.rng import Rng
from ..core.types import Frame, SceneDepth
from .base import Corruption
from .own import is_known, own_corruption, register_custom
from .registry import CORRUPTIONS, FURTHER, SHIPPED, refuse_on_disk
from .scale import calibrated_levels

_PLUS, _COLON = "+", ":"


def is_stack(name: str) -> bool:
    """Return whether a name denotes a stack rather than a single corruption.

    >>> is_stack("fog"), is_stack("fog+snow"), is_stack("fog:2")
    (False, True, True)
    """
    return _PLUS in name or _COLON in name


def parse_stack(name: str) -> list[tuple[str, int | None]]:
    """Return the parts of a stack's name with their severities (None if not specified), without importing anything."""
    parts = split_stack(name)
    for part, _ in parts:
        refuse_on_disk(part)
        if not is_known(part):
            CORRUPTIONS.get(part)
    return parts


def split_stack(name: str) -> list[tuple[str, int | None]]:
    """Parse a name like `parse_stack`, but allow unknown corruptions, e.g. in a run from a different machine.

    >>> split_stack("rain+fog:2")
    [('rain', None), ('fog', 2)]
    """
    parts: list[tuple[str, int | None]] = []
    for part in name.split(_PLUS):
        corruption, colon, level = (text.strip() for text in part.partition(_COLON))
        if not corruption or (colon and not (len(level) == 1 and level in "0123456789")):
            raise UsageError(
                f"{name:.80}",
                "not a stack of corruptions; use NAME or NAME:SEVERITY, joined by '+', "
                "or module.path:Attribute for a custom corruption",
            )
        parts.append((corruption, check_severity(int(level)) if level else None))
    return parts


def with_targets_registered(name: str) -> str:
    """Import every `module.path:Attribute` in a name and replace it with the name of the corruption.

    >>> with_targets_registered("fog:2 + snow")
    'fog:2+snow'
    """
    parts = []
    for part in (text.strip() for text in name.split(_PLUS)):
        head, _, tail = part.rpartition(_COLON)
        target, level = (head.strip(), f"{_COLON}{tail.strip()}") if tail.strip().isdecimal() else (part, "")
        if is_target(target) and target.partition(_COLON)[0] not in SHIPPED:
            part = register_custom(import_target(target, "corruption")) + level
        parts.append(part)
    return _PLUS.join(parts)


def levels_of(name: str, severities: tuple[int, ...], scale: str = "paper") -> tuple[int, ...]:
    """Return the distinct severities at which a corruption exists, usually all five."""
    parts = split_stack(name)
    free = [part for part, level in parts if level is None]
    if not free:
        return (max(level for _, level in parts if level is not None),)
    if scale == "paper":
        return severities
    known = [set(calibrated_levels(part)) for part in free]
    return tuple(level for level in severities if all(level in levels for levels in known))


def needs_depth(name: str) -> bool:
    """Return whether a corruption, or any part of a stack, requires the depth of the scene; False for unknown names."""
    own = [own_corruption(part, "default") if is_known(part) else None for part, _ in split_stack(name)]
    shipped = any(part in FURTHER["depth"] for part, _ in split_stack(name))
    return shipped or any(one.needs_depth for one in own if one is not None)


def truth_under(name: str) -> str:
    """Return what a corruption, or all parts of a stack together, leave of the ground truth (see `Corruption.truth`);
    "unchanged" for unknown names.
    """
    loaded = [
        own_corruption(part, "default") or CORRUPTIONS.get(part) for part, _ in split_stack(name) if is_known(part)
    ]
    return "none" if any(part.truth == "none" for part in loaded) else "unchanged"


class Stack(Corruption):
    """Corruptions applied to every frame one after another.

    >>> from robustflow.corruptions import load_corruption
    >>> load_corruption("fog:2+jpeg_compression").name
    'fog:2+jpeg_compression'
    """

    paper_severities = ("1", "2", "3", "4", "5")

    def __init__(self, parts: list[tuple[Corruption, int | None]]) -> None:
        free = [part.severities for part, level in parts if level is None]
        lacking = [any(own[level - 1] is None for own in free) for level in SEVERITIES]
        super().__init__(
            "default", tuple(None if none else name for none, name in zip(lacking, self.paper_severities, strict=True))
        )
        self.variant = parts[0][0].variant
        for part, level in parts:
            if level is not None:
                part.parameter(level)
        self._parts = parts
        self.needs_depth = any(part.needs_depth for part, _ in parts)
        self.truth = "none" if any(part.truth == "none" for part, _ in parts) else "unchanged"
        names = (part.name if level is None else f"{part.name}{_COLON}{level}" for part, level in parts)
        self.name = _PLUS.join(names)

    def draw(self, rng: Rng, severity: int, shape: tuple[int, int]) -> list[Any]:
        return self.draw_with_depth(rng, severity, shape, None)

    def draw_with_depth(self, rng: Rng, severity: int, shape: tuple[int, int], depth: SceneDepth | None) -> list[Any]:
        self.parameter(severity)
        return [
            part.draw_with_depth(rng.spawn(place, part.name), severity if level is None else level, shape, depth)
            for place, (part, level) in enumerate(self._parts)
        ]

    def apply(self, frame: Frame, state: list[Any], index: int) -> Frame:
        for (part, _), own in zip(self._parts, state, strict=True):
            frame = part.apply(frame, own, index)
        return frame
