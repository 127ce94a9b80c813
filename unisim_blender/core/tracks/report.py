"""The report of found tracks: one page of HTML with a picture from above, tracks over time, their certainty, and what one
sensor alone saw."""

from __future__ import annotations

import base64
import io
from collections.abc import Sequence
from html import escape

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from ..data.log import Log
from ..geometry import FloatArray, box_corners, invert_pose, points_in_box, spread_indices
from .box_file import Track
from .scans import SweepStore, read_scan, scans_of

PIXELS = 1400
"""Longest side of the picture."""
SWEEPS = 12
"""Number of sweeps whose returns are drawn."""
MARGIN_M, LETTERS_PX = 10.0, 11
ROW, LEFT, WIDTH = 16, 150, 700
STYLE = (
    "body{font:14px sans-serif;margin:24px}svg,img{max-width:100%;height:auto}text{font:11px sans-serif}"
    "table{border-collapse:collapse}td,th{padding:2px 10px;text-align:right}"
)


def report(log: Log, tracks: Sequence[Track]) -> str:
    """Return the page: ``log`` gives returns and times. Raises what its reader raises."""
    seen = seen_by(log, tracks)
    rows: dict[tuple[str, str], list[str]] = {}
    for track in tracks:
        rows.setdefault((track.actor.label, "moving" if track.actor.is_moving else "standing"), []).append(
            track.actor.uid
        )
    table = "".join(
        f"<tr><td>{escape(label)}<td>{state}<td>{len(uids)}<td>{sum(len(seen[uid]) < 2 for uid in uids)}"
        for (label, state), uids in sorted(rows.items())
    )
    alone = "; ".join(
        f"{escape(uid)}: {escape(next(iter(names), 'none'))}" for uid, names in seen.items() if len(names) < 2
    )
    return (
        f'<!doctype html><meta charset="utf-8"><title>Tracks of {escape(log.drive.name)}</title><style>{STYLE}</style>'
        f"<h1>Tracks of {escape(log.drive.name)}</h1><table><tr><th>class<th>state<th>tracks<th>seen by one sensor{table}"
        "</table><p>Green is certain, red is not. Lines are the ways of what moves; the box is where it is in the middle of "
        f"its time.</p><h2>From above</h2>{_above(log, tracks)}<h2>Over time</h2>{_times(log, tracks)}"
        "<h2>Seen by one sensor alone</h2><p>By the returns in the box, and by whether its centre is in a camera's image, in "
        f"the middle of a track's time: {alone or 'none'}.</p>"
    )


def seen_by(log: Log, tracks: Sequence[Track]) -> dict[str, set[str]]:
    """Return the sensors that see each track in the middle of its time, by id: LiDARs with a return in its box, and cameras
    with its centre in the image."""
    store, seen = SweepStore(log), dict[str, set[str]]()
    first, last = (log.drive.time_s[log.drive.frames[at]] for at in (0, -1))
    for actor in sorted((track.actor for track in tracks), key=lambda actor: actor.start_s):
        path, names = actor.world_from_actor, seen.setdefault(actor.uid, set())
        middle_s = (max(actor.start_s, first) + min(actor.end_s, last)) / 2
        for number in store.nearest(middle_s):
            pose = path.at(store.passing_s(number, path.positions_at(store.times_s[number])[:2]))
            returns = store.near(number, pose[:2, 3], float(np.linalg.norm(actor.size_m))).points
            if points_in_box(returns, pose, actor.size_m).any():
                names.add(store.refs[number].lidar)
        for name, camera in log.drive.cameras.items():
            times = [camera.time_s[frame] for frame in log.image_frames(name)]
            time = min(times, key=lambda t: abs(t - middle_s), default=middle_s)
            pose = invert_pose(camera.world_from_camera.at(time)) @ path.at(time)
            u, v, valid = camera.model.project(pose[None, :3, 3])
            if times and valid[0] and 0 <= u[0] <= camera.model.width and 0 <= v[0] <= camera.model.height:
                names.add(name)
    return {track.actor.uid: seen[track.actor.uid] for track in tracks}


def _rgb(certainty: float) -> str:
    return f"hsl({120 * certainty:.0f},85%,38%)"


def _above(log: Log, tracks: Sequence[Track]) -> str:
    """Return the picture: returns of some sweeps, boxes, ways and names."""
    refs = scans_of(log)
    points = [read_scan(log, refs[at]).points[:, :2] for at in spread_indices(len(refs), SWEEPS)]
    ego = log.drive.world_from_ego.positions[:, :2]
    shown = np.concatenate([ego, *(track.actor.world_from_actor.positions[:, :2] for track in tracks)])
    low, high = shown.min(0) - MARGIN_M, shown.max(0) + MARGIN_M
    scale = PIXELS / float((high - low).max())
    width, height = np.ceil((high - low) * scale).astype(int).tolist()

    def at(xy: FloatArray) -> FloatArray:
        return np.stack([xy[:, 0] - low[0], high[1] - xy[:, 1]], 1) * scale

    pixel = at(np.concatenate([np.zeros((0, 2)), *points])).astype(np.int64)
    inside = ((pixel >= 0) & (pixel < (width, height))).all(1)
    grey = np.full((height, width, 3), 255, np.uint8)
    grey[pixel[inside, 1], pixel[inside, 0]] = 170
    picture = Image.fromarray(grey)
    pen, font = ImageDraw.Draw(picture), ImageFont.load_default(LETTERS_PX)

    def line(xy: FloatArray, colour: str, pixels: int) -> None:
        pen.line([tuple(place) for place in at(xy).tolist()], fill=colour, width=pixels)

    line(ego, "#3366cc", 2)
    for track in tracks:
        actor, colour = track.actor, _rgb(track.certainty)
        if actor.is_moving:
            line(actor.world_from_actor.positions[:, :2], colour, 1)
        middle = actor.world_from_actor.at((max(actor.start_s, -1e6) + min(actor.end_s, 1e6)) / 2)
        line(box_corners(middle, actor.size_m)[[0, 2, 6, 4, 0], :2], colour, 2)
        line(np.stack([middle[:2, 3], middle[:2, 3] + middle[:2, 0] * actor.size_m[0] / 2]), colour, 2)
        pen.text(tuple(at(middle[None, :2, 3])[0].tolist()), actor.uid, fill="black", font=font)
    file = io.BytesIO()
    picture.save(file, "PNG")
    return f'<img src="data:image/png;base64,{base64.b64encode(file.getvalue()).decode()}" alt="Tracks from above">'


def _times(log: Log, tracks: Sequence[Track]) -> str:
    frames = [log.drive.time_s[frame] for frame in log.drive.frames]
    start, span = frames[0], max(frames[-1] - frames[0], 1e-3)
    parts = []
    for row, track in enumerate(sorted(tracks, key=lambda track: (not track.actor.is_moving, -track.certainty))):
        actor, y = track.actor, row * ROW
        x = LEFT + WIDTH * np.clip((np.array([actor.start_s, actor.end_s]) - start) / span, 0, 1)
        parts.append(
            f'<text x="0" y="{y + 11}">{escape(actor.uid)}</text><rect x="{x[0]:.0f}" y="{y + 3}" height="{ROW - 6}" '
            f'width="{max(x[1] - x[0], 2):.0f}" fill="{_rgb(track.certainty)}"/><text x="{LEFT + WIDTH + 8}" '
            f'y="{y + 11}">{track.certainty:.2f}, {track.returns} returns of {track.sweeps} sweeps</text>'
        )
    height = len(tracks) * ROW + 4
    return f'<svg viewBox="0 0 {LEFT + WIDTH + 240} {height}" width="{LEFT + WIDTH + 240}">{"".join(parts)}</svg>'
