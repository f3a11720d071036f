"""Load and verify the prescriptions of the five lenses in the package, and write new lenses to the package."""

from __future__ import annotations

import hashlib
import io
import json
from pathlib import Path

import numpy as np

from ..atomic import write_bytes, write_json
from ..psf import shipped as shipped_psfs
from ..psf.psf_field import PsfField
from ..psf.shipped import check_digest, half_digest, halved
from ..severity import check_severity
from .prescription import Lens, read_lens, write_lens


def shipped_lens(severity: int) -> Lens:
    """Return the prescription of the shipped lens for a severity."""
    lens = read_lens(shipped_psfs.DATA / f"lens_s{check_severity(severity)}.json")
    check_digest(f"lens_s{severity}", lens_digest(lens))
    return lens


def lens_digest(lens: Lens) -> str:
    """Return the SHA-256 of a prescription, regardless of the line endings in the file."""
    return hashlib.sha256(lens.model_dump_json().encode()).hexdigest()


def ship_lens(severity: int, lens: Lens, field: PsfField, folder: Path | None = None) -> None:
    """Write a lens, its PSFs and their hashes to the package's data folder."""
    folder = shipped_psfs.DATA if folder is None else folder
    half = halved(field)
    buffer = io.BytesIO()
    np.savez_compressed(buffer, half=half.astype("<f2"))
    write_lens(lens, folder / f"lens_s{severity}.json")
    write_bytes(folder / f"psf_s{severity}.npz", buffer.getvalue())
    path = folder / "manifest.json"
    manifest = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    write_json(path, {**manifest, f"lens_s{severity}": lens_digest(lens), f"psf_s{severity}": half_digest(half)})
