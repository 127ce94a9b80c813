"""Long lists of JSON documents, decoded member by member."""

from __future__ import annotations

import json
import tracemalloc
from collections.abc import Callable
from typing import Any

import pytest

from unisim_blender.core.json_file import members_of

LISTS: tuple[list[Any], ...] = ([], [1], [{"a": [1, {"b": "]}"}]}, None, "x", [[]], 2.5, True])


@pytest.mark.parametrize("indent", [None, 4])
@pytest.mark.parametrize("beside", [{}, {"z": [1, 2]}, {"a": {"rows": [3]}}])
@pytest.mark.parametrize("members", LISTS)
def test_members_are_those_of_the_whole(members: list[object], beside: dict[str, object], indent: int | None) -> None:
    for document in ({"rows": members, **beside}, {**beside, "rows": members}):
        text = f"\n {json.dumps(document, indent=indent)} \n"
        assert list(members_of(text, "rows")) == members


@pytest.mark.parametrize(
    "text",
    [
        '{"rows": [1, 2',
        '{"rows": [1 2]}',
        '{"rows": [1,]}',
        '{"rows": [1]',
        '{"rows": [1]} x',
        '{"rows": [1], }',
        "",
        "[",
    ],
)
def test_what_is_no_json_is_refused(text: str) -> None:
    with pytest.raises(ValueError):
        list(members_of(text, "rows"))


@pytest.mark.parametrize("text", ["{}", '{"rows": 3}', '{"rows": {"a": 1}}', "[1]"])
def test_what_has_no_such_list_is_refused(text: str) -> None:
    with pytest.raises((KeyError, TypeError)):
        list(members_of(text, "rows"))


def test_a_long_list_takes_less_memory_than_all_at_once() -> None:
    rows = [{"name": f"row {i}", "place": [0.1 * i, 0.2, 0.3], "time": 10**15 + i} for i in range(5000)]
    text = json.dumps({"rows": rows})

    def peak(read: Callable[[], object]) -> int:
        tracemalloc.start()
        read()
        used = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return used

    one_by_one = peak(lambda: sum(row["time"] for row in members_of(text, "rows")))
    assert one_by_one * 10 < peak(lambda: json.loads(text))
