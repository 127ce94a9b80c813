"""A tracer and its renderer: a chequered ground and a sky, without actors and without a trained scene."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unisim_blender.core.geometry import FloatArray
from unisim_blender.core.meshes.hits import MeshHits
from unisim_blender.core.render.captures import CaptureStates
from unisim_blender.core.render.quality import Quality
from unisim_blender.core.render.renderer import Renderer, reach_of
from unisim_blender.core.render.tracer import ActiveActors, TraceResult, active_actors
from unisim_blender.core.scenes.recipe import RendererRecipe, RenderMethod
from unisim_blender.core.sensors.frames import RenderStats
from unisim_blender.core.sensors.rays import Rays
from unisim_blender.core.world.drive import Actor, Box, Drive
from unisim_blender.core.world.replay import DriveStates, WorldState

Array = NDArray[np.float32]


class ChequeredGround:
    """A backend: the plane z = 0 in squares of a metre."""

    quality = Quality()
    parked: Mapping[str, Box] = {}
    sees_all = False

    def bind(self, state: WorldState) -> ChequeredTracer:
        return ChequeredTracer(self, active_actors(state, {"": None}))

    def is_steady(self, sensor_id: str, start_s: float, end_s: float) -> bool:
        return True

    def overhang_m(self, actor: Actor) -> float:
        return 0.0


class ChequeredTracer:
    """Traces rays through the plane."""

    upsample = 1  # an image pixel per ray
    reach = 0  # a pixel depends on its own ray alone
    trained_width: int | None = None

    def __init__(self, backend: ChequeredGround, active: ActiveActors) -> None:
        self.quality, self.active = backend.quality, active

    def trace(
        self, rays: Rays, passes: set[str], sky: bool, mesh_hits: MeshHits | None, stats: RenderStats
    ) -> TraceResult[Array]:
        flat = rays.flat().sound()
        down = flat.directions[:, 2]
        hit = (down < -1e-6) & (flat.origins[:, 2] > 0)
        depth = np.where(hit, -flat.origins[:, 2] / np.where(hit, down, -1.0), np.inf)
        at = flat.origins[:, :2] + np.where(hit, depth, 0.0)[:, None] * flat.directions[:, :2]
        light = np.where(np.floor(at).sum(-1) % 2 == 0, 0.7, 0.3)
        colour = np.where(hit[:, None], light[:, None], (0.5, 0.7, 1.0)).astype(np.float32)
        maps: dict[str, NDArray[Any]] = {
            "depth": depth.astype(np.float32),
            "instance": np.zeros(len(depth), np.int32),
            "opacity": hit.astype(np.float32),
            "unsupported": np.zeros(len(depth), bool),
            "normal": np.where(hit[:, None], (0.0, 0.0, 1.0), 0.0).astype(np.float32),
        }
        stats.rays += len(depth)
        maps = {name: values for name, values in maps.items() if name in passes}
        return TraceResult(colour, np.where(hit, depth, 0.0), hit.astype(np.float32), maps)

    def image(
        self, traced: TraceResult[Array], directions: FloatArray, camera_id: str, shape: tuple[int, ...]
    ) -> Array:
        image: Array = traced.feature.reshape(*shape, 3)
        return image

    def returns(self, traced: TraceResult[Array], directions: FloatArray) -> tuple[Array, Array]:
        return traced.feature[:, 0], traced.opacity

    def heights(self, points: FloatArray) -> FloatArray:
        return points[:, 2]


class Chequered(RenderMethod):
    """The renderer of the command line: it pickles, and is loaded where it renders."""

    name = "chequered"
    about = "chequered ground"

    def load(self, recipe: RendererRecipe) -> Renderer:
        return Renderer(ChequeredGround())

    def digests(self, recipe: RendererRecipe, drive: Drive) -> dict[str, str]:
        return {"": "chequered, version 1"}  # what a capture depends on besides the drive and the settings

    def states(self, recipe: RendererRecipe, drive: Drive) -> CaptureStates:
        return CaptureStates(DriveStates(drive, {}), reach_of(shadows=False))
