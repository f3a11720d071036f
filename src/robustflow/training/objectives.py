"""What a method that learns without labels minimises, as tables of its recipe.

Anything that starts in the middle of a training is given as a fraction of its updates, so that a shorter training
passes through all of it.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from ..validated import Frozen

Range = tuple[float, float]


class Appearance(Frozen):
    """How ARFlow changes the colours of both frames for the second pass, in this order.

    Attributes:
        brightness, contrast, saturation: factors from 1 - x to 1 + x, in random order.
        blur: largest radius of a Gaussian blur in pixels, uniform from 0, with probability 1/2.
        gamma: range of an exponent; None for none.
    """

    brightness: float = Field(default=0.5, ge=0)
    contrast: float = Field(default=0.0, ge=0)
    saturation: float = Field(default=0.0, ge=0)
    blur: float = Field(default=3.0, ge=0)
    gamma: Range | None = None


class Spatial(Frozen):
    """How ARFlow moves the frames for the second pass. `relative_*` moves the second frame in addition.

    Attributes:
        translation: share of the frame's side.
        zoom, squeeze: factors; a squeeze stretches x by the factor by which it shrinks y.
        rotation: radians.
        constant_rotation: the relative rotation is always the lower bound, as in the original (a slip).
        horizontal, vertical: flips, with probability 1/2 each.
        noise: largest standard deviation of the noise that is added, of values 0..1.
    """

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
    """ARFlow's (Liu et al., CVPR 2020).

    Attributes:
        census_from: share of the training after which the ternary census and the forward-backward check take the place
            of L1, SSIM and the check by splatting.
        smooth: weight of the smoothness.
        second_order: smoothness of second differences (KITTI), else of first ones (Sintel).
        self_supervision: weight of the second, transformed pass; 0 for none.
        appearance, spatial: its transforms.
    """

    kind: Literal["arflow"]
    census_from: float = Field(0.05, ge=0, le=1)
    smooth: float = Field(75.0, ge=0)
    second_order: bool = True
    self_supervision: float = Field(0.0, ge=0)
    appearance: Appearance = Appearance()
    spatial: Spatial = Spatial()


class UpflowObjective(Frozen):
    """UPFlow's (Luo et al., CVPR 2021).

    Attributes:
        photometric, census, smooth, distillation: weights.
        exponent: of the robust function (|x| + 0.01)^q.
        radius: of the census' window, pixels.
    """

    kind: Literal["upflow"]
    photometric: float = Field(1.0, ge=0)
    census: float = Field(1.0, ge=0)
    smooth: float = Field(1.0, ge=0)
    distillation: float = Field(1.0, ge=0)
    exponent: float = Field(0.4, gt=0)
    radius: int = Field(3, ge=1)


class BrightflowObjective(Frozen):
    """BrightFlow's (Marsal et al., WACV 2023).

    Attributes:
        census: weight of the census, over 7x7 windows.
        smooth: weight of the smoothness.
        second_order: smoothness of second differences (KITTI), else of first ones (Sintel, Chairs).
        occlusion: "brox", the forward-backward check, or "wang", splatting.
        self_supervision: weight at its end.
        self_supervision_from, self_supervision_to: shares of the training between which it rises from 0.
        border: pixels that the student of the self-supervision does not see, on each side.
        corrector: weight of the brightness corrector's own loss.
        corrector_from: share of the training after which the corrector learns.
        corrected_from: share after which the photometric loss uses it.
    """

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
