"""The objectives of methods that learn without labels; a recipe defines its objective as a table.

Start times are given as fractions of the training run, so that a shorter run includes all phases.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from ..validated import Frozen

Range = tuple[float, float]


class Appearance(Frozen):
    """Changes to the frames' colours for ARFlow's second pass, applied in this order."""

    brightness: float = Field(default=0.5, ge=0)
    contrast: float = Field(default=0.0, ge=0)
    saturation: float = Field(default=0.0, ge=0)
    blur: float = Field(default=3.0, ge=0)
    gamma: Range | None = None


class Spatial(Frozen):
    """Motion of the frames for ARFlow's second pass. `relative_*` is additional motion of the second frame."""

    translation: float = Field(default=0.04, ge=0)
    zoom: Range = (1.0, 1.4)
    squeeze: Range = (1.0, 1.0)
    rotation: Range = (-0.01, 0.01)
    relative_translation: float = Field(default=0.005, ge=0)
    relative_zoom: Range = (0.99, 1.01)
    relative_squeeze: Range = (1.0, 1.0)
    relative_rotation: Range = (-0.01, 0.01)
    constant_rotation: bool = True
    horizontal: bool = True
    vertical: bool = False
    noise: float = Field(default=0.04, ge=0)


class ArflowObjective(Frozen):
    """ARFlow's objective (Liu et al., CVPR 2020)."""

    kind: Literal["arflow"]
    census_from: float = Field(0.05, ge=0, le=1)
    smooth: float = Field(75.0, ge=0)
    second_order: bool = True
    self_supervision: float = Field(0.0, ge=0)
    appearance: Appearance = Appearance()
    spatial: Spatial = Spatial()


class UpflowObjective(Frozen):
    """UPFlow's objective (Luo et al., CVPR 2021)."""

    kind: Literal["upflow"]
    photometric: float = Field(1.0, ge=0)
    census: float = Field(1.0, ge=0)
    smooth: float = Field(1.0, ge=0)
    distillation: float = Field(1.0, ge=0)
    exponent: float = Field(0.4, gt=0)
    radius: int = Field(3, ge=1)


class BrightflowObjective(Frozen):
    """BrightFlow's objective (Marsal et al., WACV 2023)."""

    kind: Literal["brightflow"]
    census: float = Field(0.5, ge=0)
    smooth: float = Field(2.0, ge=0)
    second_order: bool = True
    occlusion: Literal["brox", "wang"] = "brox"
    self_supervision: float = Field(0.3, ge=0)
    self_supervision_from: float = Field(0.4, ge=0, le=1)
    self_supervision_to: float = Field(0.5, ge=0, le=1)
    border: int = Field(64, ge=0)
    corrector: float = Field(0.1, ge=0)
    corrector_from: float = Field(20 / 75, ge=0, le=1)
    corrected_from: float = Field(25 / 75, ge=0, le=1)


Objective = Annotated[ArflowObjective | UpflowObjective | BrightflowObjective, Field(discriminator="kind")]
