"""Construction of a log's surfels: gather returns, lay faces on them, paint them from the images, count drops.

Faces lie on local planes of the points, with the normal and the density of the points around them.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .... import native
from ....data.exposures import Exposures
from ....data.log import Log, Sweep
from ....data.own_vehicle import Outline
from ....errors import LogError, SceneError
from ....geometry import FloatArray, spread_indices
from ....ops.constants import GROUND_CELL_M, GROUND_CLEARANCE_M, SYMMETRIC_CLASSES
from ....sensors.rays import Rays
from ....world.drive import Actor
from ....world.own_rates import captures_of
from ....world.replay import with_windows
from ...tracer import NEAR_M
from .cloud import PointSums, cube_keys, gather_sweep, part_of, summed
from .colours import SurfelPainter
from .ground import HeightGrid, height_grid
from .model import DropTable, SurfelScene, SurfelSet, SurfelSettings, joined, make_faces
from .placed import NO_OWNER, STATIC_OWNER, PlacedSurfels, carried
from .views import open_view, outline_in

PointArray = NDArray[np.float32]


class FittedPlanes(NamedTuple):
    """Planes fitted to the points near places (N, 3): number (N,) of the points; normal (N, 3), unit, 0 for fewer than
    three points; height_m (N,) of their mean over the place along the normal, and rough_m (N,), their deviation along
    it; reach_m (N,), the distance from the place to the farthest of them."""

    number: NDArray[np.int32]
    normal: NDArray[np.float32]
    height_m: NDArray[np.float32]
    rough_m: NDArray[np.float32]
    reach_m: NDArray[np.float32]


class Neighbours:
    """Points (N, 3) sorted into cubes of ``radius_m``, to find those near a place. Raises `SceneError` where the
    compiled kernels are absent: the plain reference, of the tests, is for small clouds alone."""

    def __init__(self, points: PointArray, radius_m: float) -> None:
        self.lib = native.library()
        if self.lib is None:
            raise SceneError("surfels are made by the compiled kernels, which are not there: run make setup")
        assert points.ndim == 2 and points.shape[1] == 3, points.shape
        self.radius_m = radius_m
        low = points.min(0).astype(np.float64) - 2 * radius_m if len(points) else np.zeros(3)
        cell = np.floor((points - low) / radius_m).astype(np.int64)
        dims = cell.max(0) + 3 if len(points) else np.ones(3, np.int64)
        key = (cell[:, 0] * dims[1] + cell[:, 1]) * dims[2] + cell[:, 2]
        order = np.argsort(key, kind="stable")
        key = key[order]
        first = np.flatnonzero(np.r_[True, key[1:] != key[:-1]]) if len(key) else np.zeros(0, np.int64)
        self.points = np.ascontiguousarray(points[order], np.float32)
        self.keys = np.ascontiguousarray(key[first])
        self.starts = np.r_[first, len(key)].astype(np.int64)
        self.low, self.dims = np.ascontiguousarray(low), np.ascontiguousarray(dims)

    def planes(self, places: PointArray, most: int) -> FittedPlanes:
        """Return the planes through the ``most`` points nearest to each place (M, 3), within the radius."""
        assert self.lib is not None
        assert places.ndim == 2 and places.shape[1] == 3, places.shape
        places, m = np.ascontiguousarray(places, np.float32), len(places)
        planes = FittedPlanes(
            np.empty(m, np.int32), np.empty((m, 3), np.float32), *(np.empty(m, np.float32) for _ in range(3))
        )
        table = (x.ctypes.data for x in (self.points, self.keys, self.starts))
        grid = (self.low.ctypes.data, self.dims.ctypes.data, self.radius_m, most, places.ctypes.data, m)
        self.lib.unisim_local_planes(*table, len(self.keys), *grid, *(x.ctypes.data for x in planes), native.threads())
        return planes


NORMAL_NEIGHBOURS, NORMAL_RADIUS_M = 200, 0.2
"""Largest number of points of a normal, and their distance, metres; `SPARSE_RADIUS_M` where they are fewer than
`MIN_NEIGHBOURS`."""
MIN_NEIGHBOURS, SPARSE_RADIUS_M, SPARSE_NEIGHBOURS = 8, 0.6, 24
ROAD_IN_BOX_M = 3 * GROUND_CLEARANCE_M
"""Height, in metres, above an actor's underside up to which returns may be the road's."""
MIRROR_RADIUS_M = 0.2
"""Distance, metres, to the nearest return beyond which mirrored returns of a vehicle's other side are used."""
GROUND_GAP_M, GROUND_REACH_M = 0.2, 30.0
"""Edge, metres, of the squares without a face that get one on the ground, and their distance from the trajectory."""
SPACING_NEIGHBOURS = 6
"""Number of neighbours whose distance measures the density of points."""
MAX_FLAT_DEVIATION = 0.15
"""Largest deviation of points from their plane, relative to the distance between them, at which faces grow."""
CORNER_SPACING_FACTOR = 1.1
"""Distance of a face's corners from its middle, relative to that of the points."""
BATCH_POINTS = 1 << 17
IMAGES_PER_CAMERA = 16
"""Number of images of each camera, spread over the drive, that faces are painted from."""
IMAGE_WIDTH_PX, DEPTH_WIDTH_PX = 960, 320
DROP_SWEEPS = 6
NEAR_SWEEPS = 5
"""Number of sweeps of each LiDAR that a preliminary scene is built from."""


PRUNING_SWEEPS, PRUNING_ROUNDS = 12, 2
PASS_THROUGH_M, MAX_PASS_THROUGH_SHARE = 0.3, 0.01
"""Distance, metres, behind a face beyond which a beam that returned went through it, and the largest share of such
beams."""


class Step(NamedTuple):
    """Progress of a build: its present step in words, and the share that is done."""

    text: str
    share: float


def build_surfels(
    log: Log, settings: SurfelSettings, frames: Sequence[int] | None = None
) -> Iterator[Step | SurfelScene]:
    """Build the surfels of a log: yield steps, and last the scene. ``frames`` are those whose sweeps and images are
    used; all where None.

    Raises `LogError` where there is no sweep.
    """
    drive = log.drive
    chosen = set(drive.frames if frames is None else frames)
    sweeps = _sweeps(log, chosen)
    actors = with_windows(drive, drive.actors.values())
    surfels, ground = yield from _laid(log, settings, sweeps, actors, 0.22)
    beams = [(name, frame) for name, frame in sweeps if drive.lidars[name].model.beams]
    for number, (name, frame) in enumerate(beams[i] for i in spread_indices(len(beams), PRUNING_SWEEPS)):
        yield Step("Removing what beams went through", 0.22 + 0.2 * number / PRUNING_SWEEPS)
        surfels = _pruned(surfels, log, name, frame)
    outlines: dict[str, tuple[Outline, int]] = {}
    for name in drive.cameras:
        yield Step("Looking for the vehicle itself", 0.42)
        outlines |= outline_in(log, name, chosen)
    images = [(name, frame) for name in drive.cameras for frame in _chosen_images(log, name, chosen)]
    scene = yield from _painted(log, settings, surfels, ground, images, outlines, 0.45, 0.95)
    drops = DropTable.empty()
    for name, frame in (beams[i] for i in spread_indices(len(beams), DROP_SWEEPS)):
        yield Step("Counting dropped beams", 0.95)
        drops = _count_drops(drops, log, name, frame, surfels)
    yield replace(scene, drops=drops)


def preliminary_surfels(log: Log, settings: SurfelSettings, time_s: float) -> Iterator[Step | SurfelScene]:
    """Build surfels of the few sweeps and images nearest to a time, seconds: yield steps, and last the scene.

    It takes a tenth of the time of `build_surfels`, for a first image near that time. Every beam returns, and outlines
    of the recording vehicle are unknown. Raises `LogError` where there is no sweep.
    """
    drive = log.drive
    near = sorted(
        _sweeps(log, set(drive.frames)), key=lambda sweep: abs(drive.lidars[sweep[0]].time_s[sweep[1]] - time_s)
    )
    sweeps = [sweep for name in drive.lidars for sweep in [s for s in near if s[0] == name][:NEAR_SWEEPS]]
    images = []
    for name, camera in drive.cameras.items():
        frames = sorted(log.image_frames(name), key=lambda frame: abs(camera.time_s[frame] - time_s))  # noqa: B023
        images += [(name, frame) for frame in frames[:1]]
    surfels, ground = yield from _laid(log, settings, sweeps, with_windows(drive, drive.actors.values()), 0.55)
    yield (yield from _painted(log, settings, surfels, ground, images, {}, 0.55, 1.0))


def _sweeps(log: Log, chosen: set[int]) -> list[tuple[str, int]]:
    """Return the LiDARs and frames of the sweeps of ``chosen`` frames. Raises `LogError` where there is none."""
    sweeps = [(name, frame) for name in log.drive.lidars for frame in _captures(log, name, chosen)]
    if not sweeps:
        raise LogError(f"{log.path}: has no LiDAR sweep to make surfels of")
    return sweeps


def _laid(
    log: Log, settings: SurfelSettings, sweeps: Sequence[tuple[str, int]], actors: Sequence[Actor], end: float
) -> Generator[Step, None, tuple[PlacedSurfels, HeightGrid]]:
    """Yield steps up to the share ``end``; return faces on the returns of ``sweeps``, and the ground."""
    drive = log.drive
    static, own = PointSums(), [PointSums() for _ in actors]
    feet: list[tuple[int, Sweep, FloatArray, FloatArray]] = []
    for number, (name, frame) in enumerate(sweeps):
        yield Step("Gathering LiDAR returns", 0.6 * end * number / len(sweeps))
        sweep = log.sweep(name, frame)
        owner, places = gather_sweep(drive, actors, sweep, drive.time_s[frame])
        still = owner < 0
        static.add(sweep.points[still], sweep.intensity[still], sweep.origins[still])
        for index in np.unique(owner[~still]).tolist():
            mine = np.flatnonzero(owner == index)
            origins = carried(actors[index], sweep.time_s[mine], sweep.origins[mine], back=True)
            # what may be the road under an actor is told apart once the road is known
            low = places[mine, 2] < -actors[index].size_m[2] / 2 + ROAD_IN_BOX_M
            own[index].add(places[mine[~low]], sweep.intensity[mine[~low]], origins[~low])
            feet.append((index, part_of(sweep, mine[low]), places[mine[low]], origins[low]))
    static.merge()
    ground = height_grid(static.points)
    for index, sweep, places, origins in feet:
        above = sweep.points[:, 2] > ground.at(sweep.points) + GROUND_CLEARANCE_M
        own[index].add(places[above], sweep.intensity[above], origins[above])
        static.add(sweep.points[~above], sweep.intensity[~above], sweep.origins[~above])
    sets = {}
    for number, (actor, cloud) in enumerate(zip(actors, own, strict=True)):
        if number % 16 == 0:
            yield Step("Laying faces on actors", end * (0.6 + 0.15 * number / len(actors)))
        sets[actor.uid] = _exhausted(_faces(_mirrored(cloud, actor) if settings.mirror else _fine(cloud), settings))
    laid = yield from _as_steps(_faces(_fine(static), settings), "Laying faces", 0.75 * end, 0.2 * end)
    everywhere = joined([laid, _gaps(laid, ground, drive.world_from_ego.positions)])
    yield Step("Sorting faces", 0.95 * end)
    _ = everywhere.triangles  # made once: it takes seconds
    return PlacedSurfels(everywhere, [(actor, sets[actor.uid]) for actor in actors]), ground


def _painted(
    log: Log,
    settings: SurfelSettings,
    surfels: PlacedSurfels,
    ground: HeightGrid,
    images: Sequence[tuple[str, int]],
    outlines: dict[str, tuple[Outline, int]],
    begin: float,
    end: float,
) -> Generator[Step, None, SurfelScene]:
    """Yield steps from the share ``begin`` to ``end``; return the scene of faces painted from ``images``, without
    drops."""
    painter = SurfelPainter(surfels)
    actors = [actor for actor, _ in surfels.placed]
    for number, (name, frame) in enumerate(images):
        yield Step("Painting faces from images", begin + (end - begin) * number / len(images))
        painter.paint(open_view(log, name, frame, IMAGE_WIDTH_PX, DEPTH_WIDTH_PX, surfels, actors, outlines))
    gains = painter.gains()
    times = [log.drive.cameras[name].time_s[frame] for name, frame in images]
    exposures = Exposures.of([name for name, _ in images], times, gains)
    painter.finish(gains)
    dome, dome_seen = painter.dome(gains)
    sets = {actor.uid: faces for actor, faces in surfels.placed}
    drops = DropTable.empty()
    return SurfelScene(settings, surfels.static, sets, ground, dome, dome_seen, drops, outlines, exposures)


def finished(steps: Iterator[Step | SurfelScene], on_step: Callable[[Step], object] = lambda step: None) -> SurfelScene:
    """Return the scene of a build, once it is finished."""
    for step in steps:
        if isinstance(step, SurfelScene):
            return step
        on_step(step)
    raise AssertionError("a build ends with its scene")


def _as_steps(
    faces: Generator[float, None, SurfelSet], text: str, begin: float, span: float
) -> Generator[Step, None, SurfelSet]:
    """Yield the progress of ``faces`` as steps, from ``begin`` on over ``span``."""
    while True:
        try:
            yield Step(text, begin + span * next(faces))
        except StopIteration as end:
            return end.value


def _exhausted(faces: Generator[float, None, SurfelSet]) -> SurfelSet:
    steps = _as_steps(faces, "", 0.0, 1.0)
    while True:
        try:
            next(steps)
        except StopIteration as end:
            return end.value


class _Returns(NamedTuple):
    """Points (N, 3), their intensities (N,) and the places (N, 3) from which they were seen."""

    points: FloatArray
    intensity: FloatArray
    sensors: FloatArray


def _fine(cloud: PointSums) -> _Returns:
    cloud.merge()
    return _Returns(cloud.points, cloud.intensity, cloud.sensors)


def _mirrored(cloud: PointSums, actor: Actor) -> _Returns:
    """Return a vehicle's returns, and those of its other side where this one has none near."""
    own = _fine(cloud)
    if not any(word in actor.label.lower() for word in SYMMETRIC_CLASSES) or len(own.points) == 0:
        return own
    flip = np.array([1.0, -1.0, 1.0])
    other = _Returns(own.points * flip, own.intensity, own.sensors * flip)
    lonely = (
        Neighbours(own.points.astype(np.float32), MIRROR_RADIUS_M).planes(other.points.astype(np.float32), 1).number
        == 0
    )
    return _Returns(*(np.concatenate([a, b[lonely]]) for a, b in zip(own, other, strict=True)))


def _faces(returns: _Returns, settings: SurfelSettings) -> Generator[float, None, SurfelSet]:
    """Yield the shares done, and return faces on returns that were thinned to `POINT_CELL_M`."""
    key, total = summed(
        cube_keys(returns.points, settings.voxel_m),
        np.concatenate(
            [returns.points, returns.intensity[:, None], returns.sensors, np.ones((len(returns.points), 1))], 1
        ),
    )
    total = total / total[:, 7:] if len(key) else total
    places, intensity, sensors = total[:, :3], total[:, 3], total[:, 4:7]
    about, wide = (
        Neighbours(returns.points.astype(np.float32), radius) for radius in (NORMAL_RADIUS_M, SPARSE_RADIUS_M)
    )
    sparse = Neighbours(places.astype(np.float32), settings.face_max_m)
    normals, spacing = np.zeros((len(places), 3), np.float32), np.zeros(len(places))
    for begin in range(0, len(places), BATCH_POINTS):
        yield begin / len(places)
        part = slice(begin, begin + BATCH_POINTS)
        at = places[part].astype(np.float32)
        planes = about.planes(at, NORMAL_NEIGHBOURS)
        normal, height, rough = planes.normal.copy(), planes.height_m.copy(), planes.rough_m.copy()
        few = np.flatnonzero(planes.number < MIN_NEIGHBOURS)
        if len(few):
            more = wide.planes(at[few], SPARSE_NEIGHBOURS)
            normal[few], height[few], rough[few] = more.normal, more.height_m, more.rough_m
        to_sensor = sensors[part] - places[part]
        to_sensor /= np.maximum(np.linalg.norm(to_sensor, axis=1, keepdims=True), 1e-9)
        none = (normal == 0).all(1)
        normal[none] = to_sensor[none]
        places[part] += normal * np.clip(height, -settings.voxel_m / 2, settings.voxel_m / 2)[:, None]
        normals[part] = np.where(np.einsum("ni,ni->n", normal, to_sensor)[:, None] < 0, -normal, normal)
        near = sparse.planes(at, SPACING_NEIGHBOURS + 1)
        # what stands alone, or on no plane, stays small
        flat = (near.number > SPACING_NEIGHBOURS) & (rough < MAX_FLAT_DEVIATION * near.reach_m)
        spacing[part] = np.where(flat, near.reach_m, 0.0)
    radius = np.clip(CORNER_SPACING_FACTOR * spacing, settings.face_m, max(settings.face_max_m, settings.face_m))
    return make_faces(places, normals, radius, intensity)


def _gaps(faces: SurfelSet, ground: HeightGrid, trajectory: FloatArray) -> SurfelSet:
    """Faces on the ground near the vehicle's trajectory (N, 3) where none lies: between the LiDAR's rings, and under
    objects that stood there throughout. Nothing returned there; the ground goes on as beside."""
    x, y = np.nonzero(ground.known)
    cells = np.stack([x, y], 1) * GROUND_CELL_M + ground.low
    reach = np.full(len(cells), np.inf)
    for place in trajectory[:: max(1, len(trajectory) // 40), :2]:
        reach = np.minimum(reach, np.linalg.norm(cells - place, axis=1))
    cells = cells[reach < GROUND_REACH_M]
    offsets = (np.arange(GROUND_CELL_M / GROUND_GAP_M) + 0.5) * GROUND_GAP_M - GROUND_CELL_M / 2
    inside = np.stack(np.meshgrid(offsets, offsets, indexing="ij"), -1).reshape(-1, 2)
    points = np.concatenate([(cells[:, None] + inside).reshape(-1, 2), np.zeros((len(cells) * len(inside), 1))], 1)
    points[:, 2] = ground.at(points)
    centres = faces.centres
    low = np.abs(centres[:, 2] - ground.at(centres)) < 3 * GROUND_CLEARANCE_M
    about = Neighbours(centres[low].astype(np.float32), GROUND_GAP_M / 2)
    points = points[about.planes(points.astype(np.float32), 1).number == 0]
    n = len(points)
    up = np.tile(np.array([[0, 0, 1]], np.float32), (n, 1))
    level = float(np.median(faces.intensity[low])) if low.any() else 0.1
    return make_faces(points, up, np.full(n, 1.3 * GROUND_GAP_M), np.full(n, level), np.zeros(n, bool))


def _captures(log: Log, lidar: str, chosen: set[int]) -> list[int]:
    return captures_of(log.drive.lidars[lidar].time_s, log.drive, sorted(chosen), log.sweep_frames(lidar))


def _chosen_images(log: Log, camera: str, chosen: set[int]) -> list[int]:
    """Return a camera's images that are spread evenly over the vehicle's path."""
    taken = log.drive.cameras[camera].time_s
    frames = captures_of(taken, log.drive, sorted(chosen), log.image_frames(camera))
    if len(frames) <= IMAGES_PER_CAMERA:
        return frames
    times = [log.drive.time_s[frame] if frame in log.drive.time_s else taken[frame] for frame in frames]
    ego = log.drive.world_from_ego.at(np.array(times))[:, :3, 3]
    # a vehicle that stands sees others pass: time counts too
    trajectory = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(ego, axis=0), axis=1) + 0.05)]
    wanted = np.linspace(0, trajectory[-1], IMAGES_PER_CAMERA)
    return sorted({frames[int(np.abs(trajectory - at).argmin())] for at in wanted})


def _pruned(surfels: PlacedSurfels, log: Log, name: str, frame: int) -> PlacedSurfels:
    """Return the placed surfels without faces that a sweep's beams went through more often than they returned there."""
    grid = log.sweep_grid(name, frame)
    rays = Rays(grid.origins[grid.returned], grid.directions[grid.returned], grid.time_s[grid.returned])
    depth = grid.depth_m[grid.returned].astype(np.float64)
    for _ in range(PRUNING_ROUNDS):
        hits = surfels.first(rays, NEAR_M)
        through = hits.t < depth * (1 - MAX_PASS_THROUGH_SHARE) - PASS_THROUGH_M
        sets = {STATIC_OWNER: surfels.static, **{number: faces for number, (_, faces) in enumerate(surfels.placed)}}
        for owner in np.unique(hits.owner[through]).tolist():
            mine, count = hits.owner == owner, len(sets[owner])
            passed = np.bincount(hits.face[mine & through], minlength=count)
            stopped = np.bincount(hits.face[mine & ~through], minlength=count)
            sets[owner] = sets[owner].without(passed > stopped)
        static = sets.pop(STATIC_OWNER)
        surfels = PlacedSurfels(static, [(actor, sets[number]) for number, (actor, _) in enumerate(surfels.placed)])
    return surfels


def _count_drops(drops: DropTable, log: Log, name: str, frame: int, surfels: PlacedSurfels) -> DropTable:
    grid = log.sweep_grid(name, frame)
    cells = ~grid.blocked
    rays = Rays(grid.origins[cells], grid.directions[cells], grid.time_s[cells])
    hits = surfels.first(rays, NEAR_M)
    hit = hits.owner != NO_OWNER
    cosine = np.abs(np.einsum("ni,ni->n", surfels.normals(hits, rays), rays.directions))
    intensity = surfels.gathered(hits, "intensity", (), np.float64)
    return drops.counted(hits.t[hit], cosine[hit], intensity[hit], grid.returned[cells][hit])
