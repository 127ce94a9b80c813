"""The renderer ``street``: a procedural street as it truly is, and its actors where a state of the world has them."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unisim_blender.core.errors import LogError
from unisim_blender.core.geometry import FloatArray, transform_points
from unisim_blender.core.render.captures import CaptureStates
from unisim_blender.core.render.code_identity import NOT_RENDERING, code_digest
from unisim_blender.core.render.lattice import Region, Tile
from unisim_blender.core.render.quality import Quality, quality_named
from unisim_blender.core.render.renderer import Renderer
from unisim_blender.core.render.tracer import NEAR_M, ActiveActors, ActorSet, Array, TraceResult
from unisim_blender.core.render.visibility import Reach
from unisim_blender.core.scenes.recipe import RendererRecipe, RenderMethod
from unisim_blender.core.scenes.scene import Scene
from unisim_blender.core.sensors.frames import CameraFrame, RenderStats
from unisim_blender.core.sensors.rays import Rays
from unisim_blender.core.world.drive import Actor, Box, Camera, Drive
from unisim_blender.core.world.replay import DriveStates, WorldState

from .street import RECIPE_FILE, Street, load_street, recipe_document, street_of, street_origin
from .tracing.trace import TILE_PX, tile_image, untile_image
from .truth import StreetWorld, echoes, exact_image, seen_colours, world_of_state

WHOLE = Reach(whole=True)


@dataclass(eq=False)
class StreetTracer:
    """A street in a state of the world, a ray a pixel. `StreetRenderer`'s images average several."""

    street: Street
    world: StreetWorld
    active: ActiveActors
    quality: Quality
    upsample: int = 1
    reach: int = 0
    trained_width: int | None = 0

    def trace(
        self, rays: Rays, passes: set[str], sky: bool, mesh_hits: object, stats: RenderStats
    ) -> TraceResult[Array]:
        """See `Tracer.trace`; the feature is the colour where ``sky`` is asked for, or else the intensity."""
        stats.rays += rays.time_s.size
        return self._colours(rays, passes) if sky else self._echoes(rays, passes)

    def _colours(self, rays: Rays, passes: set[str]) -> TraceResult[Array]:
        shape = rays.time_s.shape
        origins, directions, time_s = (_bundled(v, shape) for v in (rays.origins, rays.directions, rays.time_s))
        apart = np.linalg.norm(np.diff(rays.directions.reshape(-1, 3), axis=0), axis=-1)
        hits = seen_colours(self.world, origins, directions, time_s, float(np.median(apart)) if len(apart) else 0.0)
        depth = _flat(hits.depth_m, shape)
        opacity = np.isfinite(depth).astype(np.float32)
        maps = {
            "depth": depth.astype(np.float32),
            "instance": _flat(hits.instance, shape).astype(np.int32),
            "normal": _flat(hits.normal, shape).astype(np.float32),
            "opacity": opacity,
            "unsupported": np.zeros(depth.shape, bool),
        }
        return TraceResult(
            _flat(hits.rgb, shape).astype(np.float32),
            np.where(np.isfinite(depth), depth, 0.0),
            opacity,
            {name: values for name, values in maps.items() if name in passes},
        )

    def _echoes(self, rays: Rays, passes: set[str]) -> TraceResult[Array]:
        shape = rays.time_s.shape
        bundled = [_bundled(values, shape) for values in (rays.origins, rays.directions, rays.time_s)]
        traced = echoes(self.world, *bundled)
        near = traced.depth_m < NEAR_M
        if near.any():  # nothing nearer is looked at
            beyond = echoes(self.world, bundled[0] + NEAR_M * bundled[1], *bundled[1:])
            traced = replace(
                traced,
                depth_m=np.where(near, beyond.depth_m + NEAR_M, traced.depth_m),
                **{name: np.where(near, getattr(beyond, name), getattr(traced, name)) for name in _RETURN_FIELDS},
            )
        depth, intensity, returned, instance = (
            _flat(values, shape) for values in (traced.depth_m, traced.intensity, traced.returned, traced.instance)
        )
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

    def image(
        self, traced: TraceResult[Array], directions: FloatArray, camera_id: str, shape: tuple[int, ...]
    ) -> Array:
        """See `Tracer.image`."""
        return np.asarray(traced.feature.reshape(*shape, 3))

    def returns(self, traced: TraceResult[Array], directions: FloatArray) -> tuple[Array, Array]:
        """See `Tracer.returns`."""
        return traced.feature, traced.opacity

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
    frame.confidence = np.ones(frame.rgb.shape[:2], np.float32)
    for name in ("depth_m", "z_depth_m", "normal", "instance", "opacity", "unsupported", "confidence"):
        asked = name.removeprefix("z_").removesuffix("_m") in passes
        setattr(frame, name, getattr(frame, name)[part] if asked else None)
    frame.rgb = frame.rgb[part]
    return frame


_RETURN_FIELDS = "intensity", "returned", "instance"


def _bundled(values: FloatArray, shape: tuple[int, ...]) -> FloatArray:
    """Return values of rays (h, w, ...) or (N, ...) in bundles (B, TILE ** 2, ...); the last are repeated to whole ones."""
    if len(shape) == 2:
        return tile_image(values)
    size = TILE_PX * TILE_PX
    numbers = np.minimum(np.arange(-(-shape[0] // size) * size), shape[0] - 1)
    return values[numbers].reshape(-1, size, *values.shape[1:])


def _flat(values: NDArray[Any], shape: tuple[int, ...]) -> NDArray[Any]:
    """Return values (B, TILE ** 2, ...) in bundles as those of flat rays (N, ...)."""
    rays = untile_image(values, *shape) if len(shape) == 2 else values
    return rays.reshape(-1, *values.shape[2:])[: int(np.prod(shape))]


HERE = Path(__file__).parent
SAMPLES_PER_EDGE = {"fast": 1}
"""Rays along an edge of a pixel, by the quality; `RECORDED_SAMPLES_PER_EDGE` for the others."""
RECORDED_SAMPLES_PER_EDGE = 2
"""Rays along an edge of a pixel of recorded images."""


class StreetMethod(RenderMethod):
    """The renderer of procedural streets alone, and of those that actors were inserted from."""

    name = "street"
    about = "a procedural street as it is"

    def check_inputs(self, log: Path, scene: Scene | None) -> None:
        """Raises `LogError` where the log is not a procedural street's, or was drawn by another engine."""
        if not (log / RECIPE_FILE).is_file():
            raise LogError(
                f"{log}: is no procedural street, it has no {RECIPE_FILE}: --renderer street shows streets alone"
            )
        engine = load_street(log).recipe.engine
        if engine != "exact":
            raise LogError(f"{log}: was drawn by the engine {engine}: --renderer street draws as the engine exact does")

    def load(self, recipe: RendererRecipe) -> StreetRenderer:
        """Build the street, and those that actors were inserted from. Raises `UnisimError`."""
        return renderer_of_street(_street(recipe), recipe.world_origin, recipe.quality)

    def digests(self, recipe: RendererRecipe, drive: Drive) -> dict[str, str]:
        """Return digests of the streets' recipes, with the code that draws streets."""
        street = _street(recipe)
        return {"": _digest(street), **{name: _digest(other) for name, other in street.others.items()}}

    def states(self, recipe: RendererRecipe, drive: Drive) -> CaptureStates:
        """See `RenderMethod.states`."""
        return CaptureStates(DriveStates(drive, {}), WHOLE)


def _street(recipe: RendererRecipe) -> Street:
    return street_of(load_street(recipe.log), recipe.others)


def renderer_of_street(street: Street, world_origin: FloatArray, quality: str) -> StreetRenderer:
    """Return the renderer of drives through a street, in a world with this origin."""
    samples = SAMPLES_PER_EDGE.get(quality, RECORDED_SAMPLES_PER_EDGE)
    return StreetRenderer(StreetBackend(street, street_origin(world_origin), quality_named(quality), samples))


def _digest(street: Street) -> str:
    code = code_digest(NOT_RENDERING) + code_digest(root=HERE)
    drawn = {"street": recipe_document(street.recipe), "code": code}
    return hashlib.sha256(json.dumps(drawn, sort_keys=True).encode()).hexdigest()


STREET = StreetMethod()
