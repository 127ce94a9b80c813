"""The benchmark of streets of many kinds: its table, worst first."""

from __future__ import annotations

from benchmarks.generality import table


def test_a_table_is_worst_first() -> None:
    rows = {
        "night-2": {"0-small": {"psnr": 30.0, "gain": 1.0, "shift-2m": 25.0}},
        "curve-3": {"0-small": {"psnr": 24.0, "gain": 4.0, "shift-2m": 21.0}},
        "002": {"0-small": {"psnr": 23.0, "gain": -0.5, "lost": 4.0}},
    }
    lines = table(rows, ["0-small"])
    assert [line.split(" | ")[0] for line in lines[2:]] == ["| 002", "| night-2", "| curve-3"]
    assert lines[0] == "| drive | dB above neighbours | PSNR | PSNR at 2 m | image recall lost a metre, % |"
    assert lines[2] == "| 002 | -0.50 | 23.00 | - | 4.0 |"


def test_of_two_variants_what_lost_most_comes_first() -> None:
    rows = {
        "night-2": {"0-small": {"psnr": 30.0}, "1-small": {"psnr": 30.5}},
        "curve-3": {"0-small": {"psnr": 24.0}, "1-small": {"psnr": 23.0}},
    }
    lines = table(rows, ["0-small", "1-small"])
    assert lines[2:] == ["| curve-3 | 24.00 / 23.00 |", "| night-2 | 30.00 / 30.50 |"]
