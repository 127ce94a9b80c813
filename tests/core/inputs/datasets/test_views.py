"""Views of datasets' files: what is opened and closed again without a fault says the same, and a fault arrives in the file."""

from __future__ import annotations

import io
import json
from typing import Any

import numpy as np
import pytest

from inputs.datasets import stores, tables
from inputs.faults import Array, Copy, Drop, Entry, Put, Repeat, Scale
from inputs.views import In, whole_document

TEXT = b"calib_time: 09-Jan-2012 13:57:47\nR: 7.5e-03 1.0 -0.5\n\nT: 2.5\n"
TAGS = b"<?xml version='1.0'?>\n<item><tx>1.25</tx><l>Car</l></item>\n"
POINTS = np.arange(12, dtype="<f4").tobytes()
PARTS = {".zgroup": b'{"zarr_format": 2}', "a/.zattrs": b'{"n": [1, 2]}', "a/0": b"\x01\x02\xff"}


def feather() -> bytes:
    pyarrow = pytest.importorskip("pyarrow", reason="the extra parquet is not installed")
    from pyarrow import feather as files

    out = io.BytesIO()
    columns = {"stamp": pyarrow.array([5, 6], "int64"), "x": pyarrow.array([1.5, 2.5], "float16"), "name": ["a", "b"]}
    files.write_feather(pyarrow.table(columns), out, compression="lz4")
    return out.getvalue()


def parquet() -> bytes:
    pyarrow = pytest.importorskip("pyarrow", reason="the extra parquet is not installed")
    from pyarrow import parquet as files

    out = io.BytesIO()
    poses = pyarrow.array([[1.0, 2.0], [3.0, 4.0]], pyarrow.list_(pyarrow.float32()))
    files.write_table(pyarrow.table({"pose": poses, "image": [b"\xff\xd8", b"x"]}), out)
    return out.getvalue()


def store() -> bytes:
    pytest.importorskip("cbor2", reason="nvidia-ncore is not installed: pip install '.[ncore]'")
    body = b"".join(PARTS.values())
    sizes = [len(part) for part in PARTS.values()]
    offsets = [sum(sizes[:at]) for at in range(len(sizes))]
    return stores.with_index(({"items": list(PARTS), "offset_datas": offsets, "sizes": sizes}, body))


FILES = {
    "words": lambda: TEXT,
    "tags": lambda: TAGS,
    "points of 4": lambda: POINTS,
    "feather": feather,
    "parquet": parquet,
    "index": store,
    "parts": store,
}
X_OF_ROW_1 = ("columns", "x", 1)


@pytest.mark.parametrize("view", FILES)
def test_a_file_without_a_fault_says_the_same(view: str) -> None:
    data = FILES[view]()
    before = whole_document(data, view)
    after = whole_document(In("file", view, (Drop(("not there",)),)).applied(data), view)
    np.testing.assert_equal(after, before)


@pytest.mark.parametrize(
    ("view", "fault", "place", "found"),
    [
        ("words", Scale((1, 2), 2.0), (1, 2), 2.0),
        ("words", Drop((1, 3)), (1,), ["R:", 7.5e-3, 1.0]),
        ("tags", Put((6,), -3.5), (6,), "-3.5"),
        ("points of 4", Array("points", Entry(5, np.inf)), ("points", 1, 1), np.inf),
        ("feather", Put(X_OF_ROW_1, 7.5), X_OF_ROW_1, 7.5),
        ("feather", Put(X_OF_ROW_1, "x"), ("columns", "x"), ["1.5", "x"]),
        ("feather", Put(("types", "stamp"), "int8"), ("types", "stamp"), "int8"),
        ("feather", Drop(X_OF_ROW_1), ("columns", "x"), [1.5, None]),
        ("parquet", Put(("columns", "pose", 0, 1), float("nan")), ("columns", "pose", 0, 1), float("nan")),
        ("parquet", Repeat(("columns", "pose", 0, 1), 2), ("columns", "pose", 0), [1.0, 2.0, 2.0, 2.0]),
        ("index", Put(("sizes", 2), 10**6), ("sizes", 2), 10**6),
        ("parts", Put(("a/.zattrs", "n"), "x"), ("a/.zattrs",), {"n": "x"}),
        ("parts", Copy((".zgroup",), ("a/.zattrs",)), (".zgroup",), {"n": [1, 2]}),
    ],
)
def test_a_fault_arrives_in_the_file(view: str, fault: Any, place: tuple[Any, ...], found: Any) -> None:
    value = whole_document(In("file", view, (fault,)).applied(FILES[view]()), view)
    for step in place:
        value = value[step]
    np.testing.assert_equal(value if not isinstance(found, str) else str(value), found)


def test_types_are_kept_where_values_fit() -> None:
    data = feather()
    document, _ = tables.feather_document(In("file", "feather", (Put(X_OF_ROW_1, 7.5),)).applied(data))
    assert document["types"] == {"stamp": "int64", "x": "halffloat", "name": "string"}


def test_parts_that_are_no_json_stay() -> None:
    changed = In("file", "parts", (Drop((".zgroup",)),)).applied(store())
    index, body = stores.index_of(changed)
    at = index["items"].index("a/0")
    assert ".zgroup" not in index["items"]
    assert body[index["offset_datas"][at] :][: index["sizes"][at]] == PARTS["a/0"]
    assert json.loads(PARTS["a/.zattrs"]) == whole_document(changed, "parts")["a/.zattrs"]


def test_an_arrays_part_is_packed_again() -> None:
    pytest.importorskip("numcodecs", reason="nvidia-ncore is not installed: pip install '.[ncore]'")
    data = stores.packed(b"0123456789")
    assert stores.unpacked(data) == b"0123456789"
