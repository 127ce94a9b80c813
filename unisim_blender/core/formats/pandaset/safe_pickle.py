"""Reads a pandas table out of a pickle without unpickling it: nothing that the file names is imported or called.

A pickle is a program for a small stack machine. Here that program is stepped through, a global is no more than its name,
and the few names that a table of numbers and strings needs have a meaning of ours; any other name or instruction refuses
the file. Sizes are bounded before memory is taken. Works without pandas; knows the forms that pandas 0.25 to 3 write with
numpy 1 and 2, and strings as pyarrow keeps them. The instructions that a long drive's thousand files of boxes are full of
are read here, all others by `pickletools`, which takes ten times as long.
"""

from __future__ import annotations

import io
import math
import os
import pickletools
import struct
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import NoneType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import LogError, in_a_line

OFFSETS: dict[str, np.dtype[Any]] = {
    "string": np.dtype("<i4"),
    "utf8": np.dtype("<i4"),
    "large_string": np.dtype("<i8"),
}
"""Types of strings that are read, and how each counts where its strings begin."""


def strings(kind: str, length: int, first: int, buffers: tuple[bytes | None, bytes, bytes]) -> NDArray[Any]:
    """Return the strings (length,) of an array, dtype object, None where one is missing.

    ``first``: how many elements of the buffers lie before the array's own. ``buffers``: a bit for each element, set where it is
    there, or None where all are; where each string begins, and the last ends, in bytes; the strings in UTF-8, one after another.
    From "Variable-size Binary Layout" of Arrow's columnar format. Raises ValueError where the buffers hold no such array.
    """
    present, begins, text = buffers
    size = OFFSETS[kind].itemsize
    if length < 0 or first < 0 or (length and len(begins) < size * (first + length + 1)):
        raise ValueError(f"{length} strings, and where they begin is given for others")
    if not length:
        return np.empty(0, object)
    places = np.frombuffer(begins, OFFSETS[kind], length + 1, size * first)
    if places[0] < 0 or places[-1] > len(text) or np.any(np.diff(places) < 0):
        raise ValueError("strings begin outside their text")
    there = np.ones(length, bool)
    if present is not None:
        if 8 * len(present) < first + length:
            raise ValueError(f"{length} strings, and which are there is given for others")
        there = np.unpackbits(np.frombuffer(present, np.uint8), count=first + length, bitorder="little")[first:] > 0
    values = np.empty(length, object)
    ends = places.tolist()
    values[:] = [bytes(text[a:b]).decode() if is_there else None for a, b, is_there in zip(ends, ends[1:], there)]  # noqa: B905
    return values


MAX_BYTES = 256 * 2**20
"""Largest unpacked pickle that is read; a real sweep with both LiDARs has 10 MB."""
MAX_INSTRUCTIONS = 2_000_000
"""Most instructions that are followed; a frame's cuboids need some thousands."""
PICKLE = b"\x80"
"""How a pickle of protocol 2 and later begins, and no gzip file."""
PickledTable = dict[str, NDArray[Any]]
"""Columns by name, each (N,); numbers have their own dtype, strings and mixed columns dtype object."""


class _RefusedError(Exception):
    """Why a pickle is not followed any further."""


@dataclass(frozen=True)
class _Name:
    """A global: its name, never the thing itself."""

    name: str


@dataclass
class _Dtype:
    """numpy.dtype, its byte order set by its state."""

    code: str
    order: str = "|"

    def numpy(self) -> np.dtype[Any]:
        if self.code not in _DTYPES:
            raise _RefusedError(f"holds numbers of the kind {self.code[:40]!r}")
        return np.dtype(self.order + self.code if self.order in ("<", ">") else self.code)


@dataclass
class _Array:
    """numpy.ndarray or an array type of pandas around one; ``value`` is set by its state."""

    value: NDArray[Any] | None = None


@dataclass
class _Block:
    """Some of a table's columns: values (K, N) or (N,), and which columns they are."""

    values: Any
    placement: Any


@dataclass
class _Manager:
    """pandas' BlockManager: axes (columns, rows) and blocks."""

    axes: Any = None
    blocks: list[_Block] = field(default_factory=list)


@dataclass
class _Frame:
    """pandas.DataFrame."""

    manager: _Manager | None = None


@dataclass
class _Index:
    """pandas.Index with its labels, or RangeIndex with a range's ends."""

    labels: NDArray[Any] | None
    rows: int


@dataclass(frozen=True)
class _Arrow:
    """pyarrow's type of strings, by name."""

    kind: str


class _Opaque:
    """Something whose value does not matter here (a string dtype, flags)."""


_DTYPES = {"O8", "O", "O4", "b1", "?", *(f"{kind}{size}" for kind in "iu" for size in (1, 2, 4, 8)), "f2", "f4", "f8"}
_FRAME = {"pandas.core.frame.DataFrame", "pandas.DataFrame"}
_MANAGER = {"pandas.core.internals.managers.BlockManager", "pandas.core.internals.BlockManager"}
_RANGE = {"pandas.core.indexes.range.RangeIndex", "pandas.RangeIndex"}
_INDEX = {"pandas.core.indexes.base.Index", "pandas.Index"} | {
    f"pandas.core.indexes.numeric.{kind}Index" for kind in ("Int64", "UInt64", "Float64")
}
_STRING_ARRAY = {
    "pandas.core.arrays.string_.StringArray", "pandas.arrays.StringArray",
    "pandas.core.arrays.string_arrow.ArrowStringArray", "pandas.arrays.ArrowStringArray",
}  # fmt: skip
_STRING_DTYPE = {"pandas.core.arrays.string_.StringDtype", "pandas.StringDtype"}
_MISSING = {"pandas.NA", "pandas._libs.missing.NA"}
_NDARRAY = {"numpy.ndarray"}
_CALLS: dict[str, str] = {
    "numpy.dtype": "dtype",
    "builtins.slice": "slice",
    "__builtin__.slice": "slice",
    "_codecs.encode": "encode",
    "builtins.bytearray": "bytes",
    "__builtin__.bytearray": "bytes",
    "pyarrow.lib.py_buffer": "bytes",
    "pyarrow.lib.type_for_alias": "arrow",
    "pyarrow.lib._restore_array": "arrow array",
    "pyarrow.lib.chunked_array": "arrow chunks",
    "builtins.bytes": "no bytes",
    "__builtin__.bytes": "no bytes",
    "pandas.core.indexes.base._new_Index": "index",
    "pandas._libs.internals._unpickle_block": "block",
    "pandas._libs.arrays.__pyx_unpickle_NDArrayBacked": "extension",
    **{f"numpy.{core}.multiarray._reconstruct": "array" for core in ("core", "_core")},
    **{f"numpy.{core}.multiarray.scalar": "scalar" for core in ("core", "_core")},
    **{f"numpy.{core}.numeric._frombuffer": "frombuffer" for core in ("core", "_core")},
    **dict.fromkeys(_MANAGER, "manager"),
    **dict.fromkeys(_STRING_DTYPE, "opaque"),
}
_ALLOWED = {*_CALLS, *_FRAME, *_RANGE, *_INDEX, *_STRING_ARRAY, *_MISSING, *_NDARRAY}


def read_table(path: Path, required: tuple[str, ...] = ()) -> PickledTable:
    """The columns of the pickle of a pandas.DataFrame at ``path``, gzipped or not; LogError where it is anything else.

    ``required`` names columns that must be there.
    """
    try:
        with open(path, "rb") as stream:
            # room for what is read is taken beforehand: not for more than there is
            data = _unpacked(stream.read(min(os.fstat(stream.fileno()).st_size, MAX_BYTES) + 1))
    except (OSError, EOFError, zlib.error) as error:
        raise LogError(f"{path}: cannot be unpacked ({in_a_line(error)})") from error
    if data is None:
        raise LogError(f"{path}: refused, it unpacks to more than {MAX_BYTES // 2**20} MiB")
    try:
        table = _table(_Machine().run(data))
    except _RefusedError as error:
        raise LogError(f"{path}: refused, the pickle {error}") from error
    except (
        ValueError,
        TypeError,
        IndexError,
        KeyError,
        AttributeError,
        OverflowError,
        RecursionError,
        MemoryError,
        struct.error,
    ) as error:
        raise LogError(f"{path}: not a readable pickle of a table ({in_a_line(error)})") from error
    missing = [name for name in required if name not in table]
    if missing:
        raise LogError(f"{path}: the table has no column '{missing[0]}'")
    return table


def _unpacked(packed: bytes) -> bytes | None:
    """The content of a gzip file's members, or of a pickle as it is; None where it, or the file, has more than `MAX_BYTES`.
    EOFError, zlib.error."""
    if packed.startswith(PICKLE):
        return packed if len(packed) <= MAX_BYTES else None
    parts, room = [], MAX_BYTES
    while packed:
        member = zlib.decompressobj(16 + zlib.MAX_WBITS)
        parts.append(member.decompress(packed, room + 1))
        room -= len(parts[-1])
        if room < 0:
            return None
        if not member.eof:
            if member.unconsumed_tail or len(packed) > MAX_BYTES:
                return None
            raise EOFError("the file ends before its content does")
        packed = member.unused_data.lstrip(b"\0")
    if not parts:
        raise EOFError("the file is empty")
    return parts[0] if len(parts) == 1 else b"".join(parts)


def _table(frame: object) -> PickledTable:
    """The columns of a frame, checked to be as long as its rows."""
    if not isinstance(frame, _Frame) or frame.manager is None:
        raise _RefusedError("holds no pandas DataFrame")
    columns, rows = frame.manager.axes
    if not isinstance(columns, _Index) or not isinstance(rows, _Index):
        raise _RefusedError("has axes that are no index")
    labels = range(columns.rows) if columns.labels is None else columns.labels
    table: PickledTable = {}
    for block in frame.manager.blocks:
        values = _values(block.values)
        values = values[None] if values.ndim == 1 else values
        for position, column in zip(_positions(block.placement, columns.rows), values, strict=True):
            if column.shape != (rows.rows,):
                raise _RefusedError(f"has a column of shape {column.shape} in a table of {rows.rows} rows")
            table[str(labels[position])] = column
    if len(table) != columns.rows:
        raise _RefusedError(f"names {columns.rows} columns and holds {len(table)}")
    return table


def _positions(placement: Any, columns: int) -> Sequence[int]:
    if isinstance(placement, slice):
        return range(*placement.indices(columns))  # never a list: a hostile index may claim 2^62 columns
    return [int(position) for position in _values(placement)]


def _values(array: Any) -> NDArray[Any]:
    if not isinstance(array, _Array) or array.value is None:
        raise _RefusedError("has an array without values")
    return array.value


class _Machine:
    """The stack machine, for the instructions that plain data needs."""

    def __init__(self) -> None:
        self.stack: list[Any] = []
        self.marks: list[int] = []
        self.memo: dict[int, Any] = {}
        self.spent = 0

    def run(self, data: bytes) -> Any:
        """Return what the pickle ``data`` leaves on the stack."""
        stack, memo, stream = self.stack, self.memo, io.BytesIO(data)
        at, end, count = 0, len(data), 0
        while at < end:
            if (count := count + 1) > MAX_INSTRUCTIONS:
                raise _RefusedError(f"has more than {MAX_INSTRUCTIONS} instructions")
            code = data[at]
            if code == _BINUNICODE:
                begin = at + 5
                at = begin + _UINT4(data, at + 1)[0]
                if at > end:
                    raise ValueError("a string ends behind the file's end")
                stack.append(str(data[begin:at], "utf-8", "surrogatepass"))
            elif code == _BINPUT:
                memo[data[at + 1]] = stack[-1]
                at += 2
            elif code == _LONG_BINPUT:
                memo[_UINT4(data, at + 1)[0]] = stack[-1]
                at += 5
            elif code == _BINFLOAT:
                stack.append(_FLOAT8(data, at + 1)[0])
                at += 9
            elif code == _BINGET:
                stack.append(memo[data[at + 1]])
                at += 2
            elif code == _LONG_BINGET:
                stack.append(memo[_UINT4(data, at + 1)[0]])
                at += 5
            elif code == _GLOBAL:
                module_end = data.index(b"\n", at)
                name_end = data.index(b"\n", module_end + 1)
                self.global_(data[at + 1 : name_end].decode("ascii").replace("\n", " "))
                at = name_end + 1
            else:
                opcode = _OPCODES.get(code)
                if opcode is None:
                    raise _RefusedError(f"has at byte {at} the instruction {code}, which there is not")
                argument, at = None, at + 1
                if opcode.arg is not None:
                    stream.seek(at)
                    argument, at = opcode.arg.reader(stream), stream.tell()
                name = opcode.name
                if name == "STOP":
                    return stack.pop()
                if name in _PUSH:
                    stack.append(_PUSH[name](argument))
                elif name in _STEPS:
                    _STEPS[name](self, argument)
                elif name not in ("PROTO", "FRAME"):
                    raise _RefusedError(f"has the instruction {name}, which a table does not need")
        raise _RefusedError("has no end")

    def pop_mark(self) -> list[Any]:
        start = self.marks.pop()
        items = self.stack[start:]
        del self.stack[start:]
        return items

    def mark(self, _: Any) -> None:
        self.marks.append(len(self.stack))

    def put(self, index: int | None) -> None:
        self.memo[len(self.memo) if index is None else index] = self.stack[-1]

    def get(self, index: int) -> None:
        self.stack.append(self.memo[index])

    def global_(self, argument: str | None) -> None:
        """A global by the name in the instruction ("module name") or by the two strings on the stack."""
        if argument is None:
            name, module = self.stack.pop(), self.stack.pop()
        else:
            module, _, name = argument.partition(" ")
        full = f"{module}.{name}"
        if full not in _ALLOWED:
            raise _RefusedError(f"names {full[:120]!r}, which a table does not need")
        self.stack.append(None if full in _MISSING else _Name(full))

    def tuple_of(self, count: int) -> None:
        items = tuple(self.stack[-count:])
        if len(items) != count:
            raise _RefusedError("takes more from the stack than is there")
        del self.stack[-count:]
        self.stack.append(items)

    def append(self, items: list[Any]) -> None:
        self._top(list).extend(items)

    def set_items(self, items: list[Any]) -> None:
        target = self._top(dict)
        for key, value in zip(items[::2], items[1::2], strict=True):
            if not isinstance(key, str):
                raise _RefusedError("has a dictionary with a key that is no string")
            target[key] = value

    def reduce(self, _: Any) -> None:
        arguments, function = self.stack.pop(), self.stack.pop()
        if not isinstance(function, _Name) or function.name not in _CALLS or not isinstance(arguments, tuple):
            raise _RefusedError(f"calls {str(getattr(function, 'name', type(function).__name__))[:120]!r}")
        self.stack.append(_MAKERS[_CALLS[function.name]](self, *arguments))

    def new_object(self, _: Any) -> None:
        arguments, cls = self.stack.pop(), self.stack.pop()
        name = cls.name if isinstance(cls, _Name) else ""
        if arguments != () or name not in _FRAME | _MANAGER | _STRING_ARRAY:
            raise _RefusedError(f"makes an object of {name[:120]!r}")
        self.stack.append(_Frame() if name in _FRAME else _Manager() if name in _MANAGER else _Array())

    def build(self, _: Any) -> None:
        state = self.stack.pop()
        target = self.stack[-1]
        if isinstance(target, _Array):
            target.value = self._array_of(state)
        elif isinstance(target, _Dtype):
            target.order = str(state[1])
        elif isinstance(target, _Manager):
            self._set_manager(target, state)
        elif isinstance(target, _Frame):
            manager = state.get("_mgr", state.get("_data"))
            target.manager = manager if isinstance(manager, _Manager) else None
        elif not isinstance(target, _Opaque):
            raise _RefusedError(f"sets the state of a {type(target).__name__}")

    def _top(self, kind: type[Any]) -> Any:
        if type(self.stack[-1]) is not kind:
            raise _RefusedError(f"fills a {type(self.stack[-1]).__name__} as a {kind.__name__}")
        return self.stack[-1]

    def _array_of(self, state: Any) -> NDArray[Any]:
        """An array from the state of an ndarray (version, shape, dtype, Fortran order, data), or of pandas'
        array around one."""
        if len(state) == 5 and isinstance(state[2], _Dtype):
            return self._array(state[4], state[2], state[1], "F" if state[3] else "C")
        for item in state.values() if isinstance(state, dict) else state:
            if isinstance(item, _Array):
                return _values(item)
        raise _RefusedError("has an array whose state is of an unknown form")

    def _array(self, data: Any, dtype: _Dtype, shape: Any, order: str) -> NDArray[Any]:
        """An array of exactly the data that are there: a shape that claims more is refused before memory is taken."""
        kind = dtype.numpy()
        if not (type(shape) is tuple and len(shape) <= 2 and all(type(n) is int and n >= 0 for n in shape)):
            raise _RefusedError("has an array whose shape is none")
        if kind.hasobject:
            if type(data) is not list or len(data) != math.prod(shape):
                raise _RefusedError(f"has an array of shape {shape} with other than so many values")
            self._spend(8 * len(data))
            values = np.fromiter(data, dtype=object, count=len(data))
        else:
            if not isinstance(data, bytes | bytearray) or len(data) != math.prod(shape) * kind.itemsize:
                raise _RefusedError(f"has an array of shape {shape} with other than so many bytes")
            values = np.frombuffer(data, kind)
        return values.reshape(shape, order="F" if order == "F" else "C")

    def _spend(self, count: int) -> None:
        self.spent += count
        if self.spent > MAX_BYTES:
            raise _RefusedError(f"needs more than {MAX_BYTES // 2**20} MiB")

    @staticmethod
    def _set_manager(manager: _Manager, state: Any) -> None:
        """The state that pandas wrote before 1.3: (axes, values, items, {"0.14.1": {"axes": …, "blocks": […]}})."""
        content = state[3]["0.14.1"]
        manager.axes = tuple(content["axes"])
        manager.blocks = [_Block(block["values"], block["mgr_locs"]) for block in content["blocks"]]

    def encode(self, text: str, encoding: str) -> bytes:
        if encoding != "latin1":
            raise _RefusedError(f"encodes a string as {str(encoding)[:40]!r}")
        self._spend(len(text))
        return text.encode("latin1")

    def index(self, cls: _Name, state: dict[str, Any]) -> _Index:
        if cls.name in _RANGE:
            return _Index(None, len(range(int(state["start"]), int(state["stop"]), int(state["step"]))))
        if cls.name not in _INDEX:
            raise _RefusedError(f"makes an index of {cls.name!r}")
        labels = _values(state["data"])
        if labels.ndim != 1:
            raise _RefusedError("has an index of more than one dimension")
        return _Index(labels, len(labels))

    def arrow(self, kind: str) -> _Arrow:
        if kind not in OFFSETS:
            raise _RefusedError(f"has a column of Arrow's type {str(kind)[:40]!r}")
        return _Arrow(kind)

    def arrow_array(self, state: Any) -> _Array:
        """Strings from the state of a pyarrow.Array: type, length, nulls, offset, buffers, children, dictionary."""
        kind, length, _, first, buffers, *_ = state
        are_plain = [type(buffer) in (bytes, bytearray, NoneType) for buffer in buffers]
        if not isinstance(kind, _Arrow) or len(are_plain) != 3 or not all(are_plain) or None in buffers[1:]:
            raise _RefusedError("has an array of Arrow's that holds no strings")
        self._spend(64 * len(buffers[1]) // OFFSETS[kind.kind].itemsize + len(buffers[2]))
        return _Array(strings(kind.kind, int(length), int(first), tuple(buffers)))

    def arrow_chunks(self, chunks: list[Any], kind: _Arrow) -> _Array:
        arrays = [_values(chunk) for chunk in chunks]
        self._spend(8 * sum(map(len, arrays)))
        return _Array(np.concatenate(arrays) if arrays else np.empty(0, object))

    def data(self, content: Any = b"") -> bytes | bytearray:
        if type(content) not in (bytes, bytearray):
            raise _RefusedError(f"makes bytes of a {type(content).__name__}")
        return content

    def scalar(self, dtype: _Dtype, data: bytes) -> Any:
        return self._array(data, dtype, (1,), "C")[0].item()

    def manager(self, blocks: tuple[_Block, ...], axes: Any) -> _Manager:
        if not all(isinstance(block, _Block) for block in blocks):
            raise _RefusedError("has a block of an unknown form")
        return _Manager(tuple(axes), list(blocks))


_BINUNICODE, _BINPUT, _LONG_BINPUT, _BINFLOAT, _BINGET, _LONG_BINGET, _GLOBAL = b"XqrGhjc"
_OPCODES = {ord(opcode.code): opcode for opcode in pickletools.opcodes}
_UINT4, _FLOAT8 = struct.Struct("<I").unpack_from, struct.Struct(">d").unpack_from
_PUSH: dict[str, Callable[[Any], Any]] = {
    "NONE": lambda _: None,
    "NEWTRUE": lambda _: True,
    "NEWFALSE": lambda _: False,
    "EMPTY_TUPLE": lambda _: (),
    "EMPTY_LIST": lambda _: [],
    "EMPTY_DICT": lambda _: {},
    **dict.fromkeys(("BININT", "BININT1", "BININT2", "LONG1", "BINFLOAT"), lambda value: value),
    **dict.fromkeys(("BINUNICODE", "SHORT_BINUNICODE", "BINUNICODE8"), lambda value: value),
    **dict.fromkeys(("BINBYTES", "SHORT_BINBYTES", "BINBYTES8", "BYTEARRAY8"), lambda value: value),
}
_STEPS: dict[str, Callable[[_Machine, Any], None]] = {
    "MARK": _Machine.mark,
    "POP": lambda m, _: m.stack.pop() and None,
    "BINPUT": _Machine.put,
    "LONG_BINPUT": _Machine.put,
    "MEMOIZE": _Machine.put,
    "BINGET": _Machine.get,
    "LONG_BINGET": _Machine.get,
    "GLOBAL": _Machine.global_,
    "STACK_GLOBAL": _Machine.global_,
    "TUPLE": lambda m, _: m.stack.append(tuple(m.pop_mark())),
    "TUPLE1": lambda m, _: m.tuple_of(1),
    "TUPLE2": lambda m, _: m.tuple_of(2),
    "TUPLE3": lambda m, _: m.tuple_of(3),
    "APPEND": lambda m, _: m.append([m.stack.pop()]),
    "APPENDS": lambda m, _: m.append(m.pop_mark()),
    "SETITEM": lambda m, _: m.set_items([m.stack.pop(-2), m.stack.pop()]),
    "SETITEMS": lambda m, _: m.set_items(m.pop_mark()),
    "REDUCE": _Machine.reduce,
    "NEWOBJ": _Machine.new_object,
    "BUILD": _Machine.build,
}
_MAKERS: dict[str, Callable[..., Any]] = {
    "array": lambda m, cls, shape, kind: _Array(),
    "extension": lambda m, cls, checksum, state: _Array(),
    "dtype": lambda m, code, align=False, copy=True: _Dtype(str(code)),
    "frombuffer": lambda m, data, dtype, shape, order: _Array(m._array(data, dtype, shape, order)),
    "scalar": _Machine.scalar,
    "encode": _Machine.encode,
    "bytes": _Machine.data,
    "arrow": _Machine.arrow,
    "arrow array": _Machine.arrow_array,
    "arrow chunks": _Machine.arrow_chunks,
    "no bytes": lambda m: b"",
    "slice": lambda m, start, stop, step=None: slice(start, stop, step),
    "index": _Machine.index,
    "block": lambda m, values, placement, ndim: _Block(values, placement),
    "manager": _Machine.manager,
    "opaque": lambda m, *arguments: _Opaque(),
}
