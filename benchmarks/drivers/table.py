"""Scores of several drivers as a Markdown table: a row each score, a column each driver."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import Any

Scores = Mapping[str, Any]
NONE = "–"
_UNIT = re.compile("_(m|rad)_s[23]?$")


def markdown(found: Mapping[str, Scores]) -> str:
    """Return the table of ``found``, scores as in `scores.json` by the drivers' names; below it the terms that composite scores
    leave out, and why a score is missing."""
    lines = [f"| | {' | '.join(map(_titled, found, found.values()))} |", f"|---{'|---' * len(found)}|"]
    for name, text in ROWS.items():
        lines.append(f"| {name} | {' | '.join(text(scores) for scores in found.values())} |")
    return "\n".join([*lines, "", *_left_out(found), *_reasons(found)])


def _titled(name: str, scores: Scores) -> str:
    return f"`{name}`, privileged" if scores["privileged"] else f"`{name}`"


def _number(value: float | None, form: str) -> str:
    return NONE if value is None else form.format(value)


def _collisions(scores: Scores) -> str:
    one = scores["collision"]
    return NONE if one["count"] is None else f"{one['count']}, {one['at_fault_count']}"


def _first(scores: Scores) -> str:
    for one in scores["collision"]["contacts"]:
        fault = "at fault" if one["at_fault"] else "at the start" if one["at_start"] else "not at fault"
        return f"{one['time_s']:.2f} s, {one['relative_speed_m_s']:.2f} m/s, {one['label']}, {one['side']}, {fault}"
    return "none"


def _ttc(scores: Scores) -> str:
    one = scores["time_to_collision"]
    return _number(one["minimum_s"], "{:.2f} s") + _at(one["minimum_at_s"])


def _static(scores: Scores) -> str:
    one = scores["static_collision"]
    if one["collided"] is None:
        return NONE
    return f"from {one['first_s']:.2f} s, {one['steps']} steps" if one["collided"] else "none"


def _off_road(scores: Scores) -> str:
    one = scores["off_road"]
    return f"from {one['first_s']:.2f} s, {one['steps_share']:.0%} of steps" if one["off_road"] else "never"


def _comfort(scores: Scores) -> str:
    one = scores["comfort"]
    if one["comfortable"] is None:
        return NONE
    if one["comfortable"]:
        return "yes"
    beyond = [name for name, part in one.items() if isinstance(part, dict) and not part["within"]]
    return f"no: {', '.join(_UNIT.sub('', name).replace('_', ' ') for name in beyond)}"


def _progress(scores: Scores) -> str:
    one = scores["progress"]
    if one["share"] is None:
        return NONE
    return f"{one['share']:.0%} ({one['distance_m']:.1f} of {one['recorded_distance_m']:.1f} m)"


def _deviation(part: str) -> Callable[[Scores], str]:
    def text(scores: Scores) -> str:
        one = scores["deviation"]
        most, last = one[f"{part}_max_m"], one[f"{part}_last_m"]
        return NONE if most is None else f"{most:.2f} m, {last:+.2f} m"

    return text


def _shares(scores: Scores) -> str:
    one = scores["unsupported"]
    return NONE if one["mean_share"] is None else f"{one['mean_share']:.1%}, {one['max_share']:.1%}"


def _unsupported_from(scores: Scores) -> str:
    one = scores["unsupported"]
    if one["mean_share"] is None:
        return NONE
    return "never" if one["above_20_percent_at_s"] is None else f"{one['above_20_percent_at_s']:.1f} s"


def _at(time_s: float | None) -> str:
    return "" if time_s is None else f" at {time_s:.1f} s"


ROWS: dict[str, Callable[[Scores], str]] = {
    "simulated": lambda scores: f"{scores['duration_s']:.1f} s, {scores['steps'] - 1} steps",
    "collisions, at fault": _collisions,
    "the first": _first,
    "minimum TTC": _ttc,
    "NCAP stars of 5": lambda scores: _number(scores["ncap"]["stars"], "{:.2f}"),
    "PDMS": lambda scores: _number(scores["pdms"]["score"], "{:.3f}"),
    "HD-score": lambda scores: _number(scores["hd_score"]["score"], "{:.3f}"),
    "comfortable": _comfort,
    "progress": _progress,
    "from the log along: most, last": _deviation("along"),
    "from the log across: most, last": _deviation("across"),
    "static collision": _static,
    "off the road": _off_road,
    "unsupported pixels: mean, most": _shares,
    "unsupported above 20 % from": _unsupported_from,
}


def _left_out(found: Mapping[str, Scores]) -> list[str]:
    lines = []
    for name, member in (("PDMS", "pdms"), ("HD-score", "hd_score")):
        terms = dict.fromkeys(term for scores in found.values() for term in scores[member]["left_out"])
        if terms:
            lines.append(f"- {name} without {', '.join(f'`{term}`' for term in terms)}.")
    return lines


def _reasons(found: Mapping[str, Scores]) -> list[str]:
    """Return a line for each score that could not be computed."""
    values = {
        "NCAP stars": ("ncap", "stars"),
        "PDMS": ("pdms", "score"),
        "HD-score": ("hd_score", "score"),
        "minimum TTC": ("time_to_collision", "minimum_s"),
        "unsupported pixels": ("unsupported", "mean_share"),
    }
    return [
        f"- {title} of `{driver}`: {scores[member]['reason']}."
        for title, (member, value) in values.items()
        for driver, scores in found.items()
        if scores[member][value] is None
    ]
