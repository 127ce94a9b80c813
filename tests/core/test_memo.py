"""Memoized results while many scenarios are opened."""

from __future__ import annotations

import pytest

from unisim_blender.core.memo import memo_scope, memoized

CALLS: list[tuple[object, ...]] = []


@memoized
def read(name: str, part: int = 0) -> list[str]:
    CALLS.append((name, part))
    if name == "broken":
        raise ValueError(name)
    return [name]


def test_what_is_read_is_kept_as_long_as_it_is_asked_for() -> None:
    CALLS.clear()
    with memo_scope():
        first = read("a")
        with memo_scope():
            assert read("a") is first
        assert read("a") is first and read("a", part=1) == ["a"]
        for _ in range(2):
            with pytest.raises(ValueError):
                read("broken")
    assert CALLS == [("a", 0), ("a", 1), ("broken", 0), ("broken", 0)]
    assert read("a") is not first
