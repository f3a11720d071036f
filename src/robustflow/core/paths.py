"""Find a dataset's folders and files, or report the expected layout; reject links in folders that this program writes
but that may be untrusted: through a link, files elsewhere would be read, replaced or deleted.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from itertools import islice, pairwise
from pathlib import Path

from .errors import DataError, RunError, UsageError

VIDEO_SUFFIXES = (".mp4", ".m4v", ".mov", ".mkv", ".avi", ".webm", ".mpg", ".mpeg", ".ts")
"""File extensions of video files."""

_LOOK_AT = 500
"""Maximum number of folder entries that are searched for a hint; a home folder may contain many."""


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


def refuse_backslashes(folder: Path) -> None:
    """Raise if names in a folder contain backslashes: an archive made on Windows was unpacked without its folders."""
    with suppress(OSError), os.scandir(folder) as entries:
        name = min((entry.name for entry in islice(entries, _LOOK_AT) if "\\" in entry.name), default=None)
        if name is not None:
            raise DataError(
                folder / name,
                "the backslashes in its name separate folders of an archive made on Windows, which were not created; "
                "unpack the archive again with unzip or 7-Zip",
            )


def user_path(path: str | Path) -> Path:
    """Return a path from the user with `~` expanded to the home folder."""
    if path == "":
        raise UsageError("a path is empty, which would be the working folder; give the path of a file or folder")
    try:
        expanded = Path(path).expanduser()
        expanded.exists()
    except RuntimeError as error:
        raise DataError(path, "there is no such user; write out the full path") from error
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or str(error)
        raise DataError(f"{str(path)[:60]}...", f"not a valid path ({why}); correct it") from error
    return expanded


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


def folders(parent: Path) -> list[Path]:
    """Return the folders inside `parent`, sorted by name, without hidden ones; an empty list if `parent` does not
    exist."""
    if not parent.is_dir():
        return []
    return sorted(path for path in parent.iterdir() if path.is_dir() and not path.name.startswith("."))


def _holds(folder: Path, markers: Sequence[str]) -> bool:
    return any(path.is_dir() for marker in markers for path in folder.glob(marker))


def _neighbours(root: Path) -> Iterator[Path]:
    for child in _inside(root):
        yield child
        yield from _inside(child)
    yield from list(root.resolve().parents)[:3]


def _inside(folder: Path) -> list[Path]:
    try:
        return [path for path in islice(folder.iterdir(), _LOOK_AT) if path.is_dir()]
    except OSError:  # no hint from a folder that cannot be listed
        return []


def refuse_links(folder: Path, *inside: str) -> None:
    """Raise if a folder, or one of the folders `inside` it, contains a link, a pipe or a device. The folder itself may
    be a link.

    >>> from tempfile import mkdtemp
    >>> folder = Path(mkdtemp())
    >>> (folder / "clean").symlink_to("/usr")
    >>> refuse_links(folder, "clean")  # doctest: +ELLIPSIS
    Traceback (most recent call last):
    robustflow.core.errors.RunError: .../clean: ...
    """
    for place in (folder, *(folder / name for name in inside)):
        with suppress(FileNotFoundError, NotADirectoryError, PermissionError), os.scandir(place) as entries:
            for entry in entries:
                if not (entry.is_file(follow_symlinks=False) or entry.is_dir(follow_symlinks=False)):
                    what = "a link" if entry.is_symlink() else "neither a file nor a folder"
                    raise RunError(
                        entry.path,
                        f"is {what}; the contents of this folder are read, replaced and deleted, so it "
                        "may contain only files and folders: replace it with the file or folder itself, or delete it",
                    )
