"""The form that every table of a recipe has."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict


class Table(BaseModel):
    """Validated values that do not change; an unknown key is refused."""

    model_config = ConfigDict(extra="forbid", frozen=True)
