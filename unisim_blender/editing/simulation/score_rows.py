"""The scores of a rollout as the panel says them: a row each, of a name and a value."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ..texts import Text, translatable

ScoreRow = tuple[str, str, bool]
"""Name, value, and whether it is a warning."""


def score_rows(scores: Mapping[str, Any], names: Mapping[str, str]) -> list[ScoreRow]:
    """Return the rows of what `read_scores` returned; ``names`` are the actors' for people, by id. What could not be computed is
    a dash."""
    rows: list[ScoreRow] = []

    def add(name: str, value: str | None, warns: bool = False) -> None:
        rows.append((name, "–" if value is None else value, warns))

    hits = _member(scores, "collision")
    count = hits.get("count")
    told = (
        None
        if count is None
        else Text("{count}, at fault: {fault}", count=count, fault=hits.get("at_fault_count") or 0)
    )
    add(translatable("Collisions"), told, bool(count))
    for one in hits.get("contacts") or ():
        who = names.get(one["actor"], one["actor"])
        words = Text("{name}, {speed:.1f} m/s", name=who, speed=one["relative_speed_m_s"])
        rows.append((Text("At {time:.1f} s", time=one["time_s"]), words, True))
    least = _member(scores, "time_to_collision")
    seconds = least.get("minimum_s")
    add(
        translatable("Least TTC"),
        None
        if seconds is None
        else Text("{seconds:.1f} s at {time:.1f} s", seconds=seconds, time=least["minimum_at_s"]),
        seconds is not None and seconds < 1,
    )
    for name, member in (("PDMS", "pdms"), ("HD-score", "hd_score")):
        value = _member(scores, member).get("score")
        add(name, None if value is None else f"{value:.2f}")
    stars = _member(scores, "ncap").get("stars")
    add(translatable("NCAP stars"), None if stars is None else f"{stars:.1f} / 5")
    share = _member(scores, "progress").get("share")
    add(translatable("Progress"), None if share is None else f"{100 * share:.0f} %")
    away = _member(scores, "deviation").get("across_max_m")
    add(translatable("Off the log"), None if away is None else Text("{length:.1f} m at most", length=away))
    road = _member(scores, "off_road")
    if road.get("off_road") is not None:
        add(translatable("Road"), Text("left it") if road["off_road"] else Text("kept to it"), bool(road["off_road"]))
    smooth = _member(scores, "comfort").get("comfortable")
    add(
        translatable("Comfort"),
        None if smooth is None else Text("within limits") if smooth else Text("limits exceeded"),
    )
    unseen = _member(scores, "unsupported").get("mean_share")
    add(translatable("Unsupported"), None if unseen is None else f"{100 * unseen:.0f} %", bool(unseen and unseen > 0.2))
    return rows


def _member(scores: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    found = scores.get(name)
    return found if isinstance(found, dict) else {}
