"""The five lenses that come with the package, and their rendered PSFs, checked by hash.

A stack is stored as float16 and as one half, columns 30 to 60, because a PSF of a centred lens is symmetric about
its meridional plane; `data/manifest.json` holds the SHA-256 of each lens and each stored half.
"""

from __future__ import annotations

import hashlib
import io
import json
import zipfile
from functools import lru_cache
from importlib import resources
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ..atomic import write_bytes, write_json
from ..corruptions.base import SEVERITIES, check_severity
from ..errors import DataError
from ..lenses.prescription import Lens, read_lens
from .psf_field import SIZE, PsfField

DATA = Path(str(resources.files(__package__))) / "data"
_MIDDLE = SIZE // 2


def shipped_lens(severity: int) -> Lens:
    """The lens of a severity.

    >>> shipped_lens(1).elements
    6
    """
    lens = read_lens(DATA / f"lens_s{check_severity(severity)}.json")
    _check(f"lens_s{severity}", lens_digest(lens))
    return lens


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
    _check(f"psf_s{severity}", half_digest(half))
    return PsfField(whole(half))


def halved(field: PsfField) -> npt.NDArray[np.float16]:
    """What is stored of a field: columns 30 to 60 as float16, (64, 3, 61, 31)."""
    return field.stack[..., _MIDDLE:].astype(np.float16)


def whole(half: npt.NDArray[np.float16]) -> npt.NDArray[np.float64]:
    """The stack (64, 3, 61, 61) of a stored half."""
    values = half.astype(np.float64)
    return np.concatenate([values[..., :0:-1], values], axis=-1)


def half_digest(half: npt.NDArray[np.float16]) -> str:
    """SHA-256 of a stored half, whatever the machine's byte order."""
    return hashlib.sha256(np.ascontiguousarray(half, "<f2").tobytes()).hexdigest()


def lens_digest(lens: Lens) -> str:
    """SHA-256 of a prescription's content, whatever the file's line ends."""
    return hashlib.sha256(lens.model_dump_json().encode()).hexdigest()


def ship(severity: int, lens: Lens, field: PsfField, folder: Path = DATA) -> None:
    """Write a lens, its PSFs and their hashes where the package finds them."""
    half = halved(field)
    buffer = io.BytesIO()
    np.savez_compressed(buffer, half=half.astype("<f2"))
    write_bytes(folder / f"lens_s{severity}.json", (lens.model_dump_json(indent=1) + "\n").encode())
    write_bytes(folder / f"psf_s{severity}.npz", buffer.getvalue())
    path = folder / "manifest.json"
    manifest = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    write_json(path, {**manifest, f"lens_s{severity}": lens_digest(lens), f"psf_s{severity}": half_digest(half)})


def manifest() -> dict[str, str]:
    """SHA-256 by name: lens_s1 .. lens_s5, psf_s1 .. psf_s5."""
    content: dict[str, str] = json.loads((DATA / "manifest.json").read_text(encoding="utf-8"))
    return content


def _check(name: str, digest: str) -> None:
    if manifest().get(name) != digest:
        raise DataError(
            f"'{name}' in {DATA} is not the file that was shipped (its SHA-256 differs); reinstall robustflow"
        )
