"""The cache: entries are created once, are complete or absent, and never exceed the limit."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np

from robustflow.core.errors import DataError
from robustflow.data.video.prepared import FolderCache
from tests.refusals import refusal


def make(folder: Path, size: int = 100) -> None:
    folder.mkdir()
    (folder / "data").write_bytes(b"x" * size)


def read(folder: Path) -> int:
    return len((folder / "data").read_bytes())


def test_an_entry_with_a_flipped_bit_is_made_again(tmp_path):
    cache, rng = FolderCache(tmp_path, 1000), np.random.default_rng(0)
    cache.use("a", make, read)
    for place, bit in zip(rng.integers(0, 100, 200), rng.integers(0, 8, 200), strict=True):
        flipped = bytearray(b"x" * 100)
        flipped[place] ^= 1 << bit
        (tmp_path / "a" / "data").write_bytes(flipped)
        cache.use("a", make, read)
        assert (tmp_path / "a" / "data").read_bytes() == b"x" * 100


def test_cache_entry_is_made_once_by_several_processes(tmp_path):
    code = f"""
import os, time
from pathlib import Path
from robustflow.data.video.prepared import FolderCache
root = Path({str(tmp_path)!r})
def slowly(folder):
    (root / f"made-{{os.getpid()}}").touch()
    time.sleep(0.3)
    folder.mkdir()
    (folder / "data").write_bytes(b"xyz")
print(FolderCache(root, 1000).use("a", slowly, lambda folder: (folder / "data").read_text()))
"""
    users = [subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) for _ in range(3)]
    assert [user.communicate(timeout=60)[0].strip() for user in users] == ["xyz"] * 3
    assert len(list(tmp_path.glob("made-*"))) == 1


def test_least_recently_used_cache_entry_is_deleted_first(tmp_path):
    cache = FolderCache(tmp_path, 450)
    for age, name in ((3, "a"), (2, "b"), (1, "c")):
        cache.use(name, make, read)
        os.utime(tmp_path / name, (1e9 - age, 1e9 - age))
    cache.use("a", make, read)  # now the most recently used entry
    cache.use("d", make, read)
    assert [entry.name for entry in cache.entries()] == ["a", "c", "d"]
    assert sum(file.stat().st_size for entry in cache.entries() for file in entry.iterdir()) <= 450


def test_failed_cache_entry_leaves_no_file(tmp_path):
    def fail(folder: Path) -> None:
        make(folder)
        raise DataError("cannot")

    cache = FolderCache(tmp_path, 1000)
    refusal(lambda: cache.use("a", fail, read), DataError, "")
    assert [path for path in tmp_path.iterdir() if path.is_dir()] == []
    assert cache.use("a", make, read) == 100


def test_lock_and_files_of_a_killed_process_are_cleared(tmp_path):
    code = f"""
import time
from pathlib import Path
from robustflow.data.video.prepared import FolderCache
def slowly(folder):
    print("making", flush=True)
    time.sleep(600)
FolderCache(Path({str(tmp_path)!r}), 1000).use("a", slowly, None)
"""
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "making\n"
        process.kill()
    make(tmp_path / ".making-b")
    for name in "ab":
        assert FolderCache(tmp_path, 1000).use(name, make, read) == 100


def test_cache_without_a_lock_is_refused_in_one_sentence(tmp_path):
    (tmp_path / ".a.lock").mkdir()
    refusal(lambda: FolderCache(tmp_path, 1000).use("a", make, read), DataError, tmp_path)
