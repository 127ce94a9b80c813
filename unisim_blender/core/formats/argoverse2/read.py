"""Reader of Argoverse 2's sensor dataset (Wilson et al., "Argoverse 2", NeurIPS Datasets 2021).

Points are float16 in the vehicle's frame, moved to the sweep's timestamp, which is its start: each is put back into its sensor at
its own firing time. What float16 takes from a point: up to 0.8 cm along an axis between 16 and 32 m, 3 cm beyond 64 m.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...data.image_files import Notes, image_suffixes, what_else
from ...data.log import Sweep, SweepGrid
from ...data.sweep_cells import make_grid
from ...data.values import Intensities, spread
from ...errors import LogError
from ...geometry import FloatArray, Trajectory, TrajectoryError, transform_points
from ...world.box_tracks import TrackedBoxes, actors_of_boxes
from ...world.drive import Camera, Drive, Lidar
from ...world.own_rates import number_captures
from ..common.arrow import ArrowColumns, Kind, read_feather, stacked
from ..common.file_log import FileLog, absent_frames, spread_over
from .beams import TURN, BeamTable, Firings, UnknownBeamsError, blocked_cells, elevation_spread, find_table
from .files import POSES, read_boxes, read_intrinsics, read_mounts, read_poses, stamped_files, tracked_boxes

LIDARS = ("up_lidar", "down_lidar")
LASERS_EACH = 32
SWEEP: dict[str, Kind] = {
    **dict.fromkeys(("x", "y", "z", "intensity"), "number"),
    **dict.fromkeys(("laser_number", "offset_ns"), "whole"),
}
IMAGES = image_suffixes(".jpg")
BRIGHT = 255.0
"""The layout's intensities are from 0 to this."""
SAMPLED = 8
"""Sweeps, spread over the log, from which the beams, their phase and the cells are found that the vehicle itself blocks."""
SPARSE = 8
"""Of a sweep whose phase alone is asked for, one return in so many is looked at."""
CLOSEST_NS, LAST_STEP_NS = 1_000, 1_000_000
"""Poses closer together than the first are one; the last two are further apart than the second, as the vehicle is carried on
beyond them at their speed."""
MARGIN_NS = 250_000_000
"""So far beyond its poses a log may have sweeps and images."""
MAX_OFFSET_NS = 1_000_000_000
MAX_LASER = 255


@dataclass(frozen=True)
class _Spinning:
    """A LiDAR's lasers and, where its returns tell them, its beams."""

    lasers: range
    beams: BeamTable


class Argoverse2Log(FileLog):
    """A drive in Argoverse 2's layout; see `unisim_blender.core.data.log.Log`."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        missing: list[str] = []
        mounts = read_mounts(path / "calibration" / "egovehicle_SE3_sensor.feather")
        self._sweeps_at = stamped_files(path / "sensors" / "lidar", (".feather",))
        boxes_path = path / "annotations.feather"
        boxes = read_boxes(boxes_path) if boxes_path.exists() else None
        if boxes is None:
            missing.append("annotations.feather is missing")
        stamps = sorted({*self._sweeps_at, *(boxes["timestamp_ns"].tolist() if boxes is not None else ())})
        if not stamps:
            raise LogError(f"{path}: holds neither sweeps in sensors/lidar nor boxes in annotations.feather")
        self._start_ns = stamps[0]
        ego, origin = self._read_ego(stamps)
        self._ego = ego
        time_s = {frame: self._seconds(stamp) for frame, stamp in enumerate(stamps)}
        self._stamps = dict(enumerate(stamps))
        self._sweeps = {
            frame: self._sweeps_at[stamp] for frame, stamp in self._stamps.items() if stamp in self._sweeps_at
        }
        absent = absent_frames(time_s, self._sweeps)
        if absent:
            missing.append(f"lidar: no sweeps of {absent}" if self._sweeps else "lidar: no sweeps")
        self._intensities = Intensities("lidar", BRIGHT, self._bright, self.notes)
        self._blocked: dict[str, NDArray[np.bool_]] = {}
        self._spinning: dict[str, _Spinning] = {}
        lidars = self._find_lidars(mounts, time_s, missing)
        self._images: dict[str, dict[int, Path]] = {}
        cameras = self._find_cameras(mounts, time_s, missing)
        actors = {}
        if boxes is not None:
            tracked = tracked_boxes(boxes_path, boxes, self._box_times(boxes), ego, list(lidars.values()))
            actors = actors_of_boxes(boxes_path, tracked)
        self.drive = Drive(
            name=path.resolve().name,
            frames=tuple(time_s),
            time_s=time_s,
            world_from_ego=ego,
            cameras=cameras,
            lidars=lidars,
            actors=actors,
            world_origin=origin,
        )
        self.missing = tuple(missing)

    def _box_times(self, boxes: ArrowColumns) -> FloatArray:
        return np.array([self._seconds(stamp) for stamp in boxes["timestamp_ns"].tolist()])

    def boxes_of(self, path: Path) -> TrackedBoxes:
        """Return the boxes of a Feather file with the columns of annotations, or of detections. Raises `LogError`."""
        boxes = read_boxes(path)
        times, ego_s = self._box_times(boxes), self._ego.times_s
        inside = (times >= ego_s[0]) & (times <= ego_s[-1])
        if len(times) and not inside.any():
            raise LogError(
                f"{path}: its boxes are at {times[0]:.1f} to {times[-1]:.1f} s of {self.drive.name}: of another drive"
            )
        boxes = {name: values[inside] for name, values in boxes.items()}
        return tracked_boxes(path, boxes, times[inside], self._ego, list(self.drive.lidars.values()))

    def _size_stated(self, camera: str) -> str:
        return f"intrinsics.feather gives {camera}"

    def sweep(self, lidar: str, frame: int) -> Sweep:
        return self._read_sweep(lidar, frame)[0]

    def sweep_grid(self, lidar: str, frame: int) -> SweepGrid:
        """The recorded sweep as beams x columns, with drops. The columns are turned by the sweep's own phase."""
        sweep, turned_rad = self._read_sweep(lidar, frame)
        ours = self.drive.lidars[lidar]
        model = replace(ours.model, start_azimuth_rad=ours.model.start_azimuth_rad + turned_rad)
        if lidar not in self._blocked:
            self._blocked[lidar] = self._find_blocked(lidar)
        blocked = np.roll(self._blocked[lidar], -self._shift(lidar, turned_rad), axis=1)
        return make_grid(sweep, replace(ours, model=model, phase=None), frame, blocked)

    def _seconds(self, stamp_ns: int) -> float:
        return (stamp_ns - self._start_ns) / 1e9

    def _read_ego(self, stamps: list[int]) -> tuple[Trajectory, FloatArray]:
        """The vehicle's trajectory by the drive's clock, and its origin in the city frame: where it is at the first frame."""
        path = self.path / POSES
        times, positions, quaternions = read_poses(path)
        for stamp in (stamps[0], stamps[-1]):
            if not times[0] - MARGIN_NS <= stamp <= times[-1] + MARGIN_NS:
                raise LogError(
                    f"{path}: has poses from {times[0]} to {times[-1]} ns, but there is a frame at {stamp} ns"
                )
        rows = _spread(times)
        times, positions, quaternions = times[rows], positions[rows], quaternions[rows]
        # seconds of integers: float64 keeps nanoseconds only near its zero
        seconds = (times - self._start_ns) / 1e9
        try:
            origin = Trajectory(seconds, positions, quaternions).positions_at(0.0)
            return Trajectory(seconds, positions - origin, quaternions), origin
        except TrajectoryError as error:
            raise LogError(f"{path}: {error}") from error

    # LiDARs

    def _find_lidars(
        self, mounts: dict[str, FloatArray], time_s: dict[int, float], missing: list[str]
    ) -> dict[str, Lidar]:
        """The LiDARs whose beams the sampled sweeps tell."""
        names = [name for name in LIDARS if name in mounts]
        missing.extend(f"{name}: calibration has no mount" for name in LIDARS if name not in mounts)
        if not self._sweeps or not names:
            return {}
        tables = {frame: self._read_table(frame) for frame in self._sampled()}
        fullest = max(tables, key=lambda frame: len(tables[frame]["x"]))
        tracks = {name: self._ego.transformed(right=mounts[name]) for name in names}
        lasers = self._assign_lasers(tracks, tables[fullest], fullest)
        lidars = {}
        for name in names:
            try:
                beams = find_table(self._fired(tracks[name], tables[fullest], fullest, lasers[name])[0])
            except UnknownBeamsError as error:
                missing.append(f"{name}: {error} in {self._sweeps[fullest].name}")
                continue
            sparse = {f: self._fired(tracks[name], table, f, lasers[name], SPARSE)[0] for f, table in tables.items()}
            turned = {f: beams.place(firings).turned_rad for f, firings in sparse.items() if len(firings.laser)}
            phase = beams.phase(
                np.array(list(time_s.values())), np.array([time_s[f] for f in turned]), np.array(list(turned.values()))
            )
            self._spinning[name] = _Spinning(lasers[name], beams)
            lidars[name] = Lidar(name, beams.model, tracks[name], dict(time_s), phase=phase)
        return lidars

    def _assign_lasers(self, tracks: dict[str, Trajectory], table: ArrowColumns, frame: int) -> dict[str, range]:
        """Which lasers are each LiDAR's: those whose elevations spread least when seen from its mount. Logs differ."""
        halves = [range(LASERS_EACH), range(LASERS_EACH, 2 * LASERS_EACH)]
        names = list(tracks)
        if len(names) == 1:
            return {names[0]: halves[LIDARS.index(names[0])]}

        def spread(order: list[range]) -> float:
            parts = (
                elevation_spread(self._fired(tracks[name], table, frame, lasers, SPARSE)[0])
                for name, lasers in zip(names, order, strict=True)
            )
            return float(np.concatenate(list(parts)).sum())

        best = min([halves, halves[::-1]], key=spread)
        return dict(zip(names, best, strict=True))

    def _read_table(self, frame: int) -> ArrowColumns:
        path = self._sweeps[frame]
        table = read_feather(path, SWEEP)
        for name, most in (("laser_number", MAX_LASER), ("offset_ns", MAX_OFFSET_NS)):
            wrong = (table[name] < 0) | (table[name] > most)
            if wrong.any():
                row = int(wrong.argmax())
                raise LogError(f"{path}: row {row} has the {name} {table[name][row]}, not one from 0 to {most}")
        empty = (table["x"] == 0) & (table["y"] == 0) & (table["z"] == 0)
        if empty.any():
            self.notes.say(
                "empty", f"{path}: {int(empty.sum())} of {len(empty)} points are at 0, 0, 0: they are no returns"
            )
            table = {name: values[~empty] for name, values in table.items()}
        return table

    def _bright(self) -> list[FloatArray]:
        return [self._read_table(frame)["intensity"] for frame in spread(self._sweeps)]

    def _fired(
        self, track: Trajectory, table: ArrowColumns, frame: int, lasers: range, every: int = 1
    ) -> tuple[Firings, NDArray[np.int64], FloatArray, FloatArray]:
        """Returns of some lasers with their motion compensation undone: in the frame of the sensor of ``track`` at their times.

        Also their rows (N,), and their points and the sensor's places (N, 3) in the world frame.
        """
        laser = table["laser_number"]
        rows = np.flatnonzero((laser >= lasers.start) & (laser < lasers.stop))[::every]
        stamp_s, late_s = self._seconds(self._stamps[frame]), table["offset_ns"][rows] / 1e9
        points = transform_points(self._ego.at(stamp_s), stacked({n: table[n][rows] for n in "xyz"}, ("x", "y", "z")))
        poses = track.at(stamp_s + late_s)
        local = np.einsum("nji,nj->ni", poses[:, :3, :3], points - poses[:, :3, 3])
        return Firings(laser[rows], late_s, local), rows, points, poses[:, :3, 3].copy()

    def _read_sweep(self, name: str, frame: int) -> tuple[Sweep, float]:
        """A sweep, and how far its columns are turned beside the LiDAR's model, without the drive's phase."""
        self._sweep_place(name, frame)
        spinning, table = self._spinning[name], self._read_table(frame)
        firings, rows, points, origins = self._fired(
            self.drive.lidars[name].world_from_lidar, table, frame, spinning.lasers
        )
        cells = spinning.beams.place(firings)
        sweep = Sweep(
            points=points,
            origins=origins,
            time_s=self._seconds(self._stamps[frame]) + firings.time_s,
            intensity=self._intensities.scaled(table["intensity"][rows], str(self._sweeps[frame])),
            ring=cells.ring,
            column=cells.column,
            semantic=np.full(len(rows), -1, np.int32),
        )
        return sweep, cells.turned_rad

    def _sampled(self) -> list[int]:
        """The frames of some sweeps, spread over the log."""
        return spread_over(self._sweeps, SAMPLED)

    def _shift(self, lidar: str, turned_rad: float) -> int:
        """By how many columns a sweep is turned beside the model."""
        model = self.drive.lidars[lidar].model
        return round(model.direction * turned_rad / TURN * model.columns)

    def _find_blocked(self, lidar: str) -> NDArray[np.bool_]:
        """Cells (beams, columns) of the unturned model that the vehicle blocks."""
        ours = self.drive.lidars[lidar]
        seen = np.zeros((ours.model.beams, ours.model.columns), np.bool_)
        for frame in self._sampled():
            sweep, turned_rad = self._read_sweep(lidar, frame)
            known = sweep.ring >= 0
            column = (sweep.column[known] + self._shift(lidar, turned_rad)) % ours.model.columns
            seen[sweep.ring[known], column] = True
        return blocked_cells(seen, ours.model, ours.world_from_lidar.at(0.0)[2, :3])

    # cameras

    def _find_cameras(
        self, mounts: dict[str, FloatArray], time_s: dict[int, float], missing: list[str]
    ) -> dict[str, Camera]:
        """The cameras that have images; the LiDAR dataset, which is in the same layout, has none, and may lack intrinsics."""
        folder = self.path / "sensors" / "cameras"
        if not folder.is_dir():
            missing.append("sensors/cameras is missing: no images")
            return {}
        models = read_intrinsics(self.path / "calibration" / "intrinsics.feather")
        unknown = sorted(entry.name for entry in folder.iterdir() if entry.is_dir() and entry.name not in models)
        missing.extend(f"camera {name} is left out: intrinsics.feather has no row of it" for name in unknown)
        cameras = {}
        for name, model in models.items():
            read = Notes()
            files = stamped_files(folder / name, IMAGES, read) if Path(name).name == name else {}
            missing.extend(read.values())
            if not files or name not in mounts:
                lacks = "mount in calibration" if files else f"images{what_else(folder / name)}"
                missing.append(f"camera {name} has no {lacks}")
                continue
            for stamp in (min(files), max(files)):
                if not self._ego.times_s[0] - 0.25 <= self._seconds(stamp) <= self._ego.times_s[-1] + 0.25:
                    raise LogError(f"{files[stamp]}: there are no poses of its time")
            by_time = {self._seconds(stamp): path for stamp, path in files.items()}
            numbered = number_captures(time_s, list(by_time))
            self._images[name] = {number: by_time[time] for number, time in numbered.items()}
            absent = absent_frames(time_s, numbered)
            if absent:
                missing.append(f"camera {name}: no images of {absent}")
            cameras[name] = Camera(name, model, self._ego.transformed(right=mounts[name]), numbered)
        return cameras


def _spread(times_ns: NDArray[np.int64]) -> NDArray[np.int64]:
    """Which poses to keep of times (T,); see `CLOSEST_NS`."""
    rows = [0]
    for row in np.flatnonzero(np.diff(times_ns, prepend=times_ns[0] - CLOSEST_NS) > 0)[1:].tolist():
        if times_ns[row] - times_ns[rows[-1]] >= CLOSEST_NS:
            rows.append(row)
    while len(rows) > 1 and times_ns[rows[-1]] - times_ns[rows[-2]] < LAST_STEP_NS:
        del rows[-2]
    return np.array(rows)
