"""Reject links in folders that this program writes but that may be untrusted: through a link, files elsewhere would be
read, replaced or deleted."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

from .errors import RunError


def refuse_links(folder: Path, *inside: str) -> None:
    """Raise if a folder, or one of the folders `inside` it, contains a link, a pipe or a device. The folder itself may
    be a link.

    >>> from tempfile import mkdtemp
    >>> folder = Path(mkdtemp())
    >>> (folder / "clean").symlink_to("/usr")
    >>> refuse_links(folder, "clean")  # doctest: +ELLIPSIS
    Traceback (most recent call last):
    robustflow.errors.RunError: .../clean is a link; ...
    """
    for place in (folder, *(folder / name for name in inside)):
        with suppress(FileNotFoundError, NotADirectoryError, PermissionError), os.scandir(place) as entries:
            for entry in entries:
                if not (entry.is_file(follow_symlinks=False) or entry.is_dir(follow_symlinks=False)):
                    what = "a link" if entry.is_symlink() else "neither a file nor a folder"
                    raise RunError(
                        f"{entry.path} is {what}; the contents of this folder are read, replaced and deleted, so it "
                        "may contain only files and folders: replace it with the file or folder itself, or delete it"
                    )
