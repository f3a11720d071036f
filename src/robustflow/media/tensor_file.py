"""Read an untrusted file of tensors, written by PyTorch or safetensors, at a cost that its size bounds.

PyTorch's own reader (`weights_only`) runs no code either, but reserves whatever memory a file claims and hashes nested
tuples for as long as it takes. This one knows the few opcodes and functions that state dicts consist of, in the format
of today (a ZIP archive) and in that before PyTorch 1.6 (five pickles, then the values of the tensors).
"""

from __future__ import annotations

import io
import pickletools
import zipfile
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, BinaryIO

if TYPE_CHECKING:
    from torch import Tensor

LARGEST = 2 * 2**20
"""Maximum size of a pickle, bytes; the tensors are stored outside it, and one entry takes about 150 bytes."""
_STEPS = 10_000
_BYTES_PER_STEP = 2
"""Minimum number of bytes per opcode after the first `_STEPS`; in the state of an optimiser, there are three."""
_LARGEST_KEY = 2**60
"""Integers below it have different hashes; larger ones can make a dict take quadratic time."""
_DEEPEST = 100
_MOST_ARGUMENTS = 10
_MAGIC = 0x1950A86A20F9469CFC6C
"""The first pickle of a file before PyTorch 1.6."""

_STORAGES = {
    "torch.CharStorage": "int8", "torch.ByteStorage": "uint8", "torch.BoolStorage": "bool",
    "torch.ShortStorage": "int16", "torch.IntStorage": "int32", "torch.LongStorage": "int64",
    "torch.HalfStorage": "float16", "torch.BFloat16Storage": "bfloat16", "torch.FloatStorage": "float32",
    "torch.DoubleStorage": "float64", "torch.ComplexFloatStorage": "complex64",
    "torch.ComplexDoubleStorage": "complex128",
}  # fmt: skip
_DTYPES = {f"torch.{name}" for name in _STORAGES.values()}
_IGNORED = ("numpy.core.multiarray.scalar", "numpy._core.multiarray.scalar", "numpy.dtype", "argparse.Namespace")
"""Objects that training scripts store with the weights: the best error, the learning rate, the command line. They are
read as None."""


class RefusedError(Exception):
    """A file contains more than a state dict needs; the message names the part."""


@dataclass(frozen=True)
class _Global:
    """A class or function by its name, which is never imported."""

    name: str


def load_tensors(file: BinaryIO) -> Any:
    """Return the content of a file from its start: tensors, in dicts and lists, with numbers and texts.

    Raises:
        RefusedError: it contains more than that, or costs more memory or time than its size explains.
        Exception: the libraries raise any exception on a damaged file.
    """
    size = file.seek(0, io.SEEK_END)
    file.seek(0)
    start = file.read(9)
    file.seek(0)
    if start[4:] == b"\0\0\0\0{":  # safetensors: the length of the header in 8 bytes, then the header in JSON
        import safetensors.torch

        if (length := int.from_bytes(start[:8], "little")) > LARGEST:
            raise RefusedError(f"a header of {length} bytes")
        return safetensors.torch.load(file.read())
    return _read_archive(file, size) if start[:4] == b"PK\x03\x04" else _read_old(file, size)


def _read_archive(file: BinaryIO, size: int) -> Any:
    with zipfile.ZipFile(file) as archive:
        entries = {entry.filename: entry for entry in archive.infolist()}
        for name, entry in entries.items():
            if entry.compress_type != zipfile.ZIP_STORED or entry.file_size > size:
                raise RefusedError(f"{size} bytes that unpack to more in {name[:60]}")
        folder = next(iter(entries)).partition("/")[0]
        if f"{folder}/constants.pkl" in entries:
            raise RefusedError("a program (TorchScript)")
        if entries[f"{folder}/data.pkl"].file_size > LARGEST:
            raise RefusedError(f"a pickle of {entries[f'{folder}/data.pkl'].file_size} bytes")
        if f"{folder}/byteorder" in entries and archive.read(f"{folder}/byteorder") != b"little":
            raise RefusedError("values of a big-endian machine")
        reader = _TensorReader(size)
        content = reader.read(io.BytesIO(archive.read(f"{folder}/data.pkl")))
        for key, storage in reader.storages.items():
            entry = entries[f"{folder}/data/{key}"]
            _fill(storage, archive.read(entry) if entry.file_size == storage.nbytes else b"")
    return content


def _read_old(file: BinaryIO, size: int) -> Any:
    reader = _TensorReader(size)
    pickles = io.BytesIO(file.read(LARGEST))
    magic, _, _, content, keys = (reader.read(pickles) for _ in range(5))
    if magic != _MAGIC:
        raise ValueError("not written by PyTorch")
    file.seek(pickles.tell())
    for key in keys:
        storage = reader.storages[key]
        if int.from_bytes(file.read(8), "little") != storage.numel():
            raise ValueError(f"two sizes of storage {key[:60]}")
        _fill(storage, file.read(storage.nbytes))
    if {*keys} != reader.storages.keys():
        raise ValueError("values are missing")
    return content


def _fill(storage: Tensor, data: bytes) -> None:
    import torch

    if len(data) != storage.nbytes:
        raise ValueError("values are missing")
    if data:
        storage.copy_(torch.frombuffer(bytearray(data), dtype=storage.dtype))


class _TensorReader:
    """Reads pickles of tensors.

    Attributes:
        storages: values of the tensors by key, still to be filled.
    """

    def __init__(self, file_size: int) -> None:
        self.storages: dict[str, Tensor] = {}
        self._size, self._stored = file_size, 0
        self._stack: list[Any] = []
        self._marks: list[int] = []
        self._copied = 0

    def read(self, data: io.BytesIO) -> Any:
        """Return the object of the pickle at the current position, which moves to its end."""
        stack, memo = self._stack, dict[Any, Any]()
        stack.clear()
        self._marks.clear()
        begin, steps = data.tell(), 0
        for opcode, argument, position in pickletools.genops(data):
            steps, length = steps + 1, (position or 0) - begin
            if steps > _STEPS + length // _BYTES_PER_STEP:
                raise RefusedError(f"{steps} steps in {length} bytes")
            name = opcode.name
            if name in _CONSTANTS:
                stack.append(_FIXED.get(name, argument))
            elif name in ("BINPUT", "LONG_BINPUT"):
                memo[argument] = stack[-1]
            elif name in ("BINGET", "LONG_BINGET"):
                stack.append(memo[argument])
            elif name == "MARK":
                self._marks.append(len(stack))
            elif name == "GLOBAL":
                stack.append(self._global(argument))
            elif name in _ACTIONS:
                _ACTIONS[name](self)
            elif name == "STOP":
                _check_parts(stack[-1], 2 * length + 1000)
                return stack[-1]
            elif name != "PROTO":
                raise RefusedError(f"opcode {name}")
        raise EOFError("it ends early")

    def _pop(self, count: int | None = None) -> list[Any]:
        """Remove and return values from the top of the stack: `count`, or all above the last mark."""
        begin = self._marks.pop() if count is None else len(self._stack) - count
        if not 0 <= begin <= len(self._stack):
            raise ValueError("its stack is empty")
        values = self._stack[begin:]
        del self._stack[begin:]
        return values

    def _count(self, *copied: Any) -> None:
        """Count what a call copies, because a file can copy one object many times."""
        self._copied += sum(map(len, copied))
        if self._copied > 10_000 + LARGEST:
            raise RefusedError("copies of its parts")

    def _global(self, argument: Any) -> Any:
        name = argument.replace(" ", ".").replace("__builtin__", "builtins")
        if name not in _CALLED and name not in _STORAGES and name not in _DTYPES and name not in _IGNORED:
            raise RefusedError(name)
        import torch

        return getattr(torch, name.partition(".")[2]) if name in _DTYPES else _Global(name)

    def _append(self, values: list[Any]) -> None:
        if type(self._stack[-1]) is not list:
            raise RefusedError("items of something other than a list")
        self._stack[-1].extend(values)

    def _set_items(self, values: list[Any]) -> None:
        if not isinstance(self._stack[-1], dict):
            raise RefusedError("items of something other than a dict")
        self._update(self._stack[-1], list(zip(values[::2], values[1::2], strict=True)))

    def _update(self, target: dict[Any, Any], items: list[Any]) -> None:
        for item in items:
            key, value = item if isinstance(item, list | tuple) and len(item) == 2 else (None, None)
            if not isinstance(key, str) and not (isinstance(key, int) and abs(key) < _LARGEST_KEY):
                raise RefusedError("a dict whose keys are not numbers or strings")
            target[key] = value

    def _call(self) -> None:
        called, arguments = self._pop(2)
        if not isinstance(called, _Global) or not isinstance(arguments, tuple) or len(arguments) > _MOST_ARGUMENTS:
            raise RefusedError("call of something other than a function, or with many arguments")
        if called.name in _IGNORED:
            self._stack.append(None)
            return
        if called.name not in _CALLED:
            raise RefusedError(f"call of {called.name}")
        try:
            self._stack.append(_CALLED[called.name](self, *arguments))
        except TypeError as error:
            raise RefusedError(f"call of {called.name} with different arguments") from error

    def _dict(self, items: Any = ()) -> OrderedDict[Any, Any]:
        """Return an OrderedDict; Python 2 stored the items as a list of pairs."""
        self._count(items)
        values = list(items.items()) if isinstance(items, dict) else items
        made: OrderedDict[Any, Any] = OrderedDict()
        self._update(made, values)
        return made

    def _tensor(self, storage: Any, offset: int, size: tuple[int, ...], stride: tuple[int, ...], *_: Any) -> Tensor:
        import torch

        if not isinstance(storage, torch.Tensor):
            raise RefusedError("a tensor without values")
        self._count(size, stride)
        made = storage.as_strided(size, stride, offset)
        if made.numel() > self._size:
            raise RefusedError(f"a tensor of {made.numel()} values in {self._size} bytes")
        return made

    def _build(self) -> None:
        """Set the attributes of an object; only the versions of the modules of a state dict are kept."""
        (state,) = self._pop(1)
        if isinstance(self._stack[-1], OrderedDict) and isinstance(state, dict) and "_metadata" in state:
            self._stack[-1]._metadata = state["_metadata"]  # type: ignore[attr-defined]

    def _storage(self) -> None:
        """Refer to a storage: ("storage", class, key, device, number of values)."""
        import torch

        (identifier,) = self._pop(1)
        kind, storage, key, _, number = identifier[:5]
        if kind != "storage" or not isinstance(storage, _Global) or not isinstance(key, str) or number < 0:
            raise RefusedError("reference to something other than values of a tensor")
        if key not in self.storages:
            dtype: Any = getattr(torch, _STORAGES[storage.name])
            self._stored += number * dtype.itemsize
            if self._stored > self._size:
                raise RefusedError(f"tensors of {self._stored} bytes in {self._size} bytes")
            self.storages[key] = torch.empty(number, dtype=dtype)
        self._stack.append(self.storages[key])


def _check_parts(value: Any, most: int, depth: int = 1) -> int:
    """Raise if a container is nested deeply or has more than `most` parts, which count as often as they
    are reached; return how many more it may have."""
    parts = list(value.values()) if isinstance(value, dict) else value if isinstance(value, list | tuple) else ()
    most -= 1 + len(parts)
    if most < 0 or depth > _DEEPEST:
        raise RefusedError("parts that occur in it many times, or are nested deeply")
    for part in parts:
        if isinstance(part, dict | list | tuple):
            most = _check_parts(part, most, depth + 1)
    return most


_FIXED = {"NONE": None, "NEWTRUE": True, "NEWFALSE": False, "EMPTY_TUPLE": ()}
_CONSTANTS = {*_FIXED, "BININT", "BININT1", "BININT2", "BINFLOAT", "BINUNICODE", "SHORT_BINSTRING", "LONG1"}
_CALLED: dict[str, Callable[..., Any]] = {
    "collections.OrderedDict": _TensorReader._dict,
    "collections.Counter": _TensorReader._dict,
    "torch._utils._rebuild_tensor": _TensorReader._tensor,
    "torch._utils._rebuild_tensor_v2": _TensorReader._tensor,
    "torch._utils._rebuild_parameter": lambda reader, tensor, *_: tensor,
    "torch.Size": lambda reader, size: size,
    "torch.device": lambda reader, kind, *_: kind,
    "_codecs.encode": lambda reader, text, encoding: text,
}
"""Functions that a file may call."""
_ACTIONS: dict[str, Callable[[_TensorReader], None]] = {
    "EMPTY_LIST": lambda reader: reader._stack.append([]),
    "EMPTY_DICT": lambda reader: reader._stack.append({}),
    "TUPLE": lambda reader: reader._stack.append(tuple(reader._pop())),
    "TUPLE1": lambda reader: reader._stack.append(tuple(reader._pop(1))),
    "TUPLE2": lambda reader: reader._stack.append(tuple(reader._pop(2))),
    "TUPLE3": lambda reader: reader._stack.append(tuple(reader._pop(3))),
    "APPEND": lambda reader: reader._append(reader._pop(1)),
    "APPENDS": lambda reader: reader._append(reader._pop()),
    "SETITEM": lambda reader: reader._set_items(reader._pop(2)),
    "SETITEMS": lambda reader: reader._set_items(reader._pop()),
    "REDUCE": _TensorReader._call,
    "NEWOBJ": _TensorReader._call,
    "BUILD": _TensorReader._build,
    "BINPERSID": _TensorReader._storage,
}
"""Opcodes that make or change an object."""
