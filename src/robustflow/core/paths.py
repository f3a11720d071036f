"""Paths from the user; links are refused in folders that this program writes but that may be untrusted, because through
a link, files elsewhere would be read, replaced or deleted.
"""

from __future__ import annotations

import os
from contextlib import suppress
from itertools import islice
from pathlib import Path

from .errors import DataError, RunError, UsageError

VIDEO_SUFFIXES = (".mp4", ".m4v", ".mov", ".mkv", ".avi", ".webm", ".mpg", ".mpeg", ".ts")
"""File extensions of video files."""

LOOK_AT = 500
"""Maximum number of folder entries that are searched for a hint; a home folder may contain many."""


def refuse_backslashes(folder: Path) -> None:
    """Raise if names in a folder contain backslashes: an archive made on Windows was unpacked without its folders."""
    with suppress(OSError), os.scandir(folder) as entries:
        name = min((entry.name for entry in islice(entries, LOOK_AT) if "\\" in entry.name), default=None)
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


def folders(parent: Path) -> list[Path]:
    """Return the folders inside `parent`, sorted by name, without hidden ones; an empty list if `parent` does not
    exist."""
    if not parent.is_dir():
        return []
    return sorted(path for path in parent.iterdir() if path.is_dir() and not path.name.startswith("."))


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
