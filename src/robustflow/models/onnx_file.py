"""What lies beside an ONNX file: the files that hold its larger weights."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ..errors import ModelError
from .model_file import damaged


def external_files(path: Path, content: bytes) -> dict[str, str]:
    """The SHA-256 of every file of weights that an ONNX file names, by its name there.

    Args:
        path: of the ONNX file.
        content: of it.

    Raises:
        ModelError: no ONNX network, or it names a file that is missing or outside its own folder.
    """
    import onnx

    try:
        model = onnx.load_from_string(content)
    except Exception as error:  # protobuf's own, and whatever a hostile file makes it raise
        raise damaged(path, error) from None
    if not model.graph.node:
        raise ModelError(f"{path}: is no ONNX network (it has no operators); export the network with torch.onnx.export")
    names = {
        entry.value
        for tensor in _tensors(model)
        if tensor.data_location == onnx.TensorProto.EXTERNAL
        for entry in tensor.external_data
        if entry.key == "location"
    }
    return {name: _digest(path, name) for name in sorted(names)}


def _tensors(message: Any) -> Iterator[Any]:
    """Every tensor in a message, however deep: initializers, attributes, branches, functions."""
    import onnx

    if isinstance(message, onnx.TensorProto):
        yield message
        return
    for field, value in message.ListFields():
        if field.message_type is not None:
            for part in value if field.is_repeated else (value,):
                yield from _tensors(part)


def _digest(path: Path, name: str) -> str:
    folder = path.resolve().parent
    file = (folder / name).resolve()
    if not name or not file.is_relative_to(folder):
        raise ModelError(
            f"{path}: refused: it takes weights from '{name[:200]}', outside its own folder; get the genuine file, or "
            "save it anew with its weights beside it"
        )
    try:
        with file.open("rb") as weights:
            return hashlib.file_digest(weights, "sha256").hexdigest()
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise ModelError(
            f"{path}: its weights '{name[:200]}' cannot be read ({reason}); put that file beside it"
        ) from None
