"""Base classes of validated data, from the least strict to the one for untrusted files."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict


class Frozen(BaseModel):
    """Immutable validated data; unknown fields are rejected.

    >>> class Crop(Frozen):
    ...     height: int
    >>> Crop(height=3, width=4)
    Traceback (most recent call last):
    pydantic_core._pydantic_core.ValidationError: ...
    """

    model_config = ConfigDict(frozen=True, extra="forbid")


class FrozenFinite(Frozen):
    """Immutable validated data without infinite or NaN values, which JSON does not support."""

    model_config = ConfigDict(allow_inf_nan=False)


class Untrusted(FrozenFinite):
    """Immutable, finite validated data without type conversion: "3" is not a number. For untrusted files."""

    model_config = ConfigDict(strict=True)
