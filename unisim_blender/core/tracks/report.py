"""The report of found tracks: one page of HTML with a picture from above, tracks over time, and their certainty."""

from __future__ import annotations

import base64
import io
from collections.abc import Sequence
from html import escape

import numpy as np
from PIL import Image

from ..data.log import Log
from ..geometry import FloatArray, box_corners, spread_indices
from .box_file import Track
from .scans import read_scan, scans_of

PIXELS = 1400
"""Longest side of the picture."""
SWEEPS = 12
"""Number of sweeps whose returns are drawn."""
MARGIN_M = 10.0
ROW, LEFT, WIDTH = 16, 150, 700
STYLE = (
    "body{font:14px sans-serif;margin:24px}svg{max-width:100%;height:auto}text{font:11px sans-serif}"
    "table{border-collapse:collapse}td,th{padding:2px 10px;text-align:right}"
)


def report(log: Log, tracks: Sequence[Track]) -> str:
    """Return the page: ``log`` gives returns and times. Raises what its reader raises."""
    counts: dict[tuple[str, str], int] = {}
    for track in tracks:
        key = track.actor.label, "moving" if track.actor.is_moving else "standing"
        counts[key] = counts.get(key, 0) + 1
    rows = "".join(f"<tr><td>{escape(label)}<td>{state}<td>{count}" for (label, state), count in sorted(counts.items()))
    return (
        f'<!doctype html><meta charset="utf-8"><title>Tracks of {escape(log.drive.name)}</title><style>{STYLE}</style>'
        f"<h1>Tracks of {escape(log.drive.name)}</h1><table><tr><th>class<th>state<th>tracks{rows}</table>"
        "<p>Green is certain, red is not. Lines are the ways of what moves; the box is where it is in the middle of its "
        f"time.</p><h2>From above</h2>{_above(log, tracks)}<h2>Over time</h2>{_times(log, tracks)}"
    )


def _colour(certainty: float) -> str:
    return f"hsl({120 * certainty:.0f},85%,38%)"


def _above(log: Log, tracks: Sequence[Track]) -> str:
    refs = scans_of(log)
    points = np.concatenate([read_scan(log, refs[at]).points[:, :2] for at in spread_indices(len(refs), SWEEPS)])
    places = [track.actor.world_from_actor.positions[:, :2] for track in tracks]
    shown = np.concatenate([log.drive.world_from_ego.positions[:, :2], *places])
    low, high = shown.min(0) - MARGIN_M, shown.max(0) + MARGIN_M
    scale = PIXELS / float((high - low).max())
    width, height = np.ceil((high - low) * scale).astype(int).tolist()

    def at(xy: FloatArray) -> FloatArray:
        return np.stack([xy[:, 0] - low[0], high[1] - xy[:, 1]], 1) * scale

    pixel = at(points).astype(np.int64)
    inside = ((pixel >= 0) & (pixel < (width, height))).all(1)
    picture = np.full((height, width), 255, np.uint8)
    picture[pixel[inside, 1], pixel[inside, 0]] = 170
    file = io.BytesIO()
    Image.fromarray(picture).save(file, "PNG")
    data = base64.b64encode(file.getvalue()).decode()
    parts = [f'<image href="data:image/png;base64,{data}" width="{width}" height="{height}"/>']
    parts.append(
        f'<polyline points="{_svg(at(log.drive.world_from_ego.positions[:, :2]))}" fill="none" stroke="#36c"/>'
    )
    for track in tracks:
        actor, colour = track.actor, _colour(track.certainty)
        middle = actor.world_from_actor.at((actor.start_s + actor.end_s) / 2)
        corners = box_corners(middle, actor.size_m)[[0, 2, 6, 4]]
        front = middle[:3, :3] @ np.array([actor.size_m[0] / 2, 0, 0]) + middle[:3, 3]
        title = f"<title>{escape(actor.uid)}: {track.certainty:.2f}</title>"
        parts.append(
            f'<polygon points="{_svg(at(corners))}" fill="none" stroke="{colour}" stroke-width="2">{title}</polygon>'
        )
        way = _svg(at(np.stack([middle[:3, 3], front])))
        parts.append(f'<polyline points="{way}" fill="none" stroke="{colour}" stroke-width="2"/>')
        if actor.is_moving:
            way = _svg(at(actor.world_from_actor.positions))
            parts.append(f'<polyline points="{way}" fill="none" stroke="{colour}"/>')
        x, y = at(middle[None, :3, 3])[0]
        parts.append(f'<text x="{x:.0f}" y="{y:.0f}">{escape(actor.uid)}</text>')
    return f'<svg viewBox="0 0 {width} {height}" width="{width}">{"".join(parts)}</svg>'


def _svg(xy: FloatArray) -> str:
    return " ".join(f"{x:.1f},{y:.1f}" for x, y in xy.tolist())


def _times(log: Log, tracks: Sequence[Track]) -> str:
    frames = [log.drive.time_s[frame] for frame in log.drive.frames]
    start, span = frames[0], max(frames[-1] - frames[0], 1e-3)
    parts = []
    for row, track in enumerate(sorted(tracks, key=lambda track: (not track.actor.is_moving, -track.certainty))):
        actor, y = track.actor, row * ROW
        x = LEFT + WIDTH * np.clip((np.array([actor.start_s, actor.end_s]) - start) / span, 0, 1)
        parts.append(
            f'<text x="0" y="{y + 11}">{escape(actor.uid)}</text><rect x="{x[0]:.0f}" y="{y + 3}" height="{ROW - 6}" '
            f'width="{max(x[1] - x[0], 2):.0f}" fill="{_colour(track.certainty)}"/><text x="{LEFT + WIDTH + 8}" '
            f'y="{y + 11}">{track.certainty:.2f}, {track.returns} returns of {track.sweeps} sweeps</text>'
        )
    height = len(tracks) * ROW + 4
    return f'<svg viewBox="0 0 {LEFT + WIDTH + 240} {height}" width="{LEFT + WIDTH + 240}">{"".join(parts)}</svg>'
