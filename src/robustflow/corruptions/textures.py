"""Which textures frost is laid over frames from, and how a run's identity says so."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal, get_args

from ..errors import unknown_name

Textures = Literal["photographs", "generated"]
"""`photographs`: the paper's five, fetched on first use. `generated`: five computed ones, which need no network."""

PHOTOGRAPHS: Textures = "photographs"
GENERATED: Textures = "generated"

GENERATED_VERSION = 1
"""Part of the name of the textures' streams, and of a run's identity: raised when a byte of the textures changes."""

KEY = "frost"
"""In a run's identity, which has it only where the textures are not the photographs."""


def check_textures(textures: Textures) -> Textures:
    """The textures as they were named.

    Raises:
        UsageError: there are none of that name.
    """
    if textures not in get_args(Textures):
        raise unknown_name("frost textures", textures, get_args(Textures))
    return textures


def textures_record(textures: Textures) -> dict[str, str]:
    """What a run's identity says of its textures.

    >>> textures_record("photographs"), textures_record("generated")
    ({}, {'frost': 'generated 1'})
    """
    return {} if check_textures(textures) == PHOTOGRAPHS else {KEY: f"{textures} {GENERATED_VERSION}"}


def recorded_textures(identity: Mapping[str, Any]) -> Textures:
    """The textures of a run, by its identity; the photographs where it says nothing.

    >>> recorded_textures({"seed": 0}), recorded_textures({"frost": "generated 1"})
    ('photographs', 'generated')
    """
    return GENERATED if str(identity.get(KEY, "")).startswith(GENERATED) else PHOTOGRAPHS
