"""Load the calibrated severity scale, i.e. the table written by `bench/calibrated_severities.py`.

According to the paper, its severities are not comparable across corruptions. On the calibrated scale, they are
comparable in terms of SSIM: at severity s, every corruption has the same mean SSIM to the clean image. If a corruption
cannot reach a severity, the severity does not exist on the scale and is not replaced.
"""

from __future__ import annotations

import os
from functools import lru_cache
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationError, model_validator

from ..core.arguments import SEVERITIES
from ..core.errors import DataError, first_misfit
from ..core.files import digest_of_bytes, unsealed
from ..core.paths import user_path
from ..core.types import FrozenFinite

CALIBRATION_VARIABLE = "ROBUSTFLOW_CALIBRATION"
"""Environment variable that specifies a table to use instead of the shipped table."""

Similarity = Annotated[float, Field(ge=-1.0, le=1.0)]
_Number = bool | int | float


class Level(FrozenFinite):
    parameter: _Number | tuple[_Number, ...] | None
    ssim: Similarity


class CalibratedCorruption(FrozenFinite):
    """Calibration of one corruption: its five levels and the lowest and highest mean SSIM on its path."""

    reachable: tuple[Similarity, Similarity]
    levels: Annotated[tuple[Level, ...], Field(min_length=5, max_length=5)]


class CalibrationTable(FrozenFinite):
    """The calibration table and everything needed to reproduce it."""

    version: Literal[2]
    method: str
    seed: int
    draws: Annotated[int, Field(ge=1)]
    images: dict[str, str]
    targets: Annotated[tuple[Similarity, ...], Field(min_length=5, max_length=5)]
    tolerance: Annotated[float, Field(gt=0)]
    corruptions: dict[str, CalibratedCorruption]

    @model_validator(mode="after")
    def _consistent(self) -> CalibrationTable:
        if sorted(self.targets, reverse=True) != list(self.targets):
            raise ValueError("the targets must decrease from severity 1 to 5")
        for name, calibrated in self.corruptions.items():
            for level, target in zip(calibrated.levels, self.targets, strict=True):
                if level.parameter is not None and abs(level.ssim - target) > self.tolerance:
                    raise ValueError(f"{name} has a mean SSIM of {level.ssim}, but {target} was expected")
        return self


def read_table(path: Path) -> CalibrationTable:
    try:
        content = unsealed(path.read_bytes())
    except OSError as error:
        raise DataError(path, f"cannot be read ({error.strerror}); check the path of the calibration table") from error
    if content is None:
        raise DataError(
            path,
            "not a calibration table, or its digest differs; make one with bench/calibrated_severities.py",
        )
    try:
        return CalibrationTable.model_validate_json(content)
    except ValidationError as error:
        raise DataError(
            path, f"not a calibration table ({first_misfit(error)}); create one with bench/calibrated_severities.py"
        ) from error


def shipped() -> CalibrationTable:
    return _cached(Path(str(resources.files(__package__))) / "data" / "calibrated.json")


def calibration() -> CalibrationTable:
    """Return the table specified by `ROBUSTFLOW_CALIBRATION`, or the shipped table if it is not set."""
    chosen = os.environ.get(CALIBRATION_VARIABLE)
    return _cached(user_path(chosen)) if chosen else shipped()


@lru_cache(maxsize=2)
def _cached(path: Path) -> CalibrationTable:
    return read_table(path)


def calibrated_severities(name: str) -> tuple[Any, ...]:
    """Return the five parameters for a corruption; None marks severities that do not exist on this scale."""
    calibrated = calibration().corruptions.get(name)
    return tuple(level.parameter for level in calibrated.levels) if calibrated else (None,) * len(SEVERITIES)


def calibrated_levels(name: str) -> tuple[int, ...]:
    """Return the severities at which a corruption exists on this scale."""
    return tuple(s for s, value in zip(SEVERITIES, calibrated_severities(name), strict=True) if value is not None)


def calibration_digest() -> str:
    """Return a hash of the table (16 hexadecimal digits), used in the identity of a run."""
    return digest_of_bytes(calibration().model_dump_json().encode(), size=8)
