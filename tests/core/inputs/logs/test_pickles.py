"""Pickles of tables: any program of pickle's instructions is read as a table or refused, and nothing that
it names is used."""

from __future__ import annotations

import gzip
import pickle
import pickletools
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from hypothesis.strategies import SearchStrategy

from inputs.faults import Bytes
from inputs.promise import Property, Reader, nothing_is_looked_up
from inputs.strategies import Input, faults_of_bytes
from inputs.views import In
from unisim_blender.core.formats.pandaset.safe_pickle import _ALLOWED, read_table
from unisim_blender.core.formats.pandaset.write import table_pickle

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="no alarms and no bounds of memory there")
FILE = "table.pkl.gz"
TABLE = {
    "x": np.arange(5.0),
    "n": np.arange(5),
    "s": np.array(["a", "b", "", "d", None], object),
    "b": np.ones(5, bool),
}
TRAP = "a file that no pickle may make"
HOSTILE = (
    "os.system", "posix.system", "builtins.eval", "builtins.exec", "builtins.open", "builtins.getattr",
    "builtins.__import__",
    "subprocess.Popen", "shutil.rmtree", "pickle.loads", "numpy.load", "numpy.memmap", "numpy.core.multiarray.fromfile",
    "copyreg._reconstructor", "functools.partial", "operator.attrgetter", "pandas.read_pickle", "pandas.eval",
    "webbrowser.open",
)  # fmt: skip


def _named(name: str) -> bytes:
    module, _, last = name.rpartition(".")
    return f"c{module}\n{last}\n".encode()


def _value(value: Any) -> bytes:
    return pickle.dumps(value, 4)[2:-1]


PLAIN: tuple[Any, ...] = (
    None, True, 0, 1, -1, 2**31, 2**70, 1.5, float("nan"), "", "x", "O8", "f8", "<", "latin1", b"", b"12345678", (),
    [], {},
)  # fmt: skip
GLOBALS = st.sampled_from(sorted(_ALLOWED)) | st.sampled_from(sorted(_ALLOWED)) | st.sampled_from(HOSTILE)
OPCODES = sorted(opcode.code.encode("latin1") for opcode in pickletools.opcodes if opcode.arg is None)
"""Instructions without an argument."""
ARGUMENTS = st.sampled_from((*PLAIN, TRAP, f"open({TRAP!r}, 'w')"))
STEPS: SearchStrategy[bytes] = st.one_of(
    st.sampled_from(OPCODES), st.sampled_from(OPCODES), GLOBALS.map(_named), st.sampled_from(PLAIN).map(_value),
    st.integers(0, 8).map(lambda index: b"h" + bytes([index])),
    st.integers(0, 8).map(lambda index: b"q" + bytes([index])),
    # a call of a name, which is what a hostile pickle is there for
    st.builds(lambda name, value: _named(name) + _value(value) + b"\x85R", GLOBALS, ARGUMENTS),
    GLOBALS.map(lambda name: _named(name) + b")\x81"), st.just(b"(ios\nsystem\n"),
)  # fmt: skip
PROGRAMS = st.lists(STEPS, max_size=12).map(b"".join)


def pickle_reader(folder: Path) -> Reader:
    """A table's pickle: its bytes changed, instructions put between its own, and programs of none of its own."""
    program = table_pickle(TABLE)
    starts = [at for _, _, at in pickletools.genops(program) if at is not None]
    whole = {FILE: gzip.compress(program, 1)}
    inserted = st.builds(lambda at, steps: Bytes(at, 0, steps), st.sampled_from(starts), PROGRAMS)
    replaced = st.builds(lambda at, steps: Bytes(at, 1, steps), st.sampled_from(starts), PROGRAMS)
    alone = PROGRAMS.map(lambda steps: Bytes(0, 2**40, b"\x80\x04" + steps + b"."))
    faults = st.lists(inserted | replaced, min_size=1, max_size=2).map(tuple) | alone.map(lambda fault: (fault,))
    inputs: SearchStrategy[Input] = (faults | faults_of_bytes(len(program))).map(
        lambda some: [In(FILE, "unzipped", some)]
    )
    inputs |= faults_of_bytes(len(whole[FILE])).map(lambda some: [In(FILE, "bytes", some)])
    return Reader(folder, whole, lambda: read_table(folder / FILE, ("x",)), inputs, (FILE,))


PICKLES = Property(pickle_reader)


def program(steps: bytes) -> Input:
    """A program in the table's place."""
    return [In(FILE, "unzipped", (Bytes(0, 2**40, b"\x80\x04" + steps + b"."),))]


@given(PICKLES.inputs)
@example(program(b"cos\nsystem\nX\x04\x00\x00\x00true\x85R"))
@example(program(b"cbuiltins\nslice\n" + _value(tuple(range(3))) + b"R"))
@example(program(_named("pandas.DataFrame") + b")\x81" + _value({"_mgr": None}) + b"b"))
def test_pickles(changes: Input) -> None:
    PICKLES.check(changes)
    assert not Path(TRAP).exists()


def test_a_class_that_is_looked_up_would_be_noticed() -> None:
    with pytest.raises(AssertionError, match=r"pickle\.find_class"), nothing_is_looked_up():
        pickle.loads(b"cbuiltins\nlen\n.")
