"""One image that is being rendered, and single rays in its colours."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..data.exposures import Exposures
from ..geometry import BoolArray, FloatArray
from ..meshes.exposure import PROBE_M
from ..sensors.frames import RenderStats
from ..sensors.rays import Rays
from ..weather import camera as camera_weather
from ..weather import wet_ground
from ..weather.spray import Puffs
from ..world.drive import Actor, Camera
from ..world.replay import WorldState
from .plane_fill import PlaneFill
from .quality import Quality
from .sun_shadow import GroundBeside, SunPatch, SunShadows
from .tracer import Array, Backend, Maps, Tracer

FINISHING_MAPS = {"depth", "instance"}
"""Maps of an image that weather and fixers need."""


@dataclass
class PendingImage:
    """One image to render: the request, the maps that it needs, and results that its parts share."""

    tracer: Tracer[Any]
    state: WorldState
    camera: Camera
    time_s: float
    passes: Sequence[str] = ()
    needed: set[str] = field(default_factory=set)
    undeciding: set[str] = field(default_factory=set)
    """Those of the maps that an edit needs, and the request does not: a lattice that decided by them would change pixels that
    the edit does not reach."""
    shadowing: list[Actor] = field(default_factory=list)
    """Actors with contact shadows under them."""
    displaced: dict[int, Actor] = field(default_factory=dict)
    """Actors whose ground fades, by instance."""
    shadows: SunShadows | None = None
    """Shadows that edits have moved, where the sun is known."""
    beside: GroundBeside | None = None
    """The ground beside what has changed, once it is needed."""
    patches: dict[str, list[SunPatch]] = field(default_factory=dict)
    """Shade on the ground of actors that are lit for where they stand, here and where they were recorded, by their ids."""
    begun: float = field(default_factory=time.perf_counter)
    stats: RenderStats = field(default_factory=RenderStats)
    launched: Callable[[RenderStats], Maps | None] | None = None
    """What waits for the whole image, which a GPU has begun."""
    lights: dict[str, FloatArray] = field(default_factory=dict)
    """Brightness of white ground under an actor, by the actor's id."""
    air: camera_weather.Air | None = None
    """The air of the weather; None where the image is to be that of clear air."""
    mirror: wet_ground.Mirror | None = None
    """What wet ground reflects, once it is traced."""
    puffs: Puffs | None = None
    """Spray behind vehicles, once it is looked for."""
    particles: camera_weather.DrawnParticles | None = None
    """Drops and flakes in the image, once they are drawn."""
    fill: PlaneFill | None = None
    """What ground and façades have where nobody saw them; None where they are to stay as the scene has them."""
    filled: Array | None = None
    """How much of the part (H, W) of the image that was last finished is filled, 0..1; None without a fill."""
    is_detailed: bool = False
    """Whether detail of recorded images is added."""
    is_fixed: bool = False
    """Whether a fixer draws anew what no recorded image shows."""
    lit: dict[int, Actor] = field(default_factory=dict)
    """Actors whose lamps edits switch, by instance."""

    @property
    def is_shaded(self) -> bool:
        """Whether there are shadows to put into the image."""
        return bool(self.shadowing) or self.shadows is not None

    @property
    def needs_rays(self) -> bool:
        """Whether the frame is finished by its rays: for shadows, for what is filled and for confidence."""
        return self.is_drawn_on or "confidence" in self.passes

    @property
    def shown(self) -> set[str]:
        """The maps that the frame has until it is finished: the passes, and what weather and a fixer need."""
        return {*self.passes, *(FINISHING_MAPS if self.is_fixed or self.air is not None else ())}

    @property
    def is_drawn_on(self) -> bool:
        """Whether the image is changed by what its rays hit."""
        return self.is_shaded or self.is_detailed or self.fill is not None or bool(self.lit)


class Binding:
    """A backend and its tracer of the last state."""

    def __init__(self, backend: Backend) -> None:
        self.backend = backend
        self._last: tuple[WorldState, Tracer[Any]] | None = None

    def tracer(self, state: WorldState, quality: Quality) -> Tracer[Any]:
        """Return the backend's tracer of this state."""
        if self._last is None or (self._last[0] is not state and self._last[0] != state):
            self._last = state, self.backend.bind(state)
        tracer = self._last[1]
        tracer.quality = quality
        return tracer

    def exposed(self, image: NDArray[np.float32], camera_id: str, time_s: float) -> NDArray[np.float32]:
        """Return a camera's image, or its colours (..., 3), exposed as a trained scene's images around its time are."""
        gain = self.gain(camera_id, time_s)
        return image if gain is None else np.minimum(image * gain, np.float32(1))

    def gain(self, camera_id: str, time_s: float) -> NDArray[np.float32] | None:
        """Return the gain (3,) of a trained scene's images around a time; None where there is none."""
        exposures: Exposures | None = getattr(self.backend, "exposures", None)
        if exposures is None or camera_id not in exposures.by_camera:
            return None
        return exposures.at(camera_id, np.array([time_s]))[0].astype(np.float32)

    def is_steady(self, sensor_id: str, start_s: float, end_s: float) -> bool:
        """See `tracer.Backend`."""
        exposures: Exposures | None = getattr(self.backend, "exposures", None)
        exposed_alike = exposures is None or exposures.is_constant(sensor_id, start_s, end_s)
        return exposed_alike and self.backend.is_steady(sensor_id, start_s, end_s)


def row_of_colours(
    pending: PendingImage, rays: Rays, binding: Binding, tracer: Tracer[Any], needed: set[str]
) -> tuple[NDArray[np.float32], Maps]:
    """Return colours (N, 3), as in a camera's image, and the needed maps of flat rays (N,) that see no mesh. They are a row
    of cells: a decoder that reads neighbours sees ground on both sides."""
    if not len(rays.time_s):
        empty: Maps = {name: np.empty(0, np.int32 if name == "instance" else np.float32) for name in needed}
        return np.empty((0, 3), np.float32), empty
    sensor_id = pending.camera.sensor_id
    traced = tracer.trace(rays, needed, True, None, RenderStats())
    rgb = tracer.image(traced, rays.directions, sensor_id, (1, len(rays.time_s)))[0, :: tracer.upsample]
    return binding.exposed(rgb, sensor_id, pending.time_s), traced.maps


def colours_at(
    pending: PendingImage, points: FloatArray, binding: Binding, tracer: Tracer[Any]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return colours (N, 3), in a camera's image, of what is at points (N, 3) and no actor, and its distances (N,)
    from `PROBE_M` before them."""
    camera, time_s = pending.camera, pending.time_s
    to = points - camera.world_from_camera.at(time_s)[:3, 3]
    distance = np.linalg.norm(to, axis=1, keepdims=True)
    directions = to / distance
    rays = Rays(points - directions * np.minimum(distance, PROBE_M), directions, np.full(len(points), time_s))
    rgb, maps = row_of_colours(pending, rays, binding, tracer, {"instance", "depth"})
    return rgb, np.where(maps["instance"] == 0, maps["depth"], np.inf)


def ground_of(pending: PendingImage, shape: tuple[int, ...], rays: Rays, maps: Maps) -> tuple[FloatArray, BoolArray]:
    """Return the places (H, W, 3) that the pixels of an image of ``shape`` show by rays (h, w), and where those are of no actor
    (H, W)."""
    up, depth = pending.tracer.upsample, maps["depth"].reshape(rays.time_s.shape).astype(np.float64)
    points = rays.origins + rays.directions * np.where(np.isfinite(depth), depth, 1e6)[..., None]
    ground = (maps["instance"].reshape(rays.time_s.shape) == 0) & np.isfinite(depth)
    return per_pixel(points, up, shape), per_pixel(ground, up, shape)


def per_pixel(values: NDArray[Any], up: int, shape: tuple[int, ...]) -> NDArray[Any]:
    """Return the values (H, W, ...) of an image's pixels, of ``shape``, from those (h, w, ...) of cells of ``up`` x ``up``."""
    return np.repeat(np.repeat(values, up, 0), up, 1)[: shape[0], : shape[1]]
