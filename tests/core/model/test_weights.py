"""The weights' file, mapped: what safetensors writes is what is read, and what is broken is refused by name."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from safetensors.numpy import save_file

from unisim_blender.core.errors import SceneError
from unisim_blender.core.model.scene_file import DTYPES, Weights, check_finite, read_weights, weights_hash

PAIR = {"dtype": "F32", "shape": [2], "data_offsets": [0, 8]}


def written(path: Path, header: Any, data: bytes = b"", length: int | None = None) -> Path:
    """A file of that header (JSON, or its bytes), with ``length`` in front of it where that is a lie."""
    text = header if isinstance(header, bytes) else json.dumps(header).encode()
    path.write_bytes(struct.pack("<Q", len(text) if length is None else length) + text + data)
    return path


@pytest.mark.parametrize("kind", sorted(DTYPES))
def test_what_safetensors_writes(tmp_path: Path, kind: str) -> None:
    rng = np.random.default_rng(4)
    arrays = {
        name: (rng.integers(0, 2 if kind == "BOOL" else 100, shape)).astype(DTYPES[kind])
        for name, shape in (("a", (3, 5)), ("b", ()), ("c", (0, 4)), ("d", (2, 3, 7)))
    }
    save_file(arrays, tmp_path / "w", {"made": "here"})
    found = read_weights(tmp_path / "w").arrays
    assert sorted(found) == sorted(arrays)
    for name, array in arrays.items():
        assert found[name].dtype == array.dtype and found[name].shape == array.shape and found[name].flags.aligned
        np.testing.assert_array_equal(found[name], array)


def test_nothing_is_copied_and_nothing_can_be_written(tmp_path: Path) -> None:
    save_file({"a": np.arange(6, dtype=np.float32).reshape(2, 3)}, tmp_path / "w")
    array = read_weights(tmp_path / "w").arrays["a"]
    bases = [array]
    while isinstance(bases[-1].base, np.ndarray):
        bases.append(bases[-1].base)
    assert isinstance(bases[-1], np.memmap), "it lies in the file"
    with pytest.raises(ValueError, match="read-only"):
        array[0, 0] = 1


def test_what_lies_askew_is_put_straight(tmp_path: Path) -> None:
    header = {"a": {"dtype": "U8", "shape": [1], "data_offsets": [0, 1]}, "b": {**PAIR, "data_offsets": [1, 9]}}
    text = json.dumps(header).encode()
    values = np.array([1.5, -2.0], np.float32)
    found = read_weights(written(tmp_path / "w", text + b" " * (-len(text) % 8), b"\7" + values.tobytes())).arrays
    assert found["b"].flags.aligned and not found["b"].flags.writeable
    np.testing.assert_array_equal(found["b"], values)


@pytest.mark.parametrize(
    ("header", "data", "length", "message"),
    (
        (b"{}", b"", 3, r"its header would be 3 bytes long, in a file of 10"),
        (b"{}", b"", 2**64 - 1, r"its header would be 18446744073709551615 bytes long"),
        (b"{", b"", None, r"its header is no JSON"),
        (b"\xff\xfe", b"", None, r"its header is no JSON"),
        (b"[" * 100_000, b"", None, r"its header is no JSON"),
        (b"[]", b"", None, r"its header is no JSON object"),
        (b'{"a": {}, "a": {}}', b"", None, r"its header has 'a' twice"),
        (b'{"a": {"dtype": "F32", "dtype": "F16"}}', b"", None, r"its header has 'dtype' twice"),
        ({"a": 5}, b"", None, r"'a' has dtype None"),
        ({"a": {**PAIR, "dtype": "BF16"}}, bytes(8), None, r"'a' has dtype 'BF16', not one of BOOL"),
        ({"a": {**PAIR, "dtype": []}}, bytes(8), None, r"'a' has dtype \[\]"),
        ({"a": {**PAIR, "shape": [-2]}}, bytes(8), None, r"'a' has shape \[-2\]"),
        ({"a": {**PAIR, "shape": [2.0]}}, bytes(8), None, r"'a' has shape \[2\.0\]"),
        ({"a": {**PAIR, "shape": [True, 2]}}, bytes(8), None, r"'a' has shape \[True, 2\]"),
        ({"a": {**PAIR, "shape": 2}}, bytes(8), None, r"'a' has shape 2"),
        ({"a": {**PAIR, "shape": [3]}}, bytes(8), None, r"'a' has 8 bytes, which are no F32 of shape \[3\]"),
        ({"a": {**PAIR, "shape": [1 << 62, 1 << 62]}}, bytes(8), None, r"'a' has 8 bytes"),
        ({"a": {**PAIR, "shape": [0, 1 << 70], "data_offsets": [0, 0]}}, b"", None, r"'a' has shape \[0, 11805916"),
        ({"a": {**PAIR, "shape": [2] + [1] * 99}}, bytes(8), None, r"'a' has shape \[2, 1, 1"),
        ({"a": {**PAIR, "data_offsets": [0, 16]}}, bytes(8), None, r"'a' lies at \[0, 16\], which is no place in 8 bytes"),
        ({"a": {**PAIR, "data_offsets": [8, 0]}}, bytes(8), None, r"'a' lies at \[8, 0\]"),
        ({"a": {**PAIR, "data_offsets": [-8, 0]}}, bytes(8), None, r"'a' lies at \[-8, 0\]"),
        ({"a": {**PAIR, "data_offsets": [0]}}, bytes(8), None, r"'a' lies at \[0\]"),
        ({"a": PAIR, "b": PAIR}, bytes(8), None, r"'b' begins at byte 0, where the one before it ends at 8"),
        ({"a": PAIR, "b": {**PAIR, "data_offsets": [4, 12]}}, bytes(12), None, r"'b' begins at byte 4"),
        ({"a": {**PAIR, "data_offsets": [4, 12]}}, bytes(12), None,
        r"'a' begins at byte 4, where the one before it ends at 0"),
        ({"a": PAIR}, bytes(9), None, r"its arrays take 8 bytes, of 9"),
        ({"a": {"dtype": "BOOL", "shape": [2], "data_offsets": [0, 2]}}, b"\1\2", None,
        r"'a' holds 2, which is no BOOL"),
        ({"a\nb" * 1000: 5}, b"", None, r"'a\\nba\\nb.{60,70}\.\.\. has dtype"),
    ),
)  # fmt: skip
def test_hostile_files(tmp_path: Path, header: Any, data: bytes, length: int | None, message: str) -> None:
    file = written(tmp_path / "weights.safetensors", header, data, length)
    with pytest.raises(SceneError, match=message) as error:
        read_weights(file)
    text = str(error.value)
    assert text.startswith(f"{file} cannot be read: ") and "\n" not in text and len(text) < len(str(file)) + 250


@pytest.mark.parametrize("size", (0, 7))
def test_files_without_a_header(tmp_path: Path, size: int) -> None:
    (tmp_path / "w").write_bytes(bytes(size))
    with pytest.raises(SceneError, match="w cannot be read: "):
        read_weights(tmp_path / "w")


def test_a_file_that_is_none(tmp_path: Path) -> None:
    for path in (tmp_path, tmp_path / "nothing"):
        with pytest.raises(SceneError, match="cannot be read"):
            read_weights(path)


def test_no_single_byte_breaks_more_than_its_file(tmp_path: Path) -> None:
    save_file(
        {"a": np.ones((2, 3), np.float32), "b": np.array([True, False]), "c": np.zeros(0, np.int64)}, tmp_path / "w"
    )
    whole, rng, refused = (tmp_path / "w").read_bytes(), np.random.default_rng(6), 0
    for _ in range(600):
        broken = bytearray(whole)
        for place in rng.integers(0, len(whole), rng.integers(1, 4)):
            broken[place] = rng.integers(0, 256)
        (tmp_path / "x").write_bytes(broken[: rng.integers(0, len(whole) * 3)])
        try:
            for array in read_weights(tmp_path / "x").arrays.values():
                assert len(array.tobytes()) == array.nbytes, "every byte of it is there"
        except SceneError:
            refused += 1
    assert 300 < refused < 600


@pytest.mark.parametrize("dtype", (np.float16, np.float32, np.float64))
@pytest.mark.parametrize("value", (np.nan, np.inf, -np.inf))
def test_numbers_that_are_none(dtype: type, value: float) -> None:
    array: NDArray[Any] = np.full((4, 5), np.finfo(dtype).max, dtype)
    array[0, 0], array[1, 1] = np.finfo(dtype).smallest_subnormal, -np.finfo(dtype).max
    check_finite(Path("w"), "a", array)
    array[2, 3] = value
    with pytest.raises(SceneError, match=r"w: a\[2, 3\] is not a finite number"):
        check_finite(Path("w"), "a", array)


def test_arrays_and_voxels_of_a_scene() -> None:
    index, value = np.array([1, 23], np.int32), np.array([7, 255], np.uint8)
    weights = Weights(Path("w"), {"v.index": index, "v.value": value, "a": np.ones((2, 3))})
    grid = weights.voxels("v", (2, 3, 4))
    assert grid.shape == (2, 3, 4) and grid[0, 0, 1] == 7 and grid[1, 2, 3] == 255 and grid.sum() == 262
    assert weights.array("a", (2, 3)) is weights.arrays["a"]
    with pytest.raises(SceneError, match=r"w: a has shape \(2, 3\), scene\.json asks for \(3, 2\)"):
        weights.array("a", (3, 2))
    with pytest.raises(SceneError, match=r"w: b is missing"):
        weights.array("b", (1,))
    broken = (
        (index.astype(np.float32), value),
        (index, value.astype(np.int32)),
        (index[:1], value),
        (index[None], value[None]),
    )
    for at, what in (*broken, (index + 1, value), (index - 2, value)):
        with pytest.raises(SceneError, match=r"w: v does not fit a grid of \(2, 3, 4\) voxels"):
            Weights(Path("w"), {"v.index": at, "v.value": what}).voxels("v", (2, 3, 4))


def test_a_changed_file_has_another_hash(tmp_path: Path) -> None:
    file = tmp_path / "weights.safetensors"
    file.write_bytes(b"one")
    first = weights_hash(tmp_path)
    file.write_bytes(b"other")
    assert weights_hash(tmp_path) != first and len(first) == 64
