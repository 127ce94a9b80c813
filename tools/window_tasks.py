"""Write what `make test-ui-all` measured: every task as JSON, and a summary into docs/measurements/window_tasks.md.

python tools/window_tasks.py out/ui/tasks.json out/ui-sid/tasks.json docs/measurements/window_tasks.md
"""

from __future__ import annotations

import argparse
import json
import re
from pathlib import Path
from statistics import median
from typing import Any

FIGURES = ("presses", "seconds", "longest_block_s", "redraw_s", "ours_s")
BEYOND_REDRAW_S = 0.1
WORST_TASKS = 5
PLACE = re.compile(r"<!-- tasks -->.*<!-- end of tasks -->", re.DOTALL)

Tasks = dict[str, Any]


def figures(runs: dict[str, Tasks]) -> dict[str, Any]:
    """Return the figures of each task by version of Blender, in the order of the first version that did it."""
    tasks = dict.fromkeys(task for rows in runs.values() for task in rows)
    return {
        task: {name: {key: rows[task][key] for key in FIGURES} for name, rows in runs.items() if task in rows}
        for task in tasks
    }


def summary(runs: dict[str, Tasks], data: str) -> str:
    """Return the page's tables: figures of all tasks, and the tasks with the longest blocks beyond a redraw."""
    lines = [f"| all tasks ([each of them]({data})) | {' | '.join(runs)} |", "|---" * (len(runs) + 1) + "|"]
    columns = [_of_all(rows) for rows in runs.values()]
    lines += [f"| {label} | {' | '.join(column[label] for column in columns)} |" for label in columns[0]]
    lines += ["", f"| longest blocks | {' | '.join(f'{name}: s; a redraw' for name in runs)} |", lines[1]]
    for task in _worst(next(iter(runs.values()))):
        cells = (
            f"{rows[task]['longest_block_s']:.2f}; {rows[task]['redraw_s']:.2f}" if task in rows else ""
            for rows in runs.values()
        )
        lines.append(f"| {task} | {' | '.join(cells)} |")
    return "\n".join(lines)


def _of_all(rows: Tasks) -> dict[str, str]:
    redraws = [row["redraw_s"] for row in rows.values()]
    short = sum(row["longest_block_s"] <= row["redraw_s"] + BEYOND_REDRAW_S for row in rows.values())
    worst = max(rows, key=lambda task: rows[task]["ours_s"])
    return {
        "tasks, presses": f"{len(rows)}, {sum(row['presses'] for row in rows.values())}",
        "redraw alone: median, least, most": f"{median(redraws):.2f}, {min(redraws):.2f}, {max(redraws):.2f} s",
        f"longest block at most {BEYOND_REDRAW_S} s beyond a redraw": f"{short} tasks",
        "extension at work in a longest block, at most": f"{rows[worst]['ours_s']:.2f} s ({worst})",
    }


def _worst(rows: Tasks) -> list[str]:
    return sorted(rows, key=lambda task: rows[task]["redraw_s"] - rows[task]["longest_block_s"])[:WORST_TASKS]


def main() -> None:
    """Write the JSON file beside the page, and the tables into it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("first", type=Path)
    parser.add_argument("second", type=Path)
    parser.add_argument("page", type=Path)
    parser.add_argument("--names", nargs=2, default=("4.3", "5.2"), metavar=("FIRST", "SECOND"))
    arguments = parser.parse_args()
    first, second = (json.loads(path.read_text()) for path in (arguments.first, arguments.second))
    runs = dict(zip(arguments.names, (first, second), strict=True))
    text = arguments.page.read_text(encoding="utf-8")
    data = arguments.page.with_suffix(".json")
    new = f"<!-- tasks -->\n{summary(runs, data.name)}\n<!-- end of tasks -->"
    changed, count = PLACE.subn(lambda _: new, text)
    if not count:
        parser.error(f"{arguments.page} has no place for the tables: <!-- tasks --> ... <!-- end of tasks -->")
    lines = (f"{json.dumps(task)}: {json.dumps(row)}" for task, row in figures(runs).items())
    data.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")
    arguments.page.write_text(changed, encoding="utf-8")
    print(f"{data}\n{summary(runs, data.name)}")


if __name__ == "__main__":
    main()
