"""What an ONNX file says that onnxruntime does not: what its operators read, which files hold its larger weights."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ...digest import sha256_of_file
from ...errors import ModelError
from ..model_file import damaged


def parsed(path: Path, content: bytes) -> Any:
    """The message that an ONNX file is.

    Raises:
        ModelError: no ONNX network.
    """
    import onnx

    try:
        model = onnx.load_from_string(content)
    except Exception as error:  # protobuf's own, and whatever a hostile file makes it raise
        raise damaged(path, error) from None
    if not model.graph.node:
        raise ModelError(f"{path}: not an ONNX network (it has no operators); export it with torch.onnx.export")
    return model


def read_inputs(model: Any) -> set[str]:
    """What the operators of a network read, those of branches included, and outputs."""
    import onnx

    return {name for node in _messages(model, onnx.NodeProto) for name in node.input} | {
        entry.name for entry in model.graph.output
    }


def external_files(path: Path, model: Any) -> dict[str, str]:
    """The SHA-256 of every file of weights that an ONNX file names, by its name there.

    Args:
        path: of the ONNX file.
        model: from `parsed`.

    Raises:
        ModelError: it names a file that is missing or outside its own folder.
    """
    import onnx

    names = {
        entry.value
        for tensor in _messages(model, onnx.TensorProto)
        if tensor.data_location == onnx.TensorProto.EXTERNAL
        for entry in tensor.external_data
        if entry.key == "location"
    }
    return {name: _weights_sha256(path, name) for name in sorted(names)}


def _messages(message: Any, kind: type) -> Iterator[Any]:
    """Every message of a kind in another, however deep: tensors of initializers and attributes, nodes of branches."""
    if isinstance(message, kind):
        yield message
    for field, value in message.ListFields():
        if field.message_type is not None:
            for part in value if field.is_repeated else (value,):
                yield from _messages(part, kind)


def _weights_sha256(path: Path, name: str) -> str:
    folder = path.resolve().parent
    file = (folder / name).resolve()
    if not name or not file.is_relative_to(folder):
        raise ModelError(
            f"{path}: refused: it takes weights from '{name[:200]}', outside its own folder; get the genuine file, or "
            "save it again with its weights beside it"
        )
    if file.exists() and not file.is_file():  # a pipe would never end, a device never answer
        raise ModelError(f"{path}: refused: its weights '{name[:200]}' are not a regular file; get the genuine file")
    try:
        return sha256_of_file(file)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise ModelError(
            f"{path}: its weights '{name[:200]}' cannot be read ({reason}); put that file beside it"
        ) from None
