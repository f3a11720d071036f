"""Load and verify the rendered PSFs of the five lenses in the package.

Only half of each stack (columns 30 to 60) is stored, as float16, because a PSF of a centred lens is symmetric about its
meridional plane. `data/manifest.json` contains the SHA-256 of each lens and each stored half.
"""

from __future__ import annotations

import hashlib
import json
from functools import lru_cache
from importlib import resources
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ..errors import DataError
from ..flowio.arrays import DAMAGE
from ..severity import SEVERITIES, check_severity
from .psf_field import SIZE, PsfField

DATA = Path(str(resources.files(__package__))) / "data"
RMS_RADII = (0.0273, 0.0776, 0.1021, 0.1508, 0.1864)
"""Mean RMS radius of each lens over the field and the colours, in mm; 4 to 8 % below those in the paper."""
_MIDDLE = SIZE // 2


@lru_cache(maxsize=len(SEVERITIES))
def shipped_field(severity: int) -> PsfField:
    """Return the rendered PSFs of the lens for a severity."""
    path = DATA / f"psf_s{check_severity(severity)}.npz"
    try:
        with np.load(path, allow_pickle=False) as archive:
            half = archive["half"]
    except (OSError, *DAMAGE) as error:
        raise DataError(f"cannot read the PSFs {path}: {error}; reinstall robustflow") from error
    check_digest(f"psf_s{severity}", half_digest(half))
    return PsfField(whole(half))


def halved(field: PsfField) -> npt.NDArray[np.float16]:
    """Return the half of a field that is stored: columns 30 to 60, float16 (64, 3, 61, 31)."""
    return field.stack[..., _MIDDLE:].astype(np.float16)


def whole(half: npt.NDArray[np.float16]) -> npt.NDArray[np.float64]:
    """Restore the full stack (64, 3, 61, 61) from a stored half."""
    values = half.astype(np.float64)
    return np.concatenate([values[..., :0:-1], values], axis=-1)


def half_digest(half: npt.NDArray[np.float16]) -> str:
    """Return the SHA-256 of a stored half, regardless of the machine's byte order."""
    return hashlib.sha256(np.ascontiguousarray(half, "<f2").tobytes()).hexdigest()


def manifest() -> dict[str, str]:
    """Return the SHA-256 hashes by name: lens_s1 to lens_s5 and psf_s1 to psf_s5."""
    content: dict[str, str] = json.loads((DATA / "manifest.json").read_text(encoding="utf-8"))
    return content


def check_digest(name: str, digest: str) -> None:
    """Check that a digest matches the manifest."""
    if manifest().get(name) != digest:
        raise DataError(f"'{name}' in {DATA} is not the shipped file (its SHA-256 differs); reinstall robustflow")
