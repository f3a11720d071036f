"""Find a dataset's folders and files, or report the expected layout."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import islice, pairwise
from pathlib import Path

from ...core.errors import DataError
from ...core.paths import LOOK_AT, refuse_backslashes, user_path


def locate(
    title: str, root: str | Path, markers: Sequence[str], prefixes: Sequence[str] = ("",), expected: str = ""
) -> Path:
    """Return the folder that contains one of `markers` (relative folders): `root` itself or one of its `prefixes`."""
    root = user_path(root)
    layout = expected or " and ".join(f"{marker}/" for marker in markers)
    if not root.exists():
        raise DataError(root, f"no such folder; give the folder of {title} that contains {layout}")
    if not root.is_dir():
        if root.suffix.lower() in (".zip", ".tar", ".gz", ".tgz", ".7z", ".rar"):
            raise DataError(
                root, f"this is an archive; unpack it, and give the folder of {title} that contains {layout}"
            )
        raise DataError(root, f"not a folder; give the folder of {title} that contains {layout}")
    try:
        for folder in (root / prefix for prefix in prefixes):
            if _holds(folder, markers):
                return folder
        near = next((f for f in _neighbours(root) if any(_holds(f / p, markers) for p in prefixes)), None)
        empty = next(root.iterdir(), None) is None
        refuse_backslashes(root)
    except OSError as error:
        raise DataError(root, f"cannot be listed ({error.strerror or error}); check its permissions") from error
    hint = f"; did you mean {near}?" if near else "; check the path, or unpack the dataset into it"
    state = "the folder is empty; expected" if empty else f"not laid out like {title}; expected"
    raise DataError(root, f"{state} {layout}{hint}")


def _holds(folder: Path, markers: Sequence[str]) -> bool:
    return any(path.is_dir() for marker in markers for path in folder.glob(marker))


def _neighbours(root: Path) -> Iterator[Path]:
    for child in _inside(root):
        yield child
        yield from _inside(child)
    yield from list(root.resolve().parents)[:3]


def _inside(folder: Path) -> list[Path]:
    try:
        return [path for path in islice(folder.iterdir(), LOOK_AT) if path.is_dir()]
    except OSError:  # no hint from a folder that cannot be listed
        return []


def consecutive(frames: Mapping[int, Path], stride: int | None = 1) -> list[tuple[int, int]]:
    """Return pairs of neighbouring frame numbers."""
    numbers = sorted(frames)
    gaps = [after - before for before, after in pairwise(numbers)]
    stride = stride or min(gaps, default=1)
    for before, gap in zip(numbers, gaps, strict=False):
        if gap != stride:
            raise DataError(
                frames[before].parent,
                f"with a stride of {stride}, the frame after {frames[before].name} is "
                "missing; restore it, or move the frames after the gap into a separate folder",
            )
    return list(pairwise(numbers))


def partner(path: Path, whose: Path) -> Path:
    """Return `path`; if the file is missing, raise a DataError that names it and `whose`, the item it belongs to."""
    if not path.is_file():
        raise DataError(path, f"missing, but required by {whose}; restore the file or remove the rest of the pair")
    return path
