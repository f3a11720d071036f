"""Upload folders, and cleanup of folders left behind by a killed app.

A folder is locked while its app runs. The operating system releases the lock however the app ends, so the next app can
tell which folders are abandoned.
"""

from __future__ import annotations

import os
import secrets
import shutil
from pathlib import Path
from tempfile import gettempdir, mkdtemp

from filelock import FileLock, Timeout

PREFIX = "robustflow-app-"
_LOCK = ".lock"


class UploadFolder:
    """The folder of one app's uploads; `close` removes it."""

    def __init__(self) -> None:
        remove_abandoned()
        self.path = Path(gettempdir()) / f"{PREFIX}{secrets.token_hex(8)}"
        self._lock = FileLock(f"{self.path}{_LOCK}", blocking=False)
        self._lock.acquire()  # created before the folder, so that no other app considers the folder abandoned
        self.path.mkdir(mode=0o700)

    def new(self) -> Path:
        """Create an empty folder for one upload."""
        return Path(mkdtemp(dir=self.path))

    def close(self) -> None:
        """Remove all uploads."""
        shutil.rmtree(self.path, ignore_errors=True)
        self._lock.release()
        Path(self._lock.lock_file).unlink(missing_ok=True)


def remove_abandoned() -> None:
    """Remove this user's upload folders whose app is no longer running."""
    for lock_file in Path(gettempdir()).glob(f"{PREFIX}*{_LOCK}"):
        folder = lock_file.with_name(lock_file.name.removesuffix(_LOCK))
        try:
            if lock_file.lstat().st_uid != os.getuid() or lock_file.is_symlink() or folder.is_symlink():
                continue
            with FileLock(lock_file, blocking=False):
                shutil.rmtree(folder, ignore_errors=True)
                lock_file.unlink(missing_ok=True)
        except (Timeout, OSError):
            continue  # its app is running, or another app is removing it
