"""Read a TorchScript file as untrusted as it is.

TorchScript has its own language, interpreter and reader of pickles, none of which can reach Python. Two of its
operators can reach files (`from_file`, which maps one and may change it, and `save`), so a program that has them is
refused before it is read, and so are operators of libraries. PyTorch gets a new archive of the parts that were looked
at. More than that PyTorch does not promise: its advice is to run a model that nobody vouches for in a sandbox.
"""

from __future__ import annotations

import io
import re
import warnings
import zipfile
from pathlib import Path

import torch

from ...errors import ModelError
from ..model_file import damaged, opened

_CODE_LIMIT = 2**26
"""Bytes. Code is the only part that is compressed, and no network has so much."""
_REACHES_OUT = re.compile(
    rb"\b(from_file|save)\b|getattr\([^)\n]*\\|(?<![\w.])ops\s*\.(?!\s*(?:aten|prim|torchvision)\b)\s*\w*", re.ASCII
)


def read_torchscript(path: Path, sha256: str | None = None) -> tuple[torch.jit.ScriptModule, str]:
    """The program of a file of `torch.jit.save`, on the CPU, and the file's SHA-256.

    Args:
        path: the file.
        sha256: the hash it must have, or the first eight or more digits of it.

    Raises:
        ModelError: missing, damaged, a pickled module, or a program that reaches for files.
        UsageError: `sha256` is no such digits.
    """
    with opened(path, sha256) as (file, digest):
        content = file.read()
    try:
        clean = _rebuilt(path, content)
    except (zipfile.BadZipFile, NotImplementedError, ValueError) as error:
        if content.startswith(b"PK"):
            raise damaged(path, error) from None
        raise _no_program(path) from None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return torch.jit.load(io.BytesIO(clean), map_location="cpu"), digest
    except Exception as error:  # PyTorch has no error class of its own for a file that contradicts itself
        raise damaged(path, error) from None


def _rebuilt(path: Path, content: bytes) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(content)) as archive, zipfile.ZipFile(out, "w") as rebuilt:
        entries = archive.infolist()
        if sum(entry.file_size for entry in entries) > len(content) + _CODE_LIMIT:
            raise _refused(path, "it would unpack to far more than its size")
        names = [entry.filename.partition("/")[2] for entry in entries]
        if len(set(names)) != len(names):
            raise _refused(path, "two of its parts have one name")
        if "constants.pkl" not in names or not any(name.startswith("code/") for name in names):
            raise _no_program(path)
        for entry, name in zip(entries, names, strict=True):
            data = archive.read(entry)
            found = _REACHES_OUT.search(data) if name.startswith("code/") and name.endswith(".py") else None
            if found:
                raise _refused(path, f"its program uses '{found[0].decode(errors='replace')[:60]}'")
            rebuilt.writestr(f"model/{name}", data)
    return out.getvalue()


def _refused(path: Path, reason: str) -> ModelError:
    return ModelError(
        f"{path}: refused, and nothing in it was run: {reason}, which no network of frames needs; export it anew"
    )


def _no_program(path: Path) -> ModelError:
    return ModelError(
        f"{path}: is no TorchScript program, and a module pickled by torch.save is never loaded, because it may run "
        "code; export the network with torch.jit.trace(net, (image1, image2)).save(path)"
    )
