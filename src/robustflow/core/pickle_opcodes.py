"""Check a pickle of tensors before PyTorch reads it: only what a state dict needs, at a cost that its size bounds.

PyTorch's `weights_only` runs no code, but calls `bytearray` with any number, and hashes nested tuples for as long as it
takes. The scan follows the opcodes without calling anything. It takes less than a second and 10 times the size of the
pickle, so its objects are numbers in arrays.
"""

from __future__ import annotations

from array import array
from collections import Counter, OrderedDict
from collections.abc import Sequence

LARGEST = 2 * 2**20
"""Maximum size of a pickle, bytes; the tensors are stored outside it, and one entry takes about 150 bytes."""

_LEAST_PER_STEP = 5
"""Minimum number of bytes per opcode that makes or changes an object; in the state of an optimiser, there are 10."""
_DEEPEST = 100
_MOST_SHARED = 16
"""Maximum number of parts, counted as often as they are reached, per byte of the pickle."""

IGNORED = ("numpy.core.multiarray.scalar", "numpy._core.multiarray.scalar", "numpy.dtype", "argparse.Namespace")
"""Objects that training scripts store with the weights: the best error, the learning rate, the command line. They are
replaced by placeholders."""

_SIZES = {"Char": 1, "Byte": 1, "Bool": 1, "Half": 2, "BFloat16": 2, "Short": 2, "Float": 4, "Int": 4}
_SIZES |= {"Double": 8, "Long": 8, "ComplexFloat": 8, "ComplexDouble": 16}
_STORAGES = {f"torch.{kind}Storage": size for kind, size in _SIZES.items()}
"""Storages of tensors, with the size of one value in bytes."""
_DTYPES = tuple(
    f"torch.{kind}"
    for kind in (
        *("float16", "bfloat16", "float32", "float64", "complex64", "complex128"),
        *("bool", "uint8", "int8", "int16", "int32", "int64"),
    )
)
_REBUILT = ("torch._utils._rebuild_tensor", "torch._utils._rebuild_tensor_v2")

_CONSTANT, _GLOBAL, _STORAGE, _TUPLE, _LIST, _DICT, _OBJECT, _IGNORED = range(8)
_KIND = 7
_SHARED, _NO_PAIR, _NOT_OF_PAIRS, _METHODS_REPLACED = 8, 16, 32, 64
"""Properties of an object, added to its kind: it is referred to later; its first item is not a key; an item is not a
pair; as the attributes of a dict, it would replace methods."""

_CALLED = {
    "collections.OrderedDict": _DICT,
    "collections.Counter": _DICT,
    "torch._utils._rebuild_parameter": _OBJECT,
    "torch.Size": _OBJECT,
    "torch.device": _OBJECT,
    "_codecs.encode": _OBJECT,
    **dict.fromkeys(_REBUILT, _OBJECT),
    **dict.fromkeys(IGNORED, _IGNORED),
}
"""Kinds of the results of the functions that a file may call."""
_METHODS = {*dir(OrderedDict), *dir(Counter)}

_FIXED = {ord("J"): 4, ord("K"): 1, ord("M"): 2, ord("G"): 8, ord("N"): 0, ord(")"): 0, 0x88: 0, 0x89: 0}
"""Opcodes of constants and of the empty tuple, with the number of bytes that follow."""
_COUNTED = {ord("X"): 4, ord("U"): 1, 0x8A: 1}
"""Opcodes of texts and of large integers, with the number of bytes that contain their length."""
_MEMO = {ord("q"): 1, ord("r"): 4, ord("h"): 1, ord("j"): 4}
_TUPLES = {0x85: 1, 0x86: 2, 0x87: 3, ord("t"): None}
_LEAVES = {ord(")"): _TUPLE, ord("c"): _GLOBAL, ord("Q"): _STORAGE}
_NOTHING = 2**31 - 1
_LONGEST_KEY = 8
"""Maximum size of an integer that is a key, in bytes; larger ones can have any number of equal hashes."""
_LONGEST_NAME = 100
_MOST_ARGUMENTS = 10


class RefusedError(Exception):
    """A file contains more than a state dict needs; the message names the part."""


def scan_pickle(data: bytes, file_size: int) -> int:
    """Read the pickle at the start of `data` without creating its objects, and return its length.

    >>> import pickle
    >>> scan_pickle(pickle.dumps([0.1, 2], protocol=2) + b"more", 0)
    19
    >>> scan_pickle(pickle.dumps(bytearray(9), protocol=2), 0)
    Traceback (most recent call last):
    robustflow.core.pickle_opcodes.RefusedError: builtins.bytearray
    """
    return _Scan(data, file_size).run()


class _Scan:
    """The state of a scan. On the stack, `n >= 0` is object n, and `~n` is what the opcode at byte n makes: a constant,
    an empty tuple, a function, or a storage."""

    def __init__(self, data: bytes, file_size: int) -> None:
        self.data, self.file_size, self.at = data, file_size, 0
        self.stack, self.marks, self.memo = array("i"), array("i"), array("i")
        self.properties, self.depths, self.parts, self.first = bytearray(), bytearray(), array("i"), array("i")
        self.items = array("i")
        """Of each tuple, the number of its items, then the items."""
        self.storages: set[str] = set()
        self.stored = 0
        self.steps, self.copied = 0, 0

    def run(self) -> int:
        data, stack, memo, at, size = self.data, self.stack, self.memo, 0, min(len(self.data), LARGEST)
        while at < size:
            code = data[at]
            if code in _FIXED:
                stack.append(~at)
                at += 1 + _FIXED[code]
            elif code in _COUNTED:
                stack.append(~at)
                at = self._text_span(at)[1]
            elif code in _MEMO:
                number = int.from_bytes(data[at + 1 : at + 1 + _MEMO[code]], "little")
                if code in b"qr":
                    self._remember(number, at)
                else:
                    if (value := memo[number]) == _NOTHING:
                        raise ValueError(f"object {number} is missing")
                    if value >= 0:
                        self.properties[value] |= _SHARED
                    stack.append(value)
                at += 1 + _MEMO[code]
            elif code == ord("("):
                self.marks.append(len(stack))
                at += 1
            elif code == ord("c"):
                stack.append(~at)
                if (name := self._text(~at)) not in _CALLED and name not in _STORAGES and name not in _DTYPES:
                    raise RefusedError(name)
                at = data.index(b"\n", data.index(b"\n", at) + 1) + 1
            elif code == 0x80:
                at += 2
            elif code == ord("."):
                (root,) = self._pop(1)
                if root >= 0 and self.parts[root] > _MOST_SHARED * at + 100:
                    raise RefusedError(f"{self.parts[root]} parts, most of them the same")
                return at + 1
            else:
                self.at = at
                self._combine(code)
                at += 1
        raise RefusedError(f"a pickle of more than {size} bytes") if size == LARGEST else EOFError("it ends early")

    def _combine(self, code: int) -> None:
        """Execute an opcode that makes or changes an object."""
        self.steps += 1
        if self.steps > 1000 + self.at // _LEAST_PER_STEP:
            raise RefusedError(f"{self.steps} steps in {self.at} bytes")
        if code in b"]}":
            self._make(_LIST if code == ord("]") else _DICT, ())
        elif code in _TUPLES:
            values = self._pop(_TUPLES[code])
            self._make(_TUPLE | (0 if values and self._is_key(values[0]) else _NO_PAIR), values)
            self.items.append(len(values))
            self.items.extend(values)
        elif code in b"ae":
            self._append(self._pop(1 if code == ord("a") else None))
        elif code in b"su":
            self._set_items(self._pop(2 if code == ord("s") else None))
        elif code in b"R\x81":
            self._call(*self._pop(2))
        elif code == ord("b"):
            (state,) = self._pop(1)
            if self._kind(self.stack[-1]) != _IGNORED:
                if self._kind(state) != _DICT or self.properties[state] & _METHODS_REPLACED:
                    raise RefusedError("attributes that may replace methods")
                self._copy(state)
                self._add([state], _DICT)
        elif code == ord("Q"):
            self._refer(*self._pop(1))
        else:
            raise RefusedError(f"opcode {bytes([code])!r}")

    def _remember(self, number: int, at: int) -> None:
        if number > at // 2:  # a pickle numbers its objects consecutively
            raise RefusedError(f"object {number} at byte {at}")
        self.memo.extend(array("i", [_NOTHING]) * (number + 1 - len(self.memo)))
        self.memo[number] = self.stack[-1]

    def _pop(self, count: int | None) -> Sequence[int]:
        """Remove and return values from the top of the stack: `count`, or all above the last mark."""
        begin = self.marks.pop() if count is None else len(self.stack) - count
        if not 0 <= begin <= len(self.stack):
            raise ValueError("its stack is empty")
        values = self.stack[begin:]
        del self.stack[begin:]
        return values

    def _kind(self, value: int) -> int:
        return self.properties[value] & _KIND if value >= 0 else _LEAVES.get(self.data[~value], _CONSTANT)

    def _is_key(self, value: int) -> bool:
        if self._kind(value) != _CONSTANT:
            return False
        return self.data[~value] != 0x8A or self.data[~value + 1] <= _LONGEST_KEY

    def _text_span(self, at: int) -> tuple[int, int]:
        begin = at + 1 + _COUNTED[self.data[at]]
        return begin, begin + int.from_bytes(self.data[at + 1 : begin], "little")

    def _text(self, value: int) -> str:
        """Return a name, which is a text or that of a function; "" for other values and long texts."""
        if value >= 0 or (code := self.data[at := ~value]) not in b"XUc":
            return ""
        if code == ord("c"):
            end = self.data.index(b"\n", self.data.index(b"\n", at) + 1)
            return self.data[at + 1 : end].decode().replace("\n", ".").replace("__builtin__", "builtins")
        begin, end = self._text_span(at)
        return self.data[begin:end].decode(errors="replace") if end - begin <= _LONGEST_NAME else ""

    def _integer(self, value: int) -> int:
        """Return an integer; -1 for other values."""
        if value >= 0 or (code := self.data[at := ~value]) not in b"JKM\x8a":
            return -1
        begin, end = self._text_span(at) if code in _COUNTED else (at + 1, at + 1 + _FIXED[code])
        return int.from_bytes(self.data[begin:end], "little", signed=code in b"J\x8a")

    def _values(self, value: int) -> Sequence[int]:
        """Return the items of a tuple; none for other values."""
        if value < 0 or self._kind(value) != _TUPLE:
            return ()
        begin = self.first[value] + 1
        if (count := self.items[begin - 1]) > _MOST_ARGUMENTS:
            raise RefusedError(f"a call with {count} arguments")
        return self.items[begin : begin + count]

    def _make(self, properties: int, values: Sequence[int]) -> None:
        self.stack.append(len(self.parts))
        self.properties.append(properties)
        self.depths.append(1)
        self.parts.append(1)
        self.first.append(len(self.items))
        self._count(values)

    def _count(self, values: Sequence[int]) -> None:
        """Add values to the number of parts and to the depth of the object on the top of the stack."""
        whole = self.stack[-1]
        parts, depth = self.parts[whole], self.depths[whole]
        for value in values:
            parts += self.parts[value] if value >= 0 else 1
            depth = max(depth, 1 + (self.depths[value] if value >= 0 else 1))
        if depth > _DEEPEST:
            raise RefusedError(f"more than {_DEEPEST} levels of nesting")
        if parts > _MOST_SHARED * LARGEST + 100:
            raise RefusedError(f"{parts} parts, most of them the same")
        self.parts[whole], self.depths[whole] = parts, depth

    def _add(self, values: Sequence[int], kind: int) -> None:
        if self._kind(self.stack[-1]) != kind:
            raise RefusedError("items of something other than a list or dict")
        if self.properties[self.stack[-1]] & _SHARED:
            raise RefusedError("a list or dict that contains itself")
        self._count(values)

    def _copy(self, value: int) -> None:
        """Count what a call copies, of which anything may be copied several times."""
        self.copied += self.parts[value] if value >= 0 else 1
        if self.copied > 1000 + self.at:
            raise RefusedError(f"calls copy {self.copied} parts in {self.at} bytes")

    def _append(self, values: Sequence[int]) -> None:
        whole = self.stack[-1]
        empty = whole < 0 or self.parts[whole] == 1
        self._add(values, _LIST)
        if empty and values and not self._is_key(values[0]):
            self.properties[whole] |= _NO_PAIR
        for value in values:
            pair = value >= 0 and self._kind(value) in (_TUPLE, _LIST) and self.parts[value] > 1
            if not pair or self.properties[value] & _NO_PAIR:
                self.properties[whole] |= _NOT_OF_PAIRS

    def _set_items(self, values: Sequence[int]) -> None:
        self._add(values, _DICT)
        for key in values[::2]:
            if not self._is_key(key):
                raise RefusedError("a dict whose keys are not numbers or strings")
            if self._text(key) in ("", *_METHODS):
                self.properties[self.stack[-1]] |= _METHODS_REPLACED

    def _call(self, called: int, arguments: int) -> None:
        self._copy(arguments)
        name, values = self._text(called), self._values(arguments)
        if self._kind(called) != _GLOBAL or self._kind(arguments) != _TUPLE or name not in _CALLED:
            raise RefusedError(f"call of {name or 'something other than a function'}")
        kinds = [self._kind(value) for value in values]
        if name == "collections.OrderedDict":  # Python 2 stored the items as a list of pairs
            fits = not kinds or (kinds == [_LIST] and not self.properties[values[0]] & _NOT_OF_PAIRS)
        elif name == "collections.Counter":
            fits = kinds in ([], [_DICT])
        elif name == "_codecs.encode":
            texts = [self._text(value) for value in values]
            fits = kinds == [_CONSTANT] * 2 and texts[0] != "" and texts[1] == "latin1"
        else:
            fits = name not in _REBUILT or kinds[:1] == [_STORAGE]
        if not fits:
            raise RefusedError(f"call of {name} with different arguments")
        self._make(_CALLED[name], values)

    def _refer(self, identifier: int) -> None:
        """Execute a reference to a storage: ("storage", class, key, device, number of values)."""
        values = self._values(identifier)
        texts = [self._text(value) for value in values]
        if len(values) < 5 or texts[0] != "storage" or texts[1] not in _STORAGES or not texts[2]:
            raise RefusedError("reference to something other than values of a tensor")
        number = self._integer(values[4])
        if texts[2] not in self.storages:
            self.storages.add(texts[2])
            self.stored += number * _STORAGES[texts[1]]
        if not 0 <= number <= self.file_size >= self.stored:
            raise RefusedError(f"tensors of {max(number, self.stored)} bytes in {self.file_size} bytes")
        self.stack.append(~self.at)
