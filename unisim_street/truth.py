"""The images and sweeps that cameras and LiDARs truly see of a street on any drive through it: recorded, edited, or seen with
other sensors.

A drive's actors and static items are placed in its street; rays are traced in the street's frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unisim_blender.core.errors import ScenarioError
from unisim_blender.core.geometry import FloatArray, Trajectory, invert_pose, rotate_vectors, transform_points
from unisim_blender.core.sensors.camera import camera_rays
from unisim_blender.core.sensors.frames import CameraFrame, LidarFrame, RenderStats
from unisim_blender.core.sensors.lidar import lidar_rays
from unisim_blender.core.sensors.unprojection import image_mask
from unisim_blender.core.world.drive import Actor, Box, Camera, Drive, StaticCopy
from unisim_blender.core.world.replay import WorldState, with_windows

from .assets.lamps import with_lamps
from .paint.light import (
    DAY,
    LAMP_COLOUR,
    LAMP_REACH_M,
    SUN,
    StreetLight,
    display,
    lamp_light,
    shade,
    sky,
    sun_directions,
)
from .street import Street, street_origin
from .tracing.surface_hits import Surfaces, look_up
from .tracing.trace import (
    TILE_PX,
    Asset,
    AssetPlacement,
    Bundles,
    Hits,
    lit,
    make_bundles,
    tile_image,
    to_asset,
    trace,
    untile_image,
)

_RAYS_PER_CHUNK = 2**19
_SHADOW_RAY_OFFSET_M = 1e-3
"""How far off its surface a shadow ray starts."""
_MIN_RETURN_REFLECTIVITY = 0.02
"""Least reflectivity x cosine at 100 m that still returns."""
_BEAM_DIVERGENCE_RAD = 0.003
_MIN_LAMP_LIGHT = 5e-3
"""Less of a lamp's light is none."""


@dataclass(frozen=True)
class TracedView:
    """An image's rays traced: bundles, their hits, the surfaces, and which subsample (M,) of its pixel
    each flat ray is."""

    bundles: Bundles
    hits: Hits
    surfaces: Surfaces
    subsample: NDArray[np.int64]
    height: int
    width: int


def resize(camera: Camera, width: int | None) -> Camera:
    """The camera at another width, the same where none is given."""
    return camera if width is None else replace(camera, model=camera.model.resized(width))


def strips(camera: Camera, samples: int) -> list[tuple[int, int]]:
    """Ranges of pixel rows, few enough at a time that their rays fit into some 500 MB."""
    model = camera.model
    whole_tiles = TILE_PX // samples if TILE_PX % samples == 0 else TILE_PX
    most = max(_RAYS_PER_CHUNK // (model.width * samples**2) // whole_tiles * whole_tiles, whole_tiles)
    return [(start, min(start + most, model.height)) for start in range(0, model.height, most)]


def trace_view(
    world: StreetWorld, camera: Camera, time_s: float, samples: int, rows: tuple[int, int], painted: bool = True
) -> TracedView:
    """Trace samples x samples rays a pixel of the pixel rows from rows[0] up to but without rows[1]."""
    model = camera.model
    height, width = (rows[1] - rows[0]) * samples, model.width * samples
    v, u = np.meshgrid(rows[0] + (np.arange(height) + 0.5) / samples, (np.arange(width) + 0.5) / samples, indexing="ij")
    rays = camera_rays(camera, time_s, u, v)
    bundles = _bundles(world, tile_image(rays.origins), tile_image(rays.directions), tile_image(rays.time_s))
    hits = trace(world.placements, bundles)
    o, d, t = bundles.origins.reshape(-1, 3), bundles.directions.reshape(-1, 3), bundles.time_s.reshape(-1)
    surfaces = look_up(world.placements, hits, o, d, t, 1.0 / (model.pixels_per_rad * samples), painted)
    row, column = np.meshgrid(np.arange(height) % samples, np.arange(width) % samples, indexing="ij")
    subsample = tile_image((row * samples + column).astype(np.float64)).astype(np.int64).reshape(-1)
    return TracedView(bundles, hits, surfaces, subsample, height, width)


def _bundles(world: StreetWorld, origins: FloatArray, directions: FloatArray, time_s: FloatArray) -> Bundles:
    """Bundles (B, K) of rays of the drive's world, in the street's frame."""
    return make_bundles(
        transform_points(world.street_from_world, origins.reshape(-1, 3)).reshape(origins.shape),
        rotate_vectors(world.street_from_world, directions.reshape(-1, 3)).reshape(directions.shape),
        time_s,
    )


def truth_camera(
    street: Street, drive: Drive, camera_id: str, frame: int, width: int | None = None, samples: int = 2
) -> CameraFrame:
    """A camera's image, its colours averaged over samples x samples rays a pixel.

    Depth, normal and instance are those of each pixel's ray nearest its centre: never a mean across an edge.
    """
    camera = resize(drive.cameras[camera_id], width)
    return exact_image(make_world(street, drive), camera, camera.time_s[frame], samples)


def exact_image(world: StreetWorld, camera: Camera, time_s: float, samples: int = 2) -> CameraFrame:
    """The image of a camera of that world at a time; see `truth_camera`."""
    pose = camera.world_from_camera.at(time_s)
    parts = []
    for rows in strips(camera, samples):
        view = trace_view(world, camera, time_s, samples, rows)
        rgb = display(_average(_image(_radiance(world, view, samples), view), samples))
        parts.append({"rgb": rgb, **_geometry(world, pose, view, samples)})
    image = CameraFrame(
        model=camera.model_at(time_s),
        world_from_camera=pose,
        instances=world.instances,
        stats=RenderStats(rays=camera.model.height * camera.model.width * samples**2),
        **{name: np.concatenate([part[name] for part in parts]) for name in parts[0]},
    )
    shown = image_mask(camera.model)
    if shown is not None:
        image.blank(shown)
    return image


def thin_share(world: StreetWorld, thin: int, camera: Camera, time_s: float, samples: int = 4) -> FloatArray:
    """Return the shares (H, W) of an image's pixels that wires, masts, railings and fences cover, the last ``thin`` parts of what
    stands in the street, of samples x samples rays a pixel."""
    first, rows_of = len(world.placements[STATIC_PLACEMENT].asset.parts) - thin, []
    for rows in strips(camera, samples):
        view = trace_view(world, camera, time_s, samples, rows, painted=False)
        covered = (view.hits.placement == STATIC_PLACEMENT) & (view.hits.part >= first)
        rows_of.append(_average(_image(covered.reshape(-1), view), samples)[..., 0])
    return np.concatenate(rows_of)


@dataclass(frozen=True)
class SeenColours:
    """What rays in bundles (B, K) see: display-referred sRGB (B, K, 3) in 0..1, distances, inf where nothing is hit, normals
    (B, K, 3) in the drive's world, and instances as in `Echoes`."""

    rgb: FloatArray
    depth_m: FloatArray
    normal: FloatArray
    instance: NDArray[np.int32]


def seen_colours(
    world: StreetWorld, origins: FloatArray, directions: FloatArray, time_s: FloatArray, spread_rad: float
) -> SeenColours:
    """Return the colours that rays in bundles (B, K, 3), (B, K, 3), (B, K) in the drive's world see, ``spread_rad`` apart. One
    ray sees the middle of the sun, so its shadows have hard edges."""
    bundles = _bundles(world, origins, directions, time_s)
    hits = trace(world.placements, bundles)
    o, d, t = bundles.origins.reshape(-1, 3), bundles.directions.reshape(-1, 3), bundles.time_s.reshape(-1)
    surfaces = look_up(world.placements, hits, o, d, t, spread_rad)
    view = TracedView(bundles, hits, surfaces, np.zeros(len(t), np.int64), *bundles.shape)
    normal = np.zeros((len(t), 3))
    normal[surfaces.rays] = rotate_vectors(world.street_from_world.swapaxes(0, 1), surfaces.normals)
    instance = world.instance_of(hits.placement)
    shape = *bundles.shape, 3
    return SeenColours(
        np.asarray(display(_radiance(world, view, 1)).reshape(shape), np.float64),
        hits.t,
        normal.reshape(shape),
        instance,
    )


def _radiance(world: StreetWorld, view: TracedView, samples: int) -> FloatArray:
    """Linear light (M, 3) of every ray."""
    directions = view.bundles.directions.reshape(-1, 3)
    time = view.bundles.time_s.reshape(-1)
    out = np.empty_like(directions)
    missed = ~np.isfinite(view.hits.t.reshape(-1))
    out[missed] = sky(directions[missed], world.light)
    seen = view.surfaces
    sunlit = sun_visibility(world, seen, time, view.subsample, samples)
    ambient = contact(world, seen, time)
    lamps = lamplight(world, seen, time)[:, None] * LAMP_COLOUR
    out[seen.rays] = shade(
        seen.albedo, seen.gloss, seen.soft_normals, directions[seen.rays], sunlit, ambient, lamps, world.light
    )
    out[seen.rays] += seen.emitted
    return out


def sun_visibility(
    world: StreetWorld, seen: Surfaces, time_s: FloatArray, subsample: NDArray[np.int64], samples: int
) -> FloatArray:
    """1 where the sun's point that belongs to a ray's subsample is visible, 0 where it is not (N,)."""
    toward = sun_directions(samples)[subsample[seen.rays]]
    faces = np.flatnonzero((seen.normals @ SUN > 0) & (seen.soft_normals @ SUN > 0))
    out = np.zeros(len(seen.rays))
    start = seen.points[faces] + _SHADOW_RAY_OFFSET_M * seen.normals[faces]
    out[faces] = lit(world.placements, start, toward[faces], time_s[seen.rays][faces])
    return out


def lamplight(world: StreetWorld, seen: Surfaces, time_s: FloatArray) -> FloatArray:
    """Light (N,) of all lamps that surfaces see, in `LAMP_COLOUR`."""
    out = np.zeros(len(seen.rays))
    for lamp in world.light.lamps:
        near = np.flatnonzero(((seen.points - lamp) ** 2).sum(1) < LAMP_REACH_M**2)
        light, toward, distance = lamp_light(lamp, seen.points[near], seen.soft_normals[near])
        lit_side = (light > _MIN_LAMP_LIGHT) & ((toward * seen.normals[near]).sum(1) > 0)
        near, light, toward, distance = near[lit_side], light[lit_side], toward[lit_side], distance[lit_side]
        start = seen.points[near] + _SHADOW_RAY_OFFSET_M * seen.normals[near]
        reach = distance - _SHADOW_RAY_OFFSET_M
        out[near] += light * lit(world.placements, start, toward, time_s[seen.rays[near]], reach)
    return out


def contact(world: StreetWorld, seen: Surfaces, time_s: FloatArray) -> FloatArray:
    """How open to the sky ground points are (N,), 0..1: an actor darkens the ground under and beside
    its box, softly."""
    out = np.ones(len(seen.rays))
    ground = np.flatnonzero(seen.placement == GROUND_PLACEMENT)
    if not len(ground):
        return out
    points, time = seen.points[ground], time_s[seen.rays[ground]]
    factor = np.ones(len(ground))
    for number, size in enumerate(world.sizes_m):
        placement = world.placements[world.first_actor + number]
        factor *= 1.0 - _shade_under(placement, size, points, time)
    out[ground] = factor
    return out


def _shade_under(placement: AssetPlacement, size_m: FloatArray, points: FloatArray, time_s: FloatArray) -> FloatArray:
    """Share (N,) of the sky that an actor takes from ground points: some of it up to half a box's height away."""
    assert placement.motion is not None
    out = np.zeros(len(points))
    middle = placement.motion.at(float(time_s[len(time_s) // 2]))[:3, 3]
    near = np.flatnonzero(((points[:, :2] - middle[:2]) ** 2).sum(-1) < (np.linalg.norm(size_m) / 2 + 3.0) ** 2)
    if placement.window is not None:
        near = near[(time_s[near] >= placement.window[0]) & (time_s[near] <= placement.window[1])]
    if not len(near):
        return out
    local, _ = to_asset(placement.motion, points[near], np.zeros((len(near), 3)), time_s[near])
    reach = 0.35 * min(float(size_m[2]), 1.6)
    corner = np.abs(local[:, :2]) - (size_m[:2] / 2 - 0.25 * reach)
    distance = np.hypot(*np.maximum(corner, 0).T) + np.minimum(corner.max(-1), 0)
    rise = np.abs(local[:, 2]) - size_m[2] / 2  # a box that floats, or a ground that drops away, shades less
    share = np.clip(0.5 - 0.5 * distance / reach, 0, 1)
    out[near] = 0.88 * share**2 * (3 - 2 * share) * np.exp(-np.maximum(rise, 0) / reach)
    return out


def _image(values: NDArray[Any], view: TracedView) -> NDArray[Any]:
    """Flat values (M, ...) as an image of subsamples (H s, W s, ...)."""
    return untile_image(values.reshape(*view.bundles.shape, *values.shape[1:]), view.height, view.width)


def _average(image: NDArray[Any], samples: int) -> FloatArray:
    height, width = image.shape[0] // samples, image.shape[1] // samples
    return np.asarray(image.reshape(height, samples, width, samples, -1).astype(np.float64).mean((1, 3)))


def _geometry(world: StreetWorld, pose: FloatArray, view: TracedView, samples: int) -> dict[str, NDArray[Any]]:
    """The passes of a `CameraFrame` besides its colours."""
    seen, centre = view.surfaces, samples // 2
    normals = np.zeros((view.hits.t.size, 3))
    normals[seen.rays] = rotate_vectors(world.street_from_world.swapaxes(0, 1), seen.normals)
    instance = world.instance_of(view.hits.placement)
    hit = np.isfinite(view.hits.t)
    pick = (slice(centre, None, samples), slice(centre, None, samples))
    depth = _image(view.hits.t.reshape(-1), view)[pick].astype(np.float32)
    axis = rotate_vectors(world.street_from_world, pose[None, :3, 2])[0]
    cosine = _image((view.bundles.directions @ axis).reshape(-1), view)[pick]
    return {
        "depth_m": depth,
        "z_depth_m": (depth * cosine).astype(np.float32),
        "normal": _image(normals, view)[pick].astype(np.float32),
        "instance": _image(instance.reshape(-1), view)[pick].astype(np.int32),
        "opacity": _average(_image(hit.reshape(-1), view), samples)[..., 0].astype(np.float32),
    }


def truth_lidar(street: Street, drive: Drive, lidar_id: str, frame: int) -> LidarFrame:
    """A sweep with exact ranges. A ray returns where it hits within range and enough light comes back."""
    world = make_world(street, drive)
    lidar = drive.lidars[lidar_id]
    rays = lidar_rays(lidar, lidar.time_s[frame])
    beams, columns = rays.time_s.shape
    hits = echoes(world, *(tile_image(values) for values in (rays.origins, rays.directions, rays.time_s)))

    def grid(values: NDArray[Any]) -> NDArray[Any]:
        return untile_image(values, beams, columns)

    depth = grid(hits.depth_m)
    came_back = grid(hits.returned) & (depth >= lidar.model.min_range_m) & (depth <= lidar.model.max_range_m)
    return LidarFrame(
        model=lidar.model,
        world_from_lidar=lidar.world_from_lidar.at(lidar.time_s[frame]),
        origins=rays.origins,
        directions=rays.directions,
        time_s=rays.time_s,
        depth_m=np.where(came_back, depth, 0.0).astype(np.float32),
        intensity=np.where(came_back, grid(hits.intensity), 0.0).astype(np.float32),
        return_probability=came_back.astype(np.float32),
        returned=came_back,
        instance=np.where(came_back, grid(hits.instance), 0).astype(np.int32),
        instances=world.instances,
        stats=RenderStats(rays=beams * columns),
    )


@dataclass(frozen=True)
class Echoes:
    """Returns of LiDAR rays in bundles (B, K): distances depth_m, inf where nothing is hit; intensities in 0..1; which
    are bright enough to return; instances, indices into the world's plus 1, 0 for the background."""

    depth_m: FloatArray
    intensity: FloatArray
    returned: NDArray[np.bool_]
    instance: NDArray[np.int32]


def echoes(world: StreetWorld, origins: FloatArray, directions: FloatArray, time_s: FloatArray) -> Echoes:
    """Return the echoes of rays in bundles (B, K, 3), (B, K, 3), (B, K) in the drive's world, whatever a LiDAR's range
    is."""
    bundles = _bundles(world, origins, directions, time_s)
    hits = trace(world.placements, bundles)
    o, d, t = bundles.origins.reshape(-1, 3), bundles.directions.reshape(-1, 3), bundles.time_s.reshape(-1)
    seen = look_up(world.placements, hits, o, d, t, _BEAM_DIVERGENCE_RAD)
    distance = np.maximum(hits.t.reshape(-1)[seen.rays], 1e-6)
    # glass scatters little and mirrors the rest away: it is seen head-on alone
    strength = seen.reflectivity * seen.cosine ** (1.0 + 7.0 * seen.glass)
    brightness = seen.reflectivity * (0.25 + 0.75 * seen.cosine) * (1.0 - 0.7 * seen.glass)
    returned, intensity = np.zeros(hits.t.size, bool), np.zeros(hits.t.size)
    returned[seen.rays] = strength / (distance / 100.0) ** 2 >= _MIN_RETURN_REFLECTIVITY
    intensity[seen.rays] = np.clip(brightness, 0, 1)
    instance = world.instance_of(hits.placement)
    shape = bundles.shape
    return Echoes(hits.t, intensity.reshape(shape), returned.reshape(shape), instance)


GROUND_PLACEMENT, STATIC_PLACEMENT = 0, 1
"""Number of the ground's placement; static objects, copies of them and the actors follow."""


@dataclass(frozen=True, eq=False)
class StreetWorld:
    """Placements, street frame: ground, static objects, static copies, actors. instances: the actors' uids, in order.

    footprints: for the contact shadow of each actor, its placement and its box's edges (3,).
    """

    placements: list[AssetPlacement]
    instances: tuple[str, ...]
    sizes_m: list[FloatArray]
    street_from_world: FloatArray
    owners: NDArray[np.int32]
    """For each placement, the index in ``instances`` of its actor plus 1, whose limbs come after the actors; 0 for others."""
    light: StreetLight = DAY

    @property
    def first_actor(self) -> int:
        """Number of the first actor's placement."""
        return int(np.argmax(self.owners > 0)) if self.instances else len(self.placements)

    def instance_of(self, placement: NDArray[np.int16]) -> NDArray[np.int32]:
        """Indices in ``instances`` plus 1 of placements (...) that were hit, 0 for the background and for -1, nothing."""
        return np.append(self.owners, np.int32(0))[placement]


def make_world(street: Street, drive: Drive) -> StreetWorld:
    """The world of a recorded or edited drive of that street. Raises `ScenarioError` where the street
    lacks an appearance."""
    actors = with_windows(drive, drive.labelled_actors)  # less an ego body that no sensor sees
    return _placed(street, street_origin(drive.world_origin), actors, drive.static_removals, drive.static_copies)


def world_of_state(street: Street, street_from_world: FloatArray, state: WorldState) -> StreetWorld:
    """The world of one exposure. Raises `ScenarioError` where the street lacks an appearance."""
    return _placed(street, street_from_world, state.actors, state.removed_boxes, state.static_copies)


def _placed(
    street: Street,
    street_from_world: FloatArray,
    actors: Sequence[Actor],
    removals: Sequence[Box],
    copies: Sequence[StaticCopy],
) -> StreetWorld:
    """The world of actors in the order of their ids, with finite presence."""
    holes = tuple(_moved(street_from_world, box) for box in removals)
    placements = [AssetPlacement("ground", street.ground), AssetPlacement("static", street.static, holes=holes)]
    for copy in copies:
        source = _moved(street_from_world, copy.source)
        street_from_asset = street_from_world @ copy.world_from_target @ invert_pose(source.world_from_box)
        motion = Trajectory.from_poses(np.zeros(1), street_from_asset[None])
        placements.append(AssetPlacement(copy.uid, street.static, motion, clip=source))
    for actor in actors:
        motion = actor.world_from_actor.transformed(left=street_from_world)
        scale = np.array(actor.scale) if actor.is_scaled else None
        window = actor.start_s, actor.end_s
        asset = with_lamps(asset_of(street, actor), actor.lamps)
        placements.append(AssetPlacement(actor.uid, asset, motion, window, scale=scale))
    uids = tuple(actor.uid for actor in actors)
    owners = [0] * (len(placements) - len(uids)) + list(range(1, len(uids) + 1))
    for number in range(len(placements) - len(uids), len(placements)):
        limbs = list(placements[number].limbs())
        placements += limbs
        owners += [owners[number]] * len(limbs)
    sizes = [actor.size_m for actor in actors]
    return StreetWorld(placements, uids, sizes, street_from_world, np.array(owners, np.int32), street.light)


def asset_of(street: Street, actor: Actor) -> Asset:
    """Return the asset of an actor's appearance."""
    appearance = actor.appearance
    source = street
    if appearance.mesh:
        raise ScenarioError(
            f"actor {actor.uid!r} is the mesh {appearance.mesh}, which a street's own renderer does not draw"
        )
    if appearance.scene:
        if appearance.scene not in street.others:
            raise ScenarioError(
                f"actor {actor.uid!r} looks like {appearance.actor!r} of {appearance.scene!r}, a scene whose street is not known"
            )
        source = street.others[appearance.scene]
    if appearance.actor not in source.assets:
        raise ScenarioError(
            f"actor {actor.uid!r} looks like {appearance.actor!r}, which street {source.recipe.seed} does not have"
        )
    return source.assets[appearance.actor]


def _moved(pose: FloatArray, box: Box) -> Box:
    return Box(pose @ box.world_from_box, np.asarray(box.size_m, np.float64))
