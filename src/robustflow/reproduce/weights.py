"""Find the checkpoints of the paper's variants in a folder, by the catalogue's hashes or by name."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from ..digest import sha256_of_file
from ..errors import DataError
from ..layout import user_path
from ..models.catalog import CheckpointEntry, checkpoints

SUFFIXES = (".ckpt", ".pth", ".pt", ".tar")
"""File extensions of checkpoints."""
_TRAINED = "last"
"""File name of the final weights of `robustflow train`; the name of their folder identifies the variant."""


@dataclass(frozen=True)
class FoundWeights:
    """A file in a checkpoint folder."""

    path: Path
    sha256: str
    entry: CheckpointEntry | None
    claim: str
    altered: CheckpointEntry | None = None


def weights_in(folders: Sequence[Path]) -> list[FoundWeights]:
    """Return the possible checkpoint files in folders and their subfolders, sorted by path."""
    known = {entry.sha256: entry for entry in checkpoints()}
    by_name = {entry.file: entry for entry in checkpoints()}
    weights = []
    for path in _files(folders):
        digits = _sha256(path)[:8]
        entry = known.get(digits)
        named = by_name.get(path.name)
        claim = path.parent.name if path.stem == _TRAINED else path.stem
        weights.append(FoundWeights(path, digits, entry, claim.lower(), named if entry is None else None))
    return weights


def _files(folders: Sequence[Path]) -> Iterator[Path]:
    for folder in folders:
        folder = user_path(folder)
        if not folder.is_dir():
            raise DataError(f"{folder}: no such folder; give the folder that contains the checkpoints")
        yield from sorted(path for path in folder.rglob("*") if path.suffix.lower() in SUFFIXES and path.is_file())


def _sha256(path: Path) -> str:
    try:
        return sha256_of_file(path)
    except OSError as error:
        raise DataError(f"{path} cannot be read ({error.strerror}); move it out of the checkpoint folder") from error
