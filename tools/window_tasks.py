"""Writes the table of docs/measurements/window_tasks.md from what `make test-ui-all` measured.

python tools/window_tasks.py out/ui/tasks.json out/ui-sid/tasks.json docs/measurements/window_tasks.md
"""

from __future__ import annotations

import argparse
import json
import re
from pathlib import Path
from statistics import median
from typing import Any

COLUMNS = ("seconds", "longest block, s", "redraw alone, s", "extension, s")
BEYOND_REDRAW_S = 0.1


def table(first: dict[str, Any], second: dict[str, Any], names: tuple[str, str]) -> str:
    """A row for each task that both Blenders did, in the first one's order."""
    heads = [
        "task",
        "presses",
        *(f"{name}: {COLUMNS[0]}" if not i else c for name in names for i, c in enumerate(COLUMNS)),
    ]
    lines = [f"| {' | '.join(heads)} |", "|" + "---|" * len(heads)]
    for task in first:
        if task in second:
            cells = [task, str(first[task]["presses"])]
            for row in (first[task], second[task]):
                cells += [
                    f"{row['seconds']:.1f}",
                    *(f"{row[key]:.2f}" for key in ("longest_block_s", "redraw_s", "ours_s")),
                ]
            lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def summary(rows: dict[str, Any]) -> str:
    """How many tasks block the window for little longer than a redraw, and how long redraws take."""
    redraws = [row["redraw_s"] for row in rows.values()]
    little = sum(row["longest_block_s"] <= row["redraw_s"] + BEYOND_REDRAW_S for row in rows.values())
    worst = max(rows, key=lambda task: rows[task]["ours_s"])
    return (
        f"{len(rows)} tasks; longest block at most {BEYOND_REDRAW_S} s beyond a redraw in {little}; redraw "
        f"{min(redraws):.2f} to {max(redraws):.2f} s, median {median(redraws):.2f} s; extension at most "
        f"{rows[worst]['ours_s']:.2f} s ({worst})"
    )


def main() -> None:
    """Replace the table and print the summaries."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("first", type=Path)
    parser.add_argument("second", type=Path)
    parser.add_argument("page", type=Path)
    parser.add_argument("--names", nargs=2, default=("4.3", "5.2"), metavar=("FIRST", "SECOND"))
    arguments = parser.parse_args()
    first, second = (json.loads(path.read_text()) for path in (arguments.first, arguments.second))
    text = arguments.page.read_text(encoding="utf-8")
    new = f"<!-- tasks -->\n{table(first, second, tuple(arguments.names))}\n<!-- end of tasks -->"
    changed, count = re.subn(r"<!-- tasks -->.*<!-- end of tasks -->", lambda _: new, text, flags=re.DOTALL)
    if not count:
        parser.error(f"{arguments.page} has no place for the table: <!-- tasks --> ... <!-- end of tasks -->")
    arguments.page.write_text(changed, encoding="utf-8")
    for name, rows in zip(arguments.names, (first, second), strict=True):
        print(f"{name}: {summary(rows)}")


if __name__ == "__main__":
    main()
