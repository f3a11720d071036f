"""Locate, download and verify the photographs of frost.

The photographs belong to the Python package `imagecorruptions` (Apache-2.0) and are not included in this package. The
following locations are searched in this order:

1. the folder given by the environment variable ROBUSTFLOW_FROST_DIR (if set, no other location is searched), 2. an
installed `imagecorruptions` or `imagecorruptions-imaug` package, which is never imported, 3. the user's cache (see
`robustflow.core.files`), 4. the package's wheel, whose photographs pip downloads once into that cache.

The SHA-256 of every file is verified each time it is read.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import sys
import tempfile
from importlib.util import find_spec
from pathlib import Path

from ...core.errors import AssetError
from ...core.files import cache_folder
from ...core.paths import user_path

FOLDER_VARIABLE = "ROBUSTFLOW_FROST_DIR"
WHEEL = "imagecorruptions==1.1.2"
_PIP_SECONDS = 600
PART = "frost"
"""Subfolder of the user's cache that contains the textures."""

TEXTURES: dict[str, str] = {
    "frost1.png": "ff9f907860bd7a835d459e32f9d588062b7f61ee267343cc7222b56753a14755",
    "frost2.png": "fe211a89b336999c207a852ce05818d4545d0b57c5beadd824b4cc9d9a9b6137",
    "frost3.png": "2d0d50b4a9bb213f38b024ef7768731bb83cc08d2f26b5766bbc167cdfa0e504",
    "frost4.jpg": "3f8b91ca1a9fa7167b09e773da53f5ae60d0a1fd88f02a783f6e328a72887f6e",
    "frost5.jpg": "5fc6a19df4a429ba68abdcc8f8a4278d4c9f81c9ccafd2c92ab0c8cf8992ebd2",
}
"""File names and SHA-256 hashes of the five textures, in the reference code's order."""

_REMEDY = (
    f"copy {', '.join(TEXTURES)} from the package imagecorruptions to a folder and set {FOLDER_VARIABLE} to its path, "
    f"or run `python -m pip install --no-deps {WHEEL}` while online"
)


def read_texture(slot: int) -> bytes:
    """Return the verified file content of texture `slot` (0 to 4)."""
    name = list(TEXTURES)[slot]
    named = os.environ.get(FOLDER_VARIABLE)
    for folder in [user_path(named)] if named else [*_installed_folders(), cache_folder(PART)]:
        content = _read(folder / name)
        if content is not None and _is_genuine(name, content):
            return content
        what = "not found" if content is None else f"not the photograph from {WHEEL}: its SHA-256 differs"
        if named:
            raise AssetError(folder / name, f"{what} ({FOLDER_VARIABLE}); {_REMEDY}")
        if content is not None:
            _say(f"{folder / name}: {what}; trying the next location")
    return _fetch(cache_folder(PART))[name]


def _installed_folders() -> list[Path]:
    spec = find_spec("imagecorruptions")
    return [Path(place) / "frost" for place in (spec.submodule_search_locations or ())] if spec else []


def _read(path: Path) -> bytes | None:
    try:
        return path.read_bytes()
    except OSError:
        return None


def _is_genuine(name: str, content: bytes) -> bool:
    return hashlib.sha256(content).hexdigest() == TEXTURES[name]


def _say(message: str) -> None:
    print(f"robustflow: {message}", file=sys.stderr, flush=True)


def _fetch(folder: Path) -> dict[str, bytes]:
    """Unpack the wheel in a temporary folder, move each of the five files to `folder` atomically, and return them."""
    _say(f"frost requires the photographs from {WHEEL}; downloading them with pip to {folder}")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix="fetch-", dir=folder) as temporary:
            _download(temporary)
            extracted = {name: Path(temporary, "imagecorruptions", "frost", name) for name in TEXTURES}
            contents = {name: _read(path) or b"" for name, path in extracted.items()}
            if wrong := [name for name, content in contents.items() if not _is_genuine(name, content)]:
                raise AssetError(WHEEL, f"its {wrong[0]} is missing or has the wrong SHA-256; {_REMEDY}")
            for name, path in extracted.items():
                os.replace(path, folder / name)
            return contents
    except OSError as error:
        raise AssetError(folder, f"cannot store frost textures ({error.strerror or error}); {_REMEDY}") from error


def _download(folder: str) -> None:
    """Download the wheel and unpack it in a folder, from which nothing is imported."""
    command = [sys.executable, "-I", "-m", "pip", "--no-input", "--disable-pip-version-check", "download", "--quiet"]
    command += ["--no-deps", "--only-binary=:all:", "--retries", "1", "--dest", folder, WHEEL]
    try:
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=_PIP_SECONDS, check=False)
    except subprocess.TimeoutExpired:
        raise AssetError(WHEEL, f"pip did not download it within {_PIP_SECONDS} s; {_REMEDY}") from None
    if done.returncode != 0:
        reasons = [line for line in done.stderr.splitlines() if line.startswith("ERROR")] or done.stderr.splitlines()
        reason = reasons[-1].strip() if reasons else f"exit status {done.returncode}"
        raise AssetError(WHEEL, f"pip could not download it ({reason}); {_REMEDY}")
    for wheel in Path(folder).glob("*.whl"):
        shutil.unpack_archive(wheel, folder, "zip")
