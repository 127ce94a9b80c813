"""Draws faults of files, each fit for what the file holds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from hypothesis import strategies as st
from hypothesis.strategies import SearchStrategy

from inputs.faults import (
    SHAPES,
    TYPES,
    Array,
    Bytes,
    Copy,
    CutOff,
    Drop,
    End,
    Entry,
    Fault,
    Path,
    Put,
    Rename,
    Repeat,
    Scale,
    Shape,
    Twice,
    Type,
    member_of,
    paths_of,
)
from inputs.views import In, whole_document

DOCUMENTS = (
    "json", "tensor names", "gltf", "messages", "words", "tags", "feather", "parquet", "index", "parts",
)  # fmt: skip
"""Views in which a file is a document of objects, lists and values, as JSON is."""
Input = list[In]
"""What is wrong with the files of a folder."""

ODD: tuple[Any, ...] = (
    None, True, False, 0, -1, 1, 2, 7, 0.5, -0.0, 1e-320, 1e-9, 1e9, 1e30, -1e308, 1e308, 2**31, 2**53, -(2**63),
    10**40,
    float("nan"), float("inf"), float("-inf"), "", "x", "nan", "../..", "/", "\0", "\ud800", "y" * 5000, "car", "front",
    [], {}, [[]], [0], [1e308] * 3, [0, 0, 0], [0, 0, 0, 0], [1, 2], [None] * 3, ["a"] * 3, [[1, 2, 3]], {"a": 1},
)  # fmt: skip
"""Values that readers stumbled over once."""
SCALARS = st.none() | st.booleans() | st.integers(-(2**70), 2**70) | st.floats() | st.text(max_size=8)
VALUES = st.sampled_from(ODD) | st.recursive(
    SCALARS,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=4), inner, max_size=3),
    max_leaves=6,
)
EXTREME = (0, 1, -1, 2**31 - 1, 1e38, -1e38, 1e-40, 1e300, float("nan"), float("inf"))
NUMBERS = st.sampled_from(EXTREME) | st.floats() | st.integers()
FACTORS = st.sampled_from((-1.0, 0.5, 2.0, 10.0, 1e3, 1e6, 1e12, 1 + 1e-12))
PLAUSIBLE = st.integers(-3, 200) | st.floats(-1e4, 1e4)
TIMES = st.sampled_from((1, 2, 100, 3000, 100_000))
NAMES = st.sampled_from(("x", "", "type", "actor", "\0")) | st.text(max_size=6)
LENGTHS = st.sampled_from((0, 1, 2, 4, 16, 64))


def faults_of_json(document: Any) -> SearchStrategy[tuple[Fault, ...]]:
    """One to three faults of a JSON document; half of them keep a member's type, and so come past the first checks."""
    every = paths_of(document) or [()]
    paths = _any_of(every)
    fault: SearchStrategy[Fault] = st.one_of(
        st.builds(Put, paths, VALUES), st.builds(Drop, paths), st.builds(Copy, paths, paths),
        st.builds(Repeat, paths, TIMES),
        st.builds(End, paths), st.builds(Rename, paths, NAMES, st.booleans()), st.builds(Put, st.just(()), VALUES),
    )  # fmt: skip
    leaves = {path: member_of(document, path) for path in every}
    kept: list[SearchStrategy[Fault]] = []
    if numbers := [
        path for path, value in leaves.items() if isinstance(value, int | float) and not isinstance(value, bool)
    ]:
        some = _any_of(numbers)
        kept += [st.builds(Scale, some, FACTORS), st.builds(Put, some, PLAUSIBLE), st.builds(Copy, some, some)]
    if texts := [path for path, value in leaves.items() if isinstance(value, str)]:
        kept += [st.builds(Copy, _any_of(texts), _any_of(texts))]
    return _few(fault | st.one_of(kept) if kept else fault)


def faults_of_bytes(size: int) -> SearchStrategy[tuple[Fault, ...]]:
    """One to three faults of a file's bytes; half of them at its start, where its structure is."""
    at = st.integers(0, 200) | st.integers(0, size)
    words = st.sampled_from((0, 2**31 - 1, 2**32 - 1, 2**24)).map(lambda number: number.to_bytes(4, "little"))
    fault: SearchStrategy[Fault] = st.one_of(
        st.builds(Bytes, at, st.just(1), st.binary(min_size=1, max_size=1)), st.builds(Bytes, at, st.just(4), words),
        st.builds(Bytes, at, LENGTHS, st.binary(max_size=64)), st.builds(Twice, at, LENGTHS), st.builds(CutOff, at),
    )  # fmt: skip
    return _few(fault)


NOT_JSON: tuple[Fault, ...] = (
    Bytes(0, 2**40, b"[" * 100_000), Bytes(0, 2**40, b"9" * 5000), Bytes(0, 1, b'{"format": 1, '), Bytes(0, 2**40, b""),
    Bytes(0, 0, b"\xef\xbb\xbf"), Bytes(0, 0, b"\xff"),
)  # fmt: skip
"""Texts that are no JSON: nested beyond bounds, a number of 5000 digits, a key twice, nothing, a mark of
UTF-8's, none of it."""


def faults_of_arrays(arrays: Mapping[str, Any], words: Sequence[str] = ()) -> SearchStrategy[tuple[Fault, ...]]:
    """One to three faults of arrays by name; ``words`` are further texts in the place of an entry."""
    names = st.sampled_from(sorted(name for name, value in arrays.items() if isinstance(value, np.ndarray)))
    entries = NUMBERS | st.sampled_from(words) if words else NUMBERS
    change: SearchStrategy[Any] = st.one_of(
        st.builds(Shape, st.sampled_from(SHAPES), st.integers(0, 100)), st.builds(Type, st.sampled_from(TYPES)),
        st.builds(Entry, st.integers(0, 2000), entries), st.builds(Entry, st.integers(0, 2000), entries),
    )  # fmt: skip
    changed = st.builds(Array, names, change)
    paths = names.map(lambda name: (name,))
    others = st.builds(Drop, paths) | st.builds(Copy, paths, paths) | st.builds(Rename, paths, NAMES, st.booleans())
    return _few(changed | changed | others)


def inputs_of(whole: Mapping[str, bytes], views: Mapping[str, Sequence[str]]) -> SearchStrategy[Input]:
    """Faulty files of a folder: of one file, now and then of two. ``views`` are the views of each file
    beside its bytes."""
    every = {file: _file(file, whole[file], views.get(file, ())) for file in whole}
    one = st.sampled_from(sorted(every)).flatmap(every.__getitem__)
    alone = one.map(lambda change: [change])
    return alone | alone | alone | st.lists(one, min_size=2, max_size=2)


def _file(file: str, data: bytes, views: Sequence[str]) -> SearchStrategy[In]:
    some: list[SearchStrategy[In]] = []
    for view in views:
        document = whole_document(data, view)
        if view in DOCUMENTS:
            drawn = faults_of_json(document)
        elif view in ("unzipped", "torch pickle", "unpacked"):
            drawn = faults_of_bytes(len(document))
        else:
            drawn = faults_of_arrays(document, ("", "x", "\0") if view == "table" else ())
        # a file's structure breaks in more ways than its bytes
        some += [st.builds(In, st.just(file), st.just(view), drawn)] * 4
        if view == "tensors" and document["__metadata__"]:
            texts = st.sampled_from([("__metadata__", name) for name in sorted(document["__metadata__"])])
            told = _few(st.builds(Put, texts, st.text(max_size=6)) | st.builds(Drop, texts))
            some.append(st.builds(In, st.just(file), st.just(view), told))
    broken = faults_of_bytes(len(data))
    if "json" in views:
        broken |= st.sampled_from(NOT_JSON).map(lambda fault: (fault,))
    some.append(st.builds(In, st.just(file), st.just("bytes"), broken))
    return st.one_of(some)


def gone(whole: Mapping[str, bytes]) -> SearchStrategy[Input]:
    """A folder in which a file is missing."""
    return st.sampled_from(sorted(whole)).map(lambda file: [In(file, "")])


def _any_of(paths: list[Path]) -> SearchStrategy[Path]:
    # hypothesis writes out what it samples from, which for thousands of paths takes seconds
    return st.sampled_from(paths) if len(paths) < 500 else st.integers(0, len(paths) - 1).map(paths.__getitem__)


def _few(fault: SearchStrategy[Any]) -> SearchStrategy[tuple[Fault, ...]]:
    # one alone, most often: of several the first to be refused hides the others
    return (
        fault.map(lambda one: (one,))
        | fault.map(lambda one: (one,))
        | st.lists(fault, min_size=2, max_size=3).map(tuple)
    )
