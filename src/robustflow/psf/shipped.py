"""The rendered PSFs of the five lenses that come with the package, checked by hash.

A stack is stored as float16 and as one half, columns 30 to 60, because a PSF of a centred lens is symmetric about
its meridional plane; `data/manifest.json` holds the SHA-256 of each lens and each stored half.
"""

from __future__ import annotations

import hashlib
import json
import zipfile
from functools import lru_cache
from importlib import resources
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ..errors import DataError
from ..severity import SEVERITIES, check_severity
from .psf_field import SIZE, PsfField

DATA = Path(str(resources.files(__package__))) / "data"
_MIDDLE = SIZE // 2


@lru_cache(maxsize=len(SEVERITIES))
def shipped_field(severity: int) -> PsfField:
    """The rendered PSFs of a severity's lens.

    Raises:
        DataError: the file is missing or is not the one the manifest names.
    """
    path = DATA / f"psf_s{check_severity(severity)}.npz"
    try:
        with np.load(path, allow_pickle=False) as archive:
            half = archive["half"]
    except (OSError, EOFError, KeyError, ValueError, zipfile.BadZipFile) as error:
        raise DataError(f"cannot read the PSFs {path}: {error}; reinstall robustflow") from error
    check_digest(f"psf_s{severity}", half_digest(half))
    return PsfField(whole(half))


def halved(field: PsfField) -> npt.NDArray[np.float16]:
    """The stored part of a field: columns 30 to 60 as float16, (64, 3, 61, 31)."""
    return field.stack[..., _MIDDLE:].astype(np.float16)


def whole(half: npt.NDArray[np.float16]) -> npt.NDArray[np.float64]:
    """The stack (64, 3, 61, 61) of a stored half."""
    values = half.astype(np.float64)
    return np.concatenate([values[..., :0:-1], values], axis=-1)


def half_digest(half: npt.NDArray[np.float16]) -> str:
    """SHA-256 of a stored half, whatever the machine's byte order."""
    return hashlib.sha256(np.ascontiguousarray(half, "<f2").tobytes()).hexdigest()


def manifest() -> dict[str, str]:
    """SHA-256 by name: lens_s1 .. lens_s5, psf_s1 .. psf_s5."""
    content: dict[str, str] = json.loads((DATA / "manifest.json").read_text(encoding="utf-8"))
    return content


def check_digest(name: str, digest: str) -> None:
    """Refuse what is not the file that the manifest names.

    Raises:
        DataError: another digest.
    """
    if manifest().get(name) != digest:
        raise DataError(
            f"'{name}' in {DATA} is not the file that was shipped (its SHA-256 differs); reinstall robustflow"
        )
