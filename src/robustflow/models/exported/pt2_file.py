"""Read a file of `torch.export.save` without running what it may hold.

`torch.export.load` itself must not be given a file of unknown origin. As of PyTorch 2.15 it unpickles weights and
constants that the file says are pickles, without `weights_only`; tries `weights_only` on the example inputs and then
does without; loads compiled libraries; evaluates size expressions as Python; executes the text of guards and of names;
and calls any function under `torch` that the graph names. So the archive is taken apart here, each part is held
against what a network's file needs, and PyTorch gets a new archive of those parts alone.
"""

from __future__ import annotations

import io
import json
import re
import warnings
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import torch

from ...errors import ModelError
from ..model_file import damaged, opened
from .pt2_expression import check_expression

_MODEL = "models/model.json"
_INPUTS = "data/sample_inputs/model.pt"
_CONFIGS = {
    "data/weights/model_weights_config.json": r"weight_\d+",
    "data/constants/model_constants_config.json": r"tensor_\d+",
}
_KEPT = re.compile(
    r"data/weights/weight_\d+|data/constants/tensor_\d+|archive_format|archive_version|byteorder|\.data/version"
)
_LEFT_OUT = re.compile(r"\.data/serialization_id|extra/.*|" + re.escape(_INPUTS))

_PLAIN = re.compile(r"[\w.+-]{0,1000}", re.ASCII)
_OPERATORS = re.compile(
    r"torch\.ops\.(aten\.(?!from_file)\w+|torchvision\.\w+)\.\w+"
    r"|torch\.ops\.higher_order\.(wrap_with_set_grad_enabled|wrap_with_autocast|cond|while_loop)"
    r"|torch\.sym_(int|float|max|min|not|ite|sum|sqrt)"
    r"|_operator\.(add|sub|mul|truediv|floordiv|mod|pow|neg|pos|eq|ne|lt|le|gt|ge|and_|or_|not_|getitem)"
    r"|math\.(ceil|floor|trunc|sqrt)",
    re.ASCII,
)
_CONTAINERS = (None, "builtins.tuple", "builtins.list", "builtins.dict")


class _RefusedError(Exception):
    """What a part of the file is or does that no network's file needs."""


def read_exported_program(path: Path, sha256: str | None = None) -> tuple[torch.export.ExportedProgram, str]:
    """The program of a `.pt2` file, and the file's SHA-256.

    Args:
        path: the file.
        sha256: the hash it must have, or the first eight or more digits of it.

    Raises:
        ModelError: missing, damaged, not a file of `torch.export.save`, or holding more than operators and weights.
        UsageError: `sha256` is not such digits.
    """
    with opened(path, sha256) as (file, digest):
        content = file.read()
    try:
        clean = _rebuilt(content)
    except _RefusedError as error:
        raise ModelError(
            f"{path}: refused, and nothing in it was run: {error}; export the network with torch.export.save, by the "
            "PyTorch that is installed here"
        ) from None
    except (zipfile.BadZipFile, NotImplementedError, ValueError, RecursionError) as error:
        raise damaged(path, error) from None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return torch.export.load(io.BytesIO(clean)), digest
    except Exception as error:  # PyTorch has no error class of its own for a file that contradicts itself
        raise damaged(path, error) from None


def _rebuilt(content: bytes) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(content)) as archive, zipfile.ZipFile(out, "w") as rebuilt:
        entries = archive.infolist()
        if sum(entry.file_size for entry in entries) > len(content):
            raise _RefusedError("it would unpack to more than its size, and genuine ones are not compressed")
        names = [entry.filename.partition("/")[2] for entry in entries]
        if _MODEL not in names or len(set(names)) != len(names):
            raise _RefusedError("it is not a complete file of torch.export.save")
        for entry, name in zip(entries, names, strict=True):
            if _LEFT_OUT.fullmatch(name):
                continue
            data = archive.read(entry)
            if name == _MODEL:
                data = _checked_model(data)
            elif name in _CONFIGS:
                data = _checked_config(data, _CONFIGS[name])
            elif not _KEPT.fullmatch(name):
                raise _RefusedError(f"it holds '{name[:100]}', which is neither its graph nor a tensor")
            rebuilt.writestr(f"model/{name}", data)
        rebuilt.writestr(f"model/{_INPUTS}", b"")
    return out.getvalue()


def _checked_config(data: bytes, pattern: str) -> bytes:
    config = json.loads(data)
    for entry in config["config"].values() if isinstance(config, dict) else ():
        if entry.get("use_pickle") is not False or not re.fullmatch(pattern, str(entry.get("path_name"))):
            raise _RefusedError("it holds a pickle in the place of a tensor")
    _check_all(config)
    return json.dumps(config).encode()


def _checked_model(data: bytes) -> bytes:
    model = json.loads(data)
    for node in _objects(model):
        if "metadata" in node:
            node["metadata"] = {}  # where each operator came from in its author's source
        if "guards_code" in node:
            node["guards_code"] = []  # Python text; the sizes are checked by the operators as they run
    _check_all(model)
    return json.dumps(model).encode()


def _objects(value: Any) -> Iterator[dict[str, Any]]:
    if isinstance(value, dict):
        yield value
    for part in value.values() if isinstance(value, dict) else value if isinstance(value, list) else ():
        yield from _objects(part)


def _check_all(value: Any) -> None:
    """Every text in the file is plain words, or a kind of text that is checked by its own rule."""
    for node in _objects(value):
        for key, held in node.items():
            if not check_expression(key):  # a size is also a key, of the range it may have
                _check_plain(key)
            for text in held if isinstance(held, list) else [held]:
                if isinstance(text, str):
                    _RULES.get(key, _check_plain)(text)


def _check_plain(text: str) -> None:
    if not _PLAIN.fullmatch(text):
        raise _RefusedError(f"it holds the text {text[:60]!r} where names are expected")


def _check_operator(text: str) -> None:
    if not _OPERATORS.fullmatch(text) or any(part.startswith("__") for part in text.split(".")):
        raise _RefusedError(f"its graph calls '{text[:100]}'")


def _check_size(text: str) -> None:
    if not check_expression(text):
        raise _RefusedError(f"it holds the size {text[:60]!r}")


def _check_structure(text: str) -> None:
    """How inputs or outputs are nested: JSON, by a protocol's number."""
    for node in _objects(json.loads(text)):
        names = json.loads(node.get("context") or "null")
        if node.get("type") not in _CONTAINERS or any(
            not isinstance(name, str) for name in (names if isinstance(names, list) else [names] * (names is not None))
        ):
            raise _RefusedError("its inputs or outputs are more than lists and dictionaries of tensors")


_RULES: dict[str, Callable[[str], None]] = {
    "target": _check_operator,
    "expr_str": _check_size,
    "in_spec": _check_structure,
    "out_spec": _check_structure,
}
