"""The certainty of found tracks: coefficients of `core.tracks.certainty`, and how often tracks of each certainty are right.

python benchmarks/certainty.py --fit LOG --fit LOG --test LOG --test kitti/2011_09_26_drive_0005_sync:image_02

Logs have labels; LOG:CAMERA leaves out what the camera does not see at the middle of its time, where a log's labels end
with its view. A track is right that is within 2 m of a label, of one that moves where it moves, at half of its times or
more; one that is at a fifth to a half of them counts neither way. With --fit, coefficients are printed as they stand in
`certainty.py`, and the tables are of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import click
import numpy as np

from unisim_blender.core.data.log import Log, extras_of
from unisim_blender.core.formats.readers import open_log
from unisim_blender.core.geometry import FloatArray, invert_pose, transform_points
from unisim_blender.core.poses.posed import posed_log
from unisim_blender.core.tracks import certainty
from unisim_blender.core.tracks.box_file import Track
from unisim_blender.core.tracks.find import candidates, in_own_world, without_doubles
from unisim_blender.core.world.classes import motion_of

SAME_M, RIGHT, WRONG = 2.0, 0.5, 0.2
TIMES = 12
"""Number of times at which a track is compared."""
RIDGE = 2.0
INNER = (0.02, 0.98)
"""Quantiles that features are limited to."""
BINS = (0.0, 0.1, 0.3, 0.5, 0.7, 0.9, 1.0)
Row = tuple[str, tuple[float, ...], float, bool]
"""Kind of a track, its features, its certainty, and whether it is right."""


def rows_of(place: str) -> list[Row]:
    """Return the tracks found in a log, where labels tell whether they are right."""
    path, _, camera = place.partition(":")
    log = open_log(Path(path))
    used = posed_log(log, "auto").log
    every = {candidate.track.actor.uid: candidate for candidate in candidates(used)}
    tracks = in_own_world(without_doubles([candidate.track for candidate in every.values()]), used.drive, log.drive)
    rows: list[Row] = []
    for track in tracks:
        features = every[track.actor.uid].features
        if not features or (camera and not _is_seen(log, camera, track)):
            continue
        near = _near(log, track)
        if near >= RIGHT or near < WRONG:
            kind = "moving" if track.actor.is_moving else "standing"
            rows.append((kind, features, track.certainty, near >= RIGHT))
    return rows


def _near(log: Log, track: Track) -> float:
    """Return the part of a track's times at which it is near a label."""
    actor, classes = track.actor, extras_of(log).classes
    labels = [other for other in log.drive.actors.values() if motion_of(other.label, classes) in ("rigid", "deforming")]
    labels = [other for other in labels if other.is_moving or not actor.is_moving]
    near = []
    for time_s in np.linspace(actor.start_s, actor.end_s, TIMES):
        there = [other for other in labels if other.start_s <= time_s <= other.end_s]
        at = actor.world_from_actor.at(time_s)[:2, 3]
        away = [np.linalg.norm(other.world_from_actor.at(time_s)[:2, 3] - at) for other in there]
        near.append(bool(min(away, default=np.inf) < SAME_M))
    return float(np.mean(near))


def _is_seen(log: Log, name: str, track: Track) -> bool:
    camera, time_s = log.drive.cameras[name], (track.actor.start_s + track.actor.end_s) / 2
    middle = track.actor.world_from_actor.at(time_s)[:3, 3]
    u, v, valid = camera.model.project(transform_points(invert_pose(camera.world_from_camera.at(time_s)), middle[None]))
    return bool(valid[0] and 0 <= u[0] < camera.model.width and 0 <= v[0] < camera.model.height)


def fitted(features: FloatArray, right: FloatArray) -> FloatArray:
    """Return rows (F + 1, 3) of lowest and highest value and weight of each feature (N, F), and of the constant, by ridge
    regression with iterated weights; ``right`` (N,): 0 or 1."""
    low, high = np.quantile(features, INNER, axis=0)
    limited = np.clip(features, low, high)
    mean, scale = limited.mean(0), limited.std(0) + 1e-6
    values = np.column_stack([(limited - mean) / scale, np.ones(len(limited))])
    ridge = np.diag([*[RIDGE] * len(mean), 1e-3])
    weight = np.zeros(len(mean) + 1)
    for _ in range(40):
        chance = 1 / (1 + np.exp(-values @ weight))
        curvature = (values * (chance * (1 - chance))[:, None]).T @ values + ridge
        weight = weight - np.linalg.solve(curvature, values.T @ (chance - right) + ridge @ weight)
    each = weight[:-1] / scale
    return np.concatenate([np.stack([low, high, each], 1), [[1.0, 1.0, weight[-1] - each @ mean]]])


def table(name: str, rows: Sequence[Row]) -> str:
    """Return a line: for each interval of certainties, how many tracks there are, their mean certainty and how many of them
    are right, percent."""
    certain, right = np.array([row[2] for row in rows]), np.array([row[3] for row in rows], float)
    cells = [f"{name:44s} {len(rows):5d} tracks, Brier {np.mean((certain - right) ** 2):.3f}"]
    for low, high in zip(BINS, BINS[1:], strict=False):
        there = (certain >= low) & ((certain < high) | (high == BINS[-1]))
        if there.any():
            cells.append(f"{there.sum()}: {100 * certain[there].mean():.0f} {100 * right[there].mean():.0f}")
    return " | ".join(cells)


@click.command()
@click.option("--fit", "fit", multiple=True, help="A log that coefficients are fitted to.")
@click.option("--test", "test", multiple=True, help="A log that they are tested on.")
def main(fit: tuple[str, ...], test: tuple[str, ...]) -> None:
    """Fit and test the certainty of found tracks."""
    rows = {place: rows_of(place) for place in (*fit, *test)}
    for kind in certainty.FEATURES:
        own = [row for place in fit for row in rows[place] if row[0] == kind]
        if own:
            found = fitted(np.array([row[1] for row in own]), np.array([row[3] for row in own], float))
            certainty.COEFFICIENTS[kind] = found
            print(f'    "{kind}": np.array([')
            for name, (low, high, weight) in zip((*certainty.FEATURES[kind], "constant"), found, strict=True):
                print(f"        ({low:.3g}, {high:.3g}, {weight:.3g}),  # {name}")
            print("    ]),")
        for place in (*fit, *test):
            there = [(k, f, certainty.probability(f, k), right) for k, f, _, right in rows[place] if k == kind]
            if there:
                print(table(f"{'fit ' if place in fit else 'test'} {kind} {Path(place).name}", there))


if __name__ == "__main__":
    main()
