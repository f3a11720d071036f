"""Check a file of tensors before PyTorch reads it: only what a state dict needs, at a cost that its size bounds.

PyTorch's `weights_only` runs no code, but calls `bytearray` with any number, and hashes nested tuples for as long as it
takes. The scan follows the opcodes without calling anything.
"""

from __future__ import annotations

import io
import pickletools
import zipfile
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, BinaryIO

LARGEST = 4 * 2**20
"""Maximum size of a pickle, bytes; the tensors are stored outside it, and one entry takes about 150 bytes."""

_DEEPEST = 100
_MOST_SHARED = 16
"""Maximum number of parts, counted as often as they are reached, per byte of the pickle."""

IGNORED = ("numpy.core.multiarray.scalar", "numpy._core.multiarray.scalar", "numpy.dtype", "argparse.Namespace")
"""Objects that training scripts store with the weights: the best error, the learning rate, the command line. They are
replaced by placeholders."""

_STORAGES = tuple(
    f"torch.{kind}Storage"
    for kind in (
        *("Float", "Double", "Half", "BFloat16", "Long", "Int", "Short", "Char", "Byte", "Bool"),
        *("ComplexFloat", "ComplexDouble"),
    )
)
_DTYPES = tuple(
    f"torch.{kind}"
    for kind in (
        *("float16", "bfloat16", "float32", "float64", "complex64", "complex128"),
        *("bool", "uint8", "int8", "int16", "int32", "int64"),
    )
)
_REBUILT = ("torch._utils._rebuild_tensor", "torch._utils._rebuild_tensor_v2")
_CALLED = {
    "collections.OrderedDict": "dict",
    "collections.Counter": "dict",
    "torch._utils._rebuild_parameter": "object",
    "torch.Size": "object",
    "torch.device": "object",
    "_codecs.encode": "object",
    **dict.fromkeys(_REBUILT, "object"),
    **dict.fromkeys(IGNORED, "ignored"),
}
"""Kinds of the results of the functions that a file may call."""

_CONSTANTS = {
    *("BININT", "BININT1", "BININT2", "LONG1", "BINFLOAT", "BINUNICODE", "SHORT_BINSTRING"),
    *("NONE", "NEWTRUE", "NEWFALSE"),
}
_EMPTY = {"EMPTY_TUPLE": "tuple", "EMPTY_LIST": "list", "EMPTY_DICT": "dict"}
_TUPLES = {"TUPLE1": 1, "TUPLE2": 2, "TUPLE3": 3}
_ADDED = {"APPEND": 1, "SETITEM": 2, "APPENDS": None, "SETITEMS": None}


class RefusedError(Exception):
    """A file contains more than a state dict needs; the message names the part."""


@dataclass(slots=True)
class _Pickled:
    """An object of the pickle: its kind, its constant value or items, the size and depth of the tree below it, and
    whether an object after it refers to it."""

    kind: str
    value: Any = None
    parts: int = 1
    depth: int = 1
    shared: bool = False


def scan_torch_file(file: BinaryIO) -> None:
    """Check a file written by `torch.save`; afterwards, the file is positioned at its start."""
    size = file.seek(0, 2)
    file.seek(0)
    zipped = file.read(2) == b"PK"
    file.seek(0)
    if zipped:
        scan_pickle(_pickle_of_archive(file, size), size)
    else:  # the format before PyTorch 1.6: the content is the fourth of five pickles
        for _ in range(5):
            scan_pickle(file, size)
    file.seek(0)


def _pickle_of_archive(file: BinaryIO, size: int) -> BinaryIO:
    with zipfile.ZipFile(file) as archive:
        records = archive.infolist()
        declared = sum(record.file_size for record in records)
        if declared > size:  # torch.save does not compress, so the contents cannot be larger than the file
            raise RefusedError(f"its {size} bytes would unpack to {declared}")
        if (changed := archive.testzip()) is not None:
            raise ValueError(f"checksum mismatch in {changed[:60]}")
        # PyTorch searches names regardless of case, in the folder of the first record
        names = [record.filename.lower() for record in records]
        if len(set(names)) < len(names):
            raise ValueError("two records have the same name")
        return io.BytesIO(archive.read(records[0].filename.partition("/")[0] + "/data.pkl"))


def scan_pickle(file: BinaryIO, size: int) -> None:
    """Read one pickle of a file without creating its objects, up to its end.

    >>> import pickle
    >>> scan_pickle(io.BytesIO(pickle.dumps({"lr": [0.1, 2]}, protocol=2)), 0)
    >>> scan_pickle(io.BytesIO(pickle.dumps(bytearray(9), protocol=2)), 0)
    Traceback (most recent call last):
    robustflow.core.pickle_scan.RefusedError: builtins.bytearray
    """
    begin, read = file.tell(), 0
    stack: list[_Pickled] = []
    marks: list[int] = []
    memo: dict[Any, _Pickled] = {}
    for opcode, argument, _ in pickletools.genops(file):
        read = file.tell() - begin
        if read > LARGEST:
            raise RefusedError(f"a pickle of more than {LARGEST >> 20} MiB")
        name = opcode.name
        if name in _CONSTANTS:
            stack.append(_Pickled("constant", argument if opcode.arg else name))
        elif name in _EMPTY:
            stack.append(_Pickled(_EMPTY[name], []))
        elif name == "MARK":
            marks.append(len(stack))
        elif name in _TUPLES or name == "TUPLE":
            items = _pop(stack, _TUPLES[name] if name in _TUPLES else len(stack) - marks.pop())
            stack.append(_add_parts(_Pickled("tuple", items), items))
        elif name in _ADDED:
            count = _ADDED[name]
            items = _pop(stack, len(stack) - marks.pop() if count is None else count)
            _add(stack[-1], items, "list" if name.startswith("APPEND") else "dict")
        elif name in ("BINPUT", "LONG_BINPUT"):
            memo[argument] = stack[-1]
        elif name in ("BINGET", "LONG_BINGET"):
            memo[argument].shared = True
            stack.append(memo[argument])
        elif name == "GLOBAL":
            stack.append(_Pickled("global", _allowed(str(argument).replace(" ", "."))))
        elif name in ("REDUCE", "NEWOBJ"):
            called, arguments = _pop(stack, 2)
            stack.append(_called(called, arguments))
        elif name == "BUILD":
            (state,) = _pop(stack, 1)
            if stack[-1].kind != "ignored":
                _add(stack[-1], [_Pickled("constant", ""), state], "dict")
        elif name == "BINPERSID":
            (identifier,) = _pop(stack, 1)
            stack.append(_storage(identifier, size))
        elif name not in ("PROTO", "STOP"):
            raise RefusedError(f"opcode {name}")
    if stack[-1].parts > _MOST_SHARED * read + 100:
        raise RefusedError(f"{stack[-1].parts} parts, most of them the same")


def _pop(stack: list[_Pickled], count: int) -> list[_Pickled]:
    items = stack[len(stack) - count :]
    if len(items) < count:
        raise ValueError("its stack is empty")
    del stack[len(stack) - count :]
    return items


def _add_parts(whole: _Pickled, items: Iterable[_Pickled]) -> _Pickled:
    for item in items:
        whole.parts += item.parts
        whole.depth = max(whole.depth, item.depth + 1)
    if whole.depth > _DEEPEST:
        raise RefusedError(f"more than {_DEEPEST} levels of nesting")
    return whole


def _add(whole: _Pickled, items: list[_Pickled], kind: str) -> None:
    if whole.kind != kind:
        raise RefusedError(f"{kind} items of something else")
    if whole.shared:
        raise RefusedError(f"{kind} that contains itself")
    if kind == "list":
        whole.value.extend(items)
    elif any(key.kind != "constant" for key in items[::2]):
        raise RefusedError("dict whose keys are not numbers or strings")
    _add_parts(whole, items)


def _allowed(name: str) -> str:
    name = name.replace("__builtin__", "builtins")
    if name not in _CALLED and name not in _STORAGES and name not in _DTYPES:
        raise RefusedError(name)
    return name


def _called(called: _Pickled, arguments: _Pickled) -> _Pickled:
    name, values = called.value, arguments.value or []
    if called.kind != "global" or arguments.kind != "tuple" or name not in _CALLED:
        raise RefusedError(f"call of {name}")
    kinds = [value.kind for value in values]
    if name == "collections.OrderedDict":  # Python 2 stored the items as a list of pairs
        pairs = values[0].value if kinds == ["list"] else values
        fits = all(pair.kind in ("list", "tuple") and pair.value[0].kind == "constant" for pair in pairs)
    elif name == "collections.Counter":
        fits = kinds in ([], ["dict"])
    elif name == "_codecs.encode":
        fits = kinds == ["constant"] * 2 and values[1].value == "latin1"
    elif name in _REBUILT:
        fits = kinds[:1] == ["storage"]
    else:
        fits = True
    if not fits:
        raise RefusedError(f"call of {name} with different arguments")
    return _add_parts(_Pickled(_CALLED[name], name), values)


def _storage(identifier: _Pickled, size: int) -> _Pickled:
    values = [part.value for part in identifier.value or []] if identifier.kind == "tuple" else []
    if len(values) < 5 or values[0] != "storage" or values[1] not in _STORAGES:
        raise RefusedError("reference to something other than values of a tensor")
    if not isinstance(values[4], int) or not 0 <= values[4] <= size:
        raise RefusedError(f"tensor of {values[4]} values in {size} bytes")
    return _Pickled("storage")
