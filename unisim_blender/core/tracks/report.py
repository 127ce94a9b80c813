"""The report of found tracks: one page of HTML with a picture from above, tracks over time, their certainty, and what one
sensor alone saw."""

from __future__ import annotations

import base64
import io
from collections import Counter
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
STYLE = (
    "body{font:14px sans-serif;margin:24px}img{max-width:100%;height:auto}table{border-collapse:collapse}"
    "td,th{padding:1px 10px;text-align:right}.time{width:45vw}.time div{line-height:1}.alone{color:#c00}"
)


def report(log: Log, tracks: Sequence[Track]) -> str:
    """Return the page: ``log`` gives returns and times. Raises what its reader raises."""
    seen, title = seen_by(log, tracks), f"Tracks of {escape(log.drive.name)}"
    times_s = [log.drive.time_s[frame] for frame in log.drive.frames]
    start, span = times_s[0], max(times_s[-1] - times_s[0], 1e-3)
    rows = []
    for track in sorted(tracks, key=lambda track: (not track.actor.is_moving, -track.certainty)):
        actor, names = track.actor, sorted(seen[track.actor.uid])
        begin, end = np.clip((np.array([actor.start_s, actor.end_s]) - start) / span, 0, 1) * 100
        bar = f"margin-left:{begin:.1f}%;width:{max(end - begin, 0.3):.1f}%;background:{_rgb(track.certainty)}"
        rows.append(
            f'<tr><td>{escape(actor.uid)}<td class="time"><div style="{bar}">&nbsp;</div><td>{track.certainty:.2f}'
            f"<td>{track.returns} of {track.sweeps} sweeps<td{' class=alone' * (len(names) < 2)}>"
            f"{escape(', '.join(names) or 'none')}"
        )
    return (
        f'<!doctype html><meta charset="utf-8"><title>{title}</title><style>{STYLE}</style><h1>{title}</h1>'
        f"<p>{escape(summary(tracks))}. Green is certain, red is not. Lines are the ways of what moves; the box is where it "
        f"is in the middle of its time.</p><h2>From above</h2>{_above(log, tracks)}<h2>Over time</h2><table><tr><th>track"
        f"<th>from {start:.1f} to {times_s[-1]:.1f} s<th>certainty<th>returns<th>seen by{''.join(rows)}</table><p>Seen by, "
        "in the middle of its time: LiDARs with returns in the box, cameras with its centre in the image. Red: by one "
        "sensor alone.</p>"
    )


def summary(tracks: Sequence[Track]) -> str:
    """Return how many tracks there are of each class: "2 moving Car, 5 standing Car"."""
    kinds = [f"{'moving' if track.actor.is_moving else 'standing'} {track.actor.label}" for track in tracks]
    return ", ".join(f"{count} {kind}" for kind, count in sorted(Counter(kinds).items())) or "none"


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
