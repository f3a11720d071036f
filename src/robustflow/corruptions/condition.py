"""The condition that a name describes: a corruption, or a stack of several that are applied in sequence, such as
`"fog+jpeg_compression"` or `"fog:2+jpeg_compression:4"`.

Real footage is foggy *and* compressed; the paper lists this as its first limitation. A part without a severity uses the
severity of the stack; a part with a severity keeps its own. The parts are applied in the specified order, and each uses
a separate random stream, which is named after its position.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from ..core.arguments import SEVERITIES, check_severity
from ..core.errors import UsageError
from ..core.plugins import import_target, is_target
from ..core.rng import Rng
from ..core.types import Frame, SceneDepth
from .corruption import Corruption
from .registry import CORRUPTIONS, FURTHER, SHIPPED, refuse_on_disk
from .scale import calibrated_levels
from .user_corruptions import is_known, own_corruption, register_custom

_PLUS, _COLON = "+", ":"


@dataclass(frozen=True)
class Condition:
    """A corruption or a stack, as its name describes it; the corruptions may be unknown, e.g. those of another machine.

    Attributes:
        name: the name, as in rows.
        parts: the name and the severity of each corruption, in order; None for the severity of the stack.
    """

    name: str
    parts: tuple[tuple[str, int | None], ...]

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the corruptions."""
        return tuple(name for name, _ in self.parts)

    @property
    def is_stack(self) -> bool:
        """Whether the name denotes a stack rather than a single corruption; "fog:2" is a stack."""
        return len(self.parts) > 1 or self.parts[0][1] is not None

    @property
    def fixed_severity(self) -> int | None:
        """The only severity of a stack whose parts all have one, which is the highest of theirs; None for any other."""
        levels = [level for _, level in self.parts if level is not None]
        return max(levels) if len(levels) == len(self.parts) else None

    def levels(self, severities: Sequence[int], scale: str = "paper") -> tuple[int, ...]:
        """Return those of the severities that exist on a severity scale, or the only one of the stack."""
        if self.fixed_severity is not None:
            return (self.fixed_severity,)
        if scale == "paper":
            return tuple(severities)
        existing = [calibrated_levels(name) for name, level in self.parts if level is None]
        return tuple(severity for severity in severities if all(severity in levels for levels in existing))

    @property
    def needs_depth(self) -> bool:
        """Whether any corruption requires the depth of the scene; False for unknown ones."""
        own = (own_corruption(name, "default") for name in self.names if is_known(name))
        shipped = any(name in FURTHER["depth"] for name in self.names)
        return shipped or any(corruption is not None and corruption.needs_depth for corruption in own)

    def check(self) -> None:
        """Raise a UsageError if a corruption is unknown or exists only as files; imports nothing."""
        for name in self.names:
            refuse_on_disk(name)
            if not is_known(name):
                raise CORRUPTIONS.unknown(name)


@lru_cache(maxsize=4096)
def condition_of(name: str) -> Condition:
    """Parse the name of a condition, the only place that does; imports nothing, because names in files are untrusted.

    >>> condition_of("rain+fog:2").parts
    (('rain', None), ('fog', 2))
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
    return Condition(name, tuple(parts))


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
        self.parts = [part for part, _ in parts]
        self._levels = [level for _, level in parts]
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
            for place, (part, level) in enumerate(zip(self.parts, self._levels, strict=True))
        ]

    def apply(self, frame: Frame, state: list[Any], index: int) -> Frame:
        for part, own in zip(self.parts, state, strict=True):
            frame = part.apply(frame, own, index)
        return frame
