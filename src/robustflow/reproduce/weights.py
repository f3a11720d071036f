"""Which of the checkpoints that the paper's variants need lie in a folder: by the catalogue's hashes, or by name."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from ..digest import sha256_of_file
from ..errors import DataError
from ..models.catalog import CheckpointEntry, checkpoints

SUFFIXES = (".ckpt", ".pth", ".pt", ".tar")
"""Endings of files that can be checkpoints."""
_TRAINED = "last"
"""What `robustflow train` calls the weights at its end; the name of their folder counts."""


@dataclass(frozen=True)
class FoundWeights:
    """A file of a folder of checkpoints.

    Attributes:
        path: where it is.
        sha256: the first eight digits of its hash.
        entry: what the catalogue knows it as; None for a file that it does not know.
        claim: what its name says that it is, "raft-ood"; compared with `Variant.slug`.
        altered: the catalogue's entry of this name, whose hash the file does not have.
    """

    path: Path
    sha256: str
    entry: CheckpointEntry | None
    claim: str
    altered: CheckpointEntry | None = None


def weights_in(folders: Sequence[Path]) -> list[FoundWeights]:
    """The files of folders, and of the folders in them, that can be checkpoints; in the order of their paths.

    Every file is hashed: a checkpoint of the catalogue is known by its content whatever it is called. Nothing in a file
    is read as anything but bytes.

    Raises:
        DataError: no such folder, or a file that cannot be read.
    """
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
        folder = folder.expanduser()
        if not folder.is_dir():
            raise DataError(f"{folder}: no such folder; name the one that holds the checkpoints")
        yield from sorted(path for path in folder.rglob("*") if path.suffix.lower() in SUFFIXES and path.is_file())


def _sha256(path: Path) -> str:
    try:
        return sha256_of_file(path)
    except OSError as error:
        raise DataError(
            f"{path}: cannot be read ({error.strerror}); move it out of the folder of checkpoints"
        ) from error
