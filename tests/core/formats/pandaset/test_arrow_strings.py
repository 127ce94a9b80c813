"""Strings as Arrow keeps them, against pyarrow, and out of pickles that pandas writes where it is installed."""

from __future__ import annotations

import gzip
import pickle
from pathlib import Path

import numpy as np
import pytest

from unisim_blender.core.errors import LogError
from unisim_blender.core.formats.pandaset.safe_pickle import read_table, strings

TEXT = "aßz".encode()
BEGINS = np.array([0, 1, 3, 3, 4], np.int64).tobytes()


def test_strings_of_a_buffer() -> None:
    assert strings("large_string", 4, 0, (None, BEGINS, TEXT)).tolist() == ["a", "ß", "", "z"]
    assert strings("large_string", 2, 1, (b"\x0b", BEGINS, TEXT)).tolist() == ["ß", None]
    assert strings("string", 0, 0, (None, b"", b"")).tolist() == []


@pytest.mark.parametrize(
    ("length", "first", "begins"),
    [(5, 0, BEGINS), (4, 1, BEGINS), (-1, 0, BEGINS), (1, -1, BEGINS), (1, 0, np.array([0, 9]).tobytes()),
     (1, 0, np.array([2, 1]).tobytes()), (1, 0, np.array([-1, 1]).tobytes()), (2, 2**62, BEGINS)],
)  # fmt: skip
def test_what_lies_outside_the_buffers_is_refused(length: int, first: int, begins: bytes) -> None:
    with pytest.raises(ValueError, match="strings"):
        strings("large_string", length, first, (None, begins, TEXT))


def test_missing_marks_are_refused() -> None:
    with pytest.raises(ValueError, match="which are there"):
        strings("large_string", 4, 0, (b"", BEGINS, TEXT))


@pytest.mark.parametrize("kind", ["string", "large_string"])
def test_as_pyarrow(kind: str) -> None:
    pyarrow = pytest.importorskip("pyarrow")
    words = [None if i % 7 == 3 else "ä" * (i % 5) + str(i) for i in range(100)]
    whole = pyarrow.array(words, getattr(pyarrow, kind)())
    for array in (whole, whole[13:57], whole[100:]):
        present, begins, text = (None if b is None else b.to_pybytes() for b in array.buffers())
        assert begins is not None and text is not None
        assert strings(kind, len(array), array.offset, (present, begins, text)).tolist() == array.to_pylist()


@pytest.mark.parametrize("protocol", [2, 3, 4, 5])
def test_a_table_of_pandas_with_pyarrow(tmp_path: Path, protocol: int) -> None:
    pandas = pytest.importorskip("pandas")
    pyarrow = pytest.importorskip("pyarrow")
    frame = pandas.DataFrame({"uuid": pandas.array(["a", "b", None, "ß"], "string[pyarrow]"), "n": [1, 2, 3, 4]})
    longer = pandas.concat([frame, frame], ignore_index=True)  # two chunks
    assert isinstance(longer["uuid"].array._pa_array, pyarrow.ChunkedArray)
    path = tmp_path / "t.pkl.gz"
    for case in (frame, longer, frame.iloc[1:], frame.iloc[:0]):
        path.write_bytes(gzip.compress(pickle.dumps(case, protocol)))
        expected = [None if value is pandas.NA else value for value in case["uuid"]]
        assert read_table(path)["uuid"].tolist() == expected


def test_numbers_in_arrow_are_refused(tmp_path: Path) -> None:
    pandas = pytest.importorskip("pandas")
    pytest.importorskip("pyarrow")
    frame = pandas.DataFrame({"n": pandas.array([1, 2], "int64[pyarrow]")})
    path = tmp_path / "07.pkl.gz"
    path.write_bytes(gzip.compress(pickle.dumps(frame)))
    with pytest.raises(LogError, match=r"07\.pkl\.gz: refused, the pickle"):
        read_table(path)
