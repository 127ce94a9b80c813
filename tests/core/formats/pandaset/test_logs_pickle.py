"""Tables out of pickles: what pandas writes is read, everything else is refused by name and nothing of it runs."""

from __future__ import annotations

import gzip
import pickle
import pickletools
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from unisim_blender.core.errors import LogError
from unisim_blender.core.formats.pandaset import safe_pickle
from unisim_blender.core.formats.pandaset.safe_pickle import read_table
from unisim_blender.core.formats.pandaset.write import table_pickle

TABLE = {"x": np.array([1.0, 2.0]), "name": np.array(["a", "b"], object), "n": np.array([3, 4])}
READ_ERRORS = r"refused|not a readable pickle|cannot be unpacked"


def gzipped(path: Path, data: bytes) -> Path:
    path.write_bytes(gzip.compress(data, 1))
    return path


class Call:
    """Pickles as a call of ``function``."""

    def __init__(self, function: Callable[..., Any], *arguments: Any) -> None:
        self.call = (function, arguments)

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        return self.call


@pytest.mark.parametrize("protocol", [2, 3, 4, 5])
def test_reads_what_pandas_writes(tmp_path: Path, protocol: int) -> None:
    pandas = pytest.importorskip("pandas")
    frame = pandas.DataFrame(
        {
            "uuid": ["a", "b", "c"],
            "mixed": np.array([np.nan, "q", None], object),
            "x": [0.5, np.nan, -1e300],
            "y": [1.0, 2.0, 3.0],
            "flag": [True, False, True],
            "n": [1, -2, 2**62],
            "f": np.array([1, 2, 3], np.float32),
        }
    )
    chosen = frame[frame["n"] != -2]  # an index that is no range
    for case in (frame, chosen, frame[[]], frame.iloc[:0]):
        table = read_table(gzipped(tmp_path / "t.pkl.gz", pickle.dumps(case, protocol)))
        assert set(table) == set(case.columns)
        for name in case.columns:
            expected = case[name].to_numpy()
            absent = pandas.isna(expected)
            np.testing.assert_array_equal(pandas.isna(table[name]), absent)
            np.testing.assert_array_equal(table[name][~absent], expected[~absent])


@pytest.mark.parametrize("protocol", [0, 1, 2, 3, 4, 5])
@pytest.mark.parametrize("function", [open, eval, exec, getattr, __import__, pickle.loads, np.load, np.memmap])
def test_a_hostile_pickle_is_refused_and_does_not_run(
    tmp_path: Path, protocol: int, function: Callable[..., Any]
) -> None:
    trap = tmp_path / "ran"
    arguments = (str(trap), "w") if function is open else (f"open({str(trap)!r}, 'w')",)
    path = gzipped(tmp_path / "evil.pkl.gz", pickle.dumps([Call(function, *arguments)], protocol))
    with pytest.raises(LogError, match=r"evil\.pkl\.gz: refused"):
        read_table(path)
    assert not trap.exists()


def test_the_refusal_names_the_file_and_the_global(tmp_path: Path) -> None:
    path = gzipped(tmp_path / "07.pkl.gz", b"cos\nsystem\n(X\x04\x00\x00\x00true" + b"tR.")
    with pytest.raises(LogError, match=r"07\.pkl\.gz: refused, the pickle names 'os\.system'"):
        read_table(path)


def test_a_hostile_value_inside_a_table_does_not_run(tmp_path: Path) -> None:
    trap = tmp_path / "ran"
    evil = pickle.dumps(Call(open, str(trap), "w"), 3)[2:-1]
    honest = table_pickle(TABLE)
    place = honest.index(b"X\x01\x00\x00\x00a")
    path = gzipped(tmp_path / "t.pkl.gz", honest[:place] + evil + honest[place:])
    with pytest.raises(LogError, match="refused"):
        read_table(path)
    assert not trap.exists()


@pytest.mark.parametrize(
    "data",
    [
        pytest.param(b"\x80\x03cnumpy\nndarray\n)\x81.", id="ndarray made directly"),
        pytest.param(b"\x80\x03cnumpy\nndarray\n(J\xff\xff\xff\x7ftR.", id="ndarray called with a size"),
        pytest.param(b"\x80\x03ccopyreg\n_reconstructor\n.", id="reconstructor"),
        pytest.param(b"\x80\x03cpandas.core.frame\nDataFrame\n}X\x01\x00\x00\x00aNsb.", id="state set on a class"),
        pytest.param(b"\x80\x03cpandas\nread_pickle\nX\x01\x00\x00\x00a\x85R.", id="a function of pandas"),
        pytest.param(b"\x80\x04\x8c\x02os\x8c\x06system\x93.", id="stack global"),
        pytest.param(b"\x80\x02\x82\x01.", id="extension registry"),
        pytest.param(b"(ios\nsystem\n.", id="inst"),
        pytest.param(b"Pid\n.", id="persistent id"),
        pytest.param(b"\x80\x03N.", id="no frame"),
        pytest.param(b"\x80\x03].", id="a list"),
        pytest.param(b"\x80\x03cpandas.core.frame\nDataFrame\n)\x81.", id="a frame without state"),
        pytest.param(b"", id="empty"),
        pytest.param(b"hello world", id="text"),
        pytest.param(b"\x80\x03.", id="nothing on the stack"),
        pytest.param(b"\x80\x03j\xff\xff\xff\xff.", id="memo that is not there"),
        pytest.param(b"\x80\x03Nr\xff\xff\xff\xff.", id="memo far away"),
        pytest.param(b"\x80\x04\x8e\xff\xff\xff\xff\xff\xff\xff\x7f.", id="bytes longer than the file"),
        pytest.param(b"\x80\x03t.", id="tuple without a mark"),
    ],
)
def test_odd_pickles_are_refused(tmp_path: Path, data: bytes) -> None:
    with pytest.raises(LogError, match=rf"odd\.pkl\.gz: .*({READ_ERRORS})"):
        read_table(gzipped(tmp_path / "odd.pkl.gz", data))


def test_every_truncation_is_refused(tmp_path: Path) -> None:
    whole = table_pickle(TABLE)
    assert read_table(gzipped(tmp_path / "t.pkl.gz", whole))["n"].tolist() == [3, 4]
    for length in range(0, len(whole), 3):
        with pytest.raises(LogError, match=rf"t\.pkl\.gz: .*({READ_ERRORS})"):
            read_table(gzipped(tmp_path / "t.pkl.gz", whole[:length]))


@pytest.mark.filterwarnings("ignore:invalid escape sequence")
def test_a_changed_byte_never_does_more_than_be_refused(tmp_path: Path) -> None:
    whole = bytearray(table_pickle(TABLE))
    rng = np.random.default_rng(0)
    refused = 0
    for _ in range(600):
        broken = bytearray(whole)
        broken[rng.integers(len(broken))] = rng.integers(256)
        try:
            read_table(gzipped(tmp_path / "t.pkl.gz", bytes(broken)))
        except LogError:
            refused += 1
    assert refused > 200


@pytest.mark.parametrize("cut", [0, 5, 30, -9, -1])
def test_a_truncated_gzip_is_refused(tmp_path: Path, cut: int) -> None:
    path = tmp_path / "t.pkl.gz"
    path.write_bytes(gzip.compress(table_pickle(TABLE))[:cut])
    with pytest.raises(LogError, match=r"t\.pkl\.gz: (cannot be unpacked|not a readable|refused)"):
        read_table(path)


def test_a_gzip_bomb_is_refused_in_little_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(safe_pickle, "MAX_BYTES", 4 * 2**20)
    path = gzipped(tmp_path / "bomb.pkl.gz", bytes(200 * 2**20))
    assert path.stat().st_size < 2**20
    tracemalloc.start()
    with pytest.raises(LogError, match=r"bomb\.pkl\.gz: refused, it unpacks to more than 4 MiB"):
        read_table(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 16 * 2**20


def test_a_key_nested_too_deeply_to_hash_is_refused(tmp_path: Path) -> None:
    path = gzipped(tmp_path / "t.pkl.gz", b"\x80\x03}()" + b"\x85" * 300_000 + b"Nu.")
    with pytest.raises(LogError, match="dictionary with a key that is no string"):
        read_table(path)


def test_many_copies_of_one_string_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(safe_pickle, "MAX_BYTES", 2**20)
    string = b"X" + (2**18).to_bytes(4, "little") + b"a" * 2**18
    encode = b"c_codecs\nencode\n(h\0X\x06\0\0\0latin1tR0"
    path = gzipped(tmp_path / "t.pkl.gz", b"\x80\x03" + string + b"q\0" + encode * 8 + b".")
    with pytest.raises(LogError, match="refused, the pickle needs more than 1 MiB"):
        read_table(path)


def test_too_many_instructions_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(safe_pickle, "MAX_INSTRUCTIONS", 1000)
    with pytest.raises(LogError, match="more than 1000 instructions"):
        read_table(gzipped(tmp_path / "t.pkl.gz", b"\x80\x03" + b"(" * 2000 + b"."))


def test_an_array_that_claims_more_than_it_holds_is_refused(tmp_path: Path) -> None:
    """The shape of the numbers' block is raised to 2^31 - 1 columns: no such memory is ever asked for."""
    data = table_pickle({"x": np.arange(3.0)})
    shape = b"K\x01K\x03\x86"
    assert data.count(shape) == 1
    path = gzipped(tmp_path / "t.pkl.gz", data.replace(shape, b"J\xff\xff\xff\x7fK\x03\x86"))
    with pytest.raises(LogError, match=r"array of shape \(2147483647, 3\) with other than so many bytes"):
        read_table(path)


@pytest.mark.parametrize("code", ["V8", "S8", "U8", "M8", "c16", "f8,f8", "(1000000000,)f8", "f16"])
def test_dtypes_that_a_table_does_not_need_are_refused(tmp_path: Path, code: str) -> None:
    data = table_pickle({"x": np.arange(3.0)})
    old = b"X\x02\0\0\0f8"
    assert data.count(old) == 1
    path = gzipped(tmp_path / "t.pkl.gz", data.replace(old, b"X" + len(code).to_bytes(4, "little") + code.encode()))
    with pytest.raises(LogError, match="refused, the pickle holds numbers of the kind"):
        read_table(path)


def test_a_missing_column_is_named(tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r"t\.pkl\.gz: the table has no column 'yaw'"):
        read_table(gzipped(tmp_path / "t.pkl.gz", table_pickle(TABLE)), ("x", "yaw"))


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r"none\.pkl\.gz: cannot be unpacked"):
        read_table(tmp_path / "none.pkl.gz")


def test_the_writer_stays_within_the_instructions_that_are_followed() -> None:
    names = {opcode.name for opcode, _, _ in pickletools.genops(table_pickle(TABLE))}
    assert names <= {*safe_pickle._PUSH, *safe_pickle._STEPS, "PROTO", "STOP"}
