"""All scores of a rollout as one document, and as a table of text."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from .collision import Collisions, collisions, minimum_distance, ncap_stars, time_to_collision
from .composite import alpasim_score, hd_score, pdms
from .driving import LIMITS, Comfort, comfort, deviation, path_places, plan_consistency, progress
from .off_road import CORRIDOR_M, Occupied, RoadTest, off_road, static_collision
from .record import Record

TOO_MUCH = 0.2
"""From this share of unsupported pixels on, what a rollout shows is more guess than evidence."""


MIN_VALID_STEPS = 5
"""Least number of valid steps that are scored apart."""
VALID_CONFIDENCE = 0.7
"""Least mean confidence of what the driver is shown at a step, for the step to be valid."""


@dataclass(frozen=True)
class Validity:
    """How far what the driver was shown is right, by the confidence of pixels and returns, averaged over sensors: its mean
    and least over the steps; ``invalid_steps``, the number with less than `VALID_CONFIDENCE`;
    ``valid_steps`` and ``valid_until_s``, how many come before the first invalid one, and the time of the last of them.
    Members are None, with a ``reason``, where nothing was measured."""

    mean_confidence: float | None = None
    min_confidence: float | None = None
    invalid_steps: int | None = None
    valid_steps: int | None = None
    valid_until_s: float | None = None
    reason: str | None = None


def validity(record: Record) -> Validity:
    """Return how far a rollout is valid: what follows an invalid step depends on what was invented."""
    shown = np.array([np.nan if each is None else each for each in record.confidence or ()], np.float64)
    if not np.isfinite(shown).any():
        return Validity(reason="the pass confidence was not rendered")
    invalid = shown < VALID_CONFIDENCE
    steps = int(invalid.argmax()) if invalid.any() else len(shown)
    until_s = float(record.times_s[steps - 1]) if steps else None
    return Validity(float(np.nanmean(shown)), float(np.nanmin(shown)), int(invalid.sum()), steps, until_s)


@dataclass(frozen=True)
class Unsupported:
    """Mean and greatest share of unsupported pixels over the steps at which the driver was shown some, and the first
    time at which it is above `TOO_MUCH`; None where it never is. Shares that are None have a ``reason``."""

    mean_share: float | None = None
    max_share: float | None = None
    above_20_percent_at_s: float | None = None
    reason: str | None = None


def unsupported(record: Record) -> Unsupported:
    """How far a rollout is evidence: the shares of unsupported pixels that the driver looked at."""
    shown = [(t, s) for t, s in zip(record.times_s, record.unsupported_share or (), strict=False) if s is not None]
    if not shown:
        return Unsupported(reason="the driver was shown no pixels whose support was measured")
    times_s, shares = np.array(shown, np.float64).T
    above = np.flatnonzero(shares > TOO_MUCH)
    return Unsupported(float(shares.mean()), float(shares.max()), float(times_s[above[0]]) if len(above) else None)


def summarise(
    record: Record,
    *,
    occupied: Occupied | None = None,
    on_road: RoadTest | None = None,
    corridor_width_m: float = CORRIDOR_M,
    reference_speed_m_s: float | None = None,
) -> dict[str, Any]:
    """All scores of a rollout: plain objects, lists, strings and finite numbers, as JSON has them; units are in the
    names.

    Members are always the same, but for ``valid_part``: the scores of the steps before the first invalid one
    (`validity`), where there is one and at least `MIN_VALID_STEPS` come before it. A number that cannot be computed is
    None, and its object's ``reason`` says why.
    ``occupied``: see `static`; ``on_road`` and ``corridor_width_m``: see `off_road`; ``reference_speed_m_s``: see
    `ncap`. Raises `RecordError` where one of the two functions answers what it may not.
    """
    places = path_places(record)
    crashes, smooth, route = collisions(record), comfort(record), progress(record, places)
    times, road = time_to_collision(record, crashes), off_road(record, on_road, corridor_width_m)
    static = static_collision(record, occupied)
    documents: dict[str, Any] = {
        "pdms": pdms(crashes, times, smooth, route),
        "hd_score": hd_score(record, route.share),
        "alpasim_score": alpasim_score(crashes, road, route, static),
        "ncap": ncap_stars(record, crashes, reference_speed_m_s),
        "time_to_collision": times,
        "minimum_distance": minimum_distance(record),
        "static_collision": static,
        "off_road": road,
        "progress": route,
        "deviation": deviation(record, places),
        "plan_consistency": plan_consistency(record),
        "unsupported": unsupported(record),
        "validity": (valid := validity(record)),
    }
    head = {
        "steps": len(record.times_us),
        "start_s": float(record.times_s[0]),
        "duration_s": float(record.times_s[-1] - record.times_s[0]),
        "actors": len(record.tracks.uids),
    }
    # lists for tuples
    scores = json.loads(json.dumps({name: asdict(score) for name, score in documents.items()}))
    if valid.invalid_steps and valid.valid_steps and valid.valid_steps >= MIN_VALID_STEPS:
        # nested once: the part has no invalid step
        scores["valid_part"] = summarise(
            record.until(valid.valid_steps), occupied=occupied, on_road=on_road, corridor_width_m=corridor_width_m,
            reference_speed_m_s=reference_speed_m_s,
        )  # fmt: skip
    return head | {"collision": _collision(crashes), "comfort": _comfort(smooth)} | scores


def _collision(collisions: Collisions) -> dict[str, Any]:
    contacts, at_fault = collisions.contacts, collisions.at_fault
    return {
        "count": None if contacts is None else len(contacts),
        "at_fault_count": None if at_fault is None else len(at_fault),
        "first_s": contacts[0].time_s if contacts else None,
        "no_at_fault_collision": collisions.no_at_fault_collision,
        "contacts": [asdict(contact) for contact in contacts or ()],
        "reason": collisions.reason,
    }


def _comfort(comfort: Comfort) -> dict[str, Any]:
    ranges = {}
    for name, (lowest, highest) in LIMITS.items():
        measured = comfort.ranges and comfort.ranges[name]
        ranges[name] = {
            "least": measured.least if measured else None,
            "greatest": measured.greatest if measured else None,
            "lower_limit": lowest,
            "upper_limit": highest,
            "within": measured.within if measured else None,
        }
    return {"comfortable": comfort.comfortable, **ranges, "reason": comfort.reason}


UNITS = {"m_s2": "m/s²", "m_s3": "m/s³", "rad_s": "rad/s", "rad_s2": "rad/s²"}


def score_table(scores: dict[str, Any]) -> str:
    """Lines of text, a score each, of what `summary.summarise` returned or wrote as JSON. A score that could not be
    computed is a dash and the reason."""
    rows = [("rollout", f"{scores['steps']} steps, {scores['duration_s']:.2f} s, {scores['actors']} actors")]
    rows += _composites(scores) + _contacts(scores["collision"]) + _safety(scores) + _comfort_rows(scores["comfort"])
    rows += _path(scores) + _rest(scores)
    width = max(len(name) for name, _ in rows)
    return "\n".join(f"{name:<{width}}  {text}" for name, text in rows) + "\n"


Rows = list[tuple[str, str]]


def _composites(scores: dict[str, Any]) -> Rows:
    rows = []
    for name, member in (("PDMS", "pdms"), ("HD-score", "hd_score"), ("AlpaSim's score", "alpasim_score")):
        score = scores[member]
        left_out = (
            f" (without {', '.join(score['left_out'])})" if score["left_out"] and score["score"] is not None else ""
        )
        rows.append((name, _or_reason(score, "score", "{:.3f}") + left_out))
        rows += [_broken(term) for term in score.get("broken", ())]
    return [*rows, ("NCAP stars", _or_reason(scores["ncap"], "stars", "{:.2f} of 5"))]


def _broken(term: dict[str, Any]) -> tuple[str, str]:
    """The row of a term that took something off a score."""
    when = "" if term["at_s"] is None else f", first at {term['at_s']:.2f} s"
    by = "" if term["by"] is None else f" ({term['by'].replace('_', ' ') if term['by'] in LIMITS else term['by']})"
    return f"  {term['term'].replace('_', ' ')}", f"{term['value']:.3f}{when}{by}"


def _contacts(collision: dict[str, Any]) -> Rows:
    if collision["count"] is None:
        return [("collisions", _dash(collision))]
    rows = [("collisions", f"{collision['count']}, {collision['at_fault_count']} at fault")]
    for contact in collision["contacts"]:
        fault = "at fault" if contact["at_fault"] else "from the start on" if contact["at_start"] else "not at fault"
        who, speed = f"{contact['actor']} ({contact['label']})", f"{contact['relative_speed_m_s']:.2f} m/s"
        rows.append((f"  at {contact['time_s']:.3f} s", f"{who} {contact['side']}, {speed}, {fault}"))
    return rows


def _safety(scores: dict[str, Any]) -> Rows:
    ttc, static, road = scores["time_to_collision"], scores["static_collision"], scores["off_road"]
    least = _dash(ttc)
    if ttc["minimum_s"] is not None:
        bound = "never below 1 s" if ttc["within_bound"] else f"below 1 s from {ttc['below_bound_at_s']:.2f} s on"
        least = f"{ttc['minimum_s']:.2f} s at {ttc['minimum_at_s']:.2f} s ({ttc['actor']}), {bound}"
    gap = scores.get("minimum_distance")
    near = "- (scored before it was measured)" if gap is None else _dash(gap)
    if gap is not None and gap["minimum_m"] is not None:
        near = f"{gap['minimum_m']:.2f} m at {gap['minimum_at_s']:.2f} s ({gap['actor']})"
    hit = _dash(static)
    if static["collided"] is not None:
        hit = f"at {static['first_s']:.2f} s, {static['steps']} steps" if static["collided"] else "none"
    off = f"at {road['first_s']:.2f} s, {road['steps_share']:.1%} of the steps" if road["off_road"] else "never"
    if road["farthest_m"]:
        off += f", {road['farthest_m']:.2f} m outside"
    return [
        ("least time to collision", least),
        ("least distance", near),
        ("static collision", hit),
        ("off the road", f"{off} ({road['method'].replace('_', ' ')})"),
    ]


def _comfort_rows(comfort: dict[str, Any]) -> Rows:
    if comfort["comfortable"] is None:
        return [("comfortable", _dash(comfort))]
    rows = [("comfortable", "yes" if comfort["comfortable"] else "no")]
    for name in LIMITS:
        quantity, unit = _named(name)
        part = comfort[name]
        limits = f"limits {part['lower_limit']:g} to {part['upper_limit']:g}"
        mark = "" if part["within"] else ", exceeded"
        rows.append((f"  {quantity}", f"{part['least']:.2f} to {part['greatest']:.2f} {unit} ({limits}{mark})"))
    return rows


def _path(scores: dict[str, Any]) -> Rows:
    progress, away = scores["progress"], scores["deviation"]
    got = _dash(progress)
    if progress["share"] is not None:
        got = f"{progress['share']:.1%} ({progress['distance_m']:.2f} m of {progress['recorded_distance_m']:.2f} m)"
    rows = [("progress", got)]
    for name in ("along", "across"):
        text = _dash(away)
        if away[f"{name}_max_m"] is not None:
            most, mean, last = (away[f"{name}_{part}_m"] for part in ("max", "mean", "last"))
            text = f"{most:.2f} m at most, {mean:.2f} m on average, {last:+.2f} m at last"
        rows.append((f"from the log, {name}", text))
    return rows


def _rest(scores: dict[str, Any]) -> Rows:
    plans, seen = scores["plan_consistency"], scores["unsupported"]
    text = _dash(plans)
    if plans["mean_m"] is not None:
        text = f"{plans['mean_m']:.3f} m on average, {plans['max_m']:.3f} m at most"
        if plans["end_point_mean_m"] is not None:
            text += f", {plans['end_point_mean_m']:.3f} m after 5 s"
    rows = [("between successive plans", text)]
    text = _dash(seen)
    if seen["mean_share"] is not None:
        when = seen["above_20_percent_at_s"]
        above = "never above 20 %" if when is None else f"above 20 % at {when:.2f} s"
        text = f"{seen['mean_share']:.1%} on average, {seen['max_share']:.1%} at most, {above}"
    rows.append(("unsupported pixels", text))
    valid = scores.get("validity")
    if valid is None:
        return rows
    text = _dash(valid)
    if valid["mean_confidence"] is not None:
        text = f"{valid['mean_confidence']:.1%} on average, {valid['min_confidence']:.1%} at least, "
        text += f"{valid['invalid_steps']} invalid steps" if valid["invalid_steps"] else "no invalid step"
    rows.append(("confidence", text))
    part = scores.get("valid_part")
    if part is not None:
        rows.append(("valid part", f"{part['steps']} steps, {part['duration_s']:.2f} s"))
        rows += [(f"  {name}", text) for name, text in (*_composites(part), *_contacts(part["collision"]))]
    return rows


def _or_reason(score: dict[str, Any], member: str, form: str) -> str:
    return _dash(score) if score[member] is None else form.format(score[member])


def _dash(score: dict[str, Any]) -> str:
    return f"- ({score['reason']})"


def _named(name: str) -> tuple[str, str]:
    """A quantity's words and unit, of a name that ends in it."""
    unit = next(unit for unit in sorted(UNITS, key=len, reverse=True) if name.endswith(f"_{unit}"))
    return name.removesuffix(f"_{unit}").replace("_", " "), UNITS[unit]
