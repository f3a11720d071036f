"""Base classes of validated data, from the least strict to the one for files that may come from anyone."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict


class Frozen(BaseModel):
    """Validated values that do not change; an unknown field is refused.

    >>> class Crop(Frozen):
    ...     height: int
    >>> Crop(height=3, width=4)
    Traceback (most recent call last):
    pydantic_core._pydantic_core.ValidationError: ...
    """

    model_config = ConfigDict(frozen=True, extra="forbid")


class FrozenFinite(Frozen):
    """The same, and no number is infinite or NaN: JSON has none."""

    model_config = ConfigDict(allow_inf_nan=False)


class Untrusted(FrozenFinite):
    """The same, and nothing is converted: "3" is not a number. For a file that may come from anyone."""

    model_config = ConfigDict(strict=True)
