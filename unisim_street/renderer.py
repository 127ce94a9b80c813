"""A renderer of states of the world that shows what is truly there: a street, and its actors where the state has them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unisim_blender.core.geometry import FloatArray, transform_points
from unisim_blender.core.render.quality import Quality
from unisim_blender.core.render.regions import Region, Tile
from unisim_blender.core.render.renderer import Renderer
from unisim_blender.core.render.tracer import NEAR_M, ActiveActors, ActorSet, Array, TraceResult
from unisim_blender.core.render.visibility import Reach
from unisim_blender.core.sensors.frames import CameraFrame, RenderStats
from unisim_blender.core.sensors.rays import Rays
from unisim_blender.core.world.drive import Actor, Box, Camera
from unisim_blender.core.world.state import WorldState

from .street import Street
from .tracing.bundles import TILE, tile_image, untile_image
from .truth import echoes, exact_image
from .world import StreetWorld, world_of_state

WHOLE = Reach(whole=True)


@dataclass(eq=False)
class StreetTracer:
    """A street in a state of the world. Rays are a LiDAR's: images are `StreetRenderer`'s."""

    street: Street
    world: StreetWorld
    active: ActiveActors
    quality: Quality
    upsample: int = 1
    reach: int = 0
    trained_width: int | None = None

    def trace(self, rays: Rays, passes: set[str], sky: bool, mesh_hits: object, stats: RenderStats) -> TraceResult:
        """See `Tracer.trace`; the feature is the intensity."""
        shape = rays.time_s.shape
        bundled = [_bundled(values, shape) for values in (rays.origins, rays.directions, rays.time_s)]
        found = echoes(self.world, *bundled)
        near = found.depth_m < NEAR_M
        if near.any():  # nothing nearer is looked at
            beyond = echoes(self.world, bundled[0] + NEAR_M * bundled[1], *bundled[1:])
            found = replace(
                found,
                depth_m=np.where(near, beyond.depth_m + NEAR_M, found.depth_m),
                **{name: np.where(near, getattr(beyond, name), getattr(found, name)) for name in _OF_RETURNS},
            )
        depth, intensity, returned, instance = (
            _flat(values, shape) for values in (found.depth_m, found.intensity, found.returned, found.instance)
        )
        stats.rays += depth.size
        distance = np.where(returned, depth, np.inf).astype(np.float32)
        maps = {
            "depth": distance,
            "instance": np.where(returned, instance, 0).astype(np.int32),
            "opacity": returned.astype(np.float32),
            "unsupported": np.zeros(depth.shape, bool),
        }
        return TraceResult(
            (intensity * returned).astype(np.float32),
            np.where(returned, depth, 0.0),
            returned.astype(np.float32),
            {name: values for name, values in maps.items() if name in passes},
        )

    def image(self, found: TraceResult, directions: FloatArray, camera_id: str, shape: tuple[int, ...]) -> Array:
        """Raises `TypeError`: rays have intensities, and no colours."""
        raise TypeError("rays of a street have no colours: render images of it")

    def returns(self, found: TraceResult, directions: FloatArray) -> tuple[Array, Array]:
        """See `Tracer.returns`."""
        return found.feature, found.opacity

    def heights(self, points: FloatArray) -> FloatArray:
        """See `Tracer.heights`."""
        local = transform_points(self.world.street_from_world, points)
        return np.asarray(local[:, 2] - self.street.ground_height(local[:, :2]))


@dataclass(eq=False)
class StreetBackend:
    """A street, in the frame of a drive that is ``street_from_world`` (4, 4) away from the street's own.

    ``samples`` x ``samples`` rays a pixel are averaged.
    """

    street: Street
    street_from_world: FloatArray
    quality: Quality
    samples: int = 2
    parked: Mapping[str, Box] = field(default_factory=dict)
    """None: nothing is missing where a parked car was."""
    sees_all: bool = False

    def bind(self, state: WorldState) -> StreetTracer:
        """See `Backend.bind`. Raises `ScenarioError` for actors that the street does not have."""
        world = world_of_state(self.street, self.street_from_world, state)
        active = ActiveActors(ActorSet(state.actors, tuple(range(len(state.actors)))), removals=state.removed_boxes)
        return StreetTracer(self.street, world, active, self.quality)

    def is_steady(self, sensor_id: str, start_s: float, end_s: float) -> bool:
        """See `Backend.is_steady`: never, since shadows fall far from what moves."""
        return False

    def overhang_m(self, actor: Actor) -> float:
        """See `Backend.overhang_m`: nothing shows beside its box."""
        return 0.0


class StreetRenderer(Renderer):
    """Renders what a street's sensors truly measure, without the noise of recorded ranges. Every pixel is supported."""

    backend: StreetBackend

    def __init__(self, backend: StreetBackend) -> None:
        super().__init__(backend)

    @property
    def reach(self) -> Reach:
        """Frames depend on all that is there: shadows come from actors out of view."""
        return WHOLE

    def progressive(
        self,
        state: WorldState,
        camera: Camera,
        time_s: float,
        passes: Sequence[str] = ("rgb",),
        region: Region | None = None,
        coarse: Sequence[int] = (),
        band: int | None = None,
    ) -> Iterator[Tile]:
        """Render the image at once, whatever ``coarse`` and ``band`` say: one tile."""
        tracer = self.tracer(state)
        assert isinstance(tracer, StreetTracer)
        whole = Region.of_image(camera.model)
        region = whole if region is None else region
        frame = exact_image(tracer.world, camera, time_s, self.backend.samples)
        yield Tile(_with_passes(frame, passes, region), region)


def _with_passes(frame: CameraFrame, passes: Sequence[str], region: Region) -> CameraFrame:
    """Return the region of a frame, with these passes and no other."""
    part = slice(region.top, region.bottom), slice(region.left, region.right)
    frame.unsupported = np.zeros(frame.rgb.shape[:2], bool)
    for name in ("depth_m", "z_depth_m", "normal", "instance", "opacity", "unsupported"):
        asked = name.removeprefix("z_").removesuffix("_m") in passes
        setattr(frame, name, getattr(frame, name)[part] if asked else None)
    frame.rgb = frame.rgb[part]
    return frame


_OF_RETURNS = "intensity", "returned", "instance"


def _bundled(values: FloatArray, shape: tuple[int, ...]) -> FloatArray:
    """Return values of rays (h, w, ...) or (N, ...) in bundles (B, TILE ** 2, ...); the last are repeated to whole ones."""
    if len(shape) == 2:
        return tile_image(values)
    size = TILE * TILE
    numbers = np.minimum(np.arange(-(-shape[0] // size) * size), shape[0] - 1)
    return values[numbers].reshape(-1, size, *values.shape[1:])


def _flat(values: NDArray[Any], shape: tuple[int, ...]) -> NDArray[Any]:
    """Return values in bundles as those of flat rays (N,)."""
    return (untile_image(values, *shape) if len(shape) == 2 else values).reshape(-1)[: int(np.prod(shape))]
