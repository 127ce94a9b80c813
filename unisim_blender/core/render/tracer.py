"""Interface that the renderer requires of a tracer: the compiled kernels with numpy alone, or torch, which is the
reference and runs on GPUs.

Rays are in the world frame, float64. Arrays are numpy's, but for what only the tracer itself reads again: that may stay
where it computes. Active actors are sorted by the scene that their appearances come from.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..errors import SceneError
from ..geometry import FloatArray, Trajectory
from ..meshes.hits import MeshActors, MeshHits
from ..sensors.frames import RenderStats
from ..sensors.rays import Rays
from ..world.drive import Actor, Appearance, Box, StaticCopy
from ..world.replay import WorldState
from .quality import Quality


@dataclass(frozen=True)
class ActorSet:
    """Actors whose appearances come from one scene, and each one's row of that scene's tables."""

    actors: tuple[Actor, ...]
    rows: tuple[int, ...]

    @property
    def uids(self) -> tuple[str, ...]:
        return tuple(actor.uid for actor in self.actors)


@dataclass(frozen=True)
class ActiveActors:
    """Active actors of a state. ``own`` are those with appearances of the scene itself, ``foreign`` those of other
    scenes by their paths, in order; ``mesh_actors`` are meshes. ``removals`` are boxes in which nothing stands above
    the ground; ``targets`` are boxes of copies, as actors that stand still throughout, and ``sources`` where each one's
    content is."""

    own: ActorSet
    foreign: dict[str, ActorSet] = field(default_factory=dict)
    removals: tuple[Box, ...] = ()
    targets: tuple[Actor, ...] = ()
    sources: tuple[Box, ...] = ()
    mesh_actors: MeshActors = field(default_factory=lambda: MeshActors(()))

    @property
    def uids(self) -> tuple[str, ...]:
        """Every actor's id: own ones, then foreign actors', then meshes'; instance n + 1 is the n-th of them."""
        return (
            self.own.uids
            + tuple(uid for actor_set in self.foreign.values() for uid in actor_set.uids)
            + self.mesh_actors.uids
        )


def active_actors(state: WorldState, appearances: Mapping[str, Sequence[str] | None]) -> ActiveActors:
    """Return the active actors of a state. ``appearances`` are the actors that the rows of each scene's tables belong
    to, the scene's own under "", others' under their paths, None for a scene that is one field: it has no own actors,
    and what a state says of them is left out. Raises `SceneError`."""
    scene_is_single_field = appearances[""] is None
    actors = [a for a in state.actors if not scene_is_single_field or a.appearance.scene or a.appearance.mesh]
    foreign = {}
    for path in sorted({a.appearance.scene for a in actors if a.appearance.scene}):
        if path not in appearances:
            raise SceneError(f"{path}: this trained scene is needed for an inserted actor and was not loaded")
        foreign[path] = _actor_set(appearances[path], [a for a in actors if a.appearance.scene == path])
    return ActiveActors(
        own=_actor_set(appearances[""], [a for a in actors if not a.appearance.scene and not a.appearance.mesh]),
        foreign=foreign,
        removals=state.removed_boxes,
        targets=tuple(_target(state, copy) for copy in state.static_copies),
        sources=tuple(copy.source for copy in state.static_copies),
        # ego bodies last: the numbers of other meshes are the same for sensors that do not see them
        mesh_actors=MeshActors(sorted((a for a in actors if a.appearance.mesh), key=lambda a: a.is_ego_body)),
    )


def _actor_set(appearances: Sequence[str] | None, actors: list[Actor]) -> ActorSet:
    rows = {uid: row for row, uid in enumerate(appearances or ())}
    for actor in actors:
        if actor.appearance.actor not in rows:
            where = f" at {actor.appearance.scene}" if actor.appearance.scene else ""
            raise SceneError(
                f"actor {actor.uid!r} has the appearance of {actor.appearance.actor!r}, "
                f"which the trained scene{where} does not hold"
            )
    return ActorSet(tuple(actors), tuple(rows[actor.appearance.actor] for actor in actors))


def _target(state: WorldState, copy: StaticCopy) -> Actor:
    """Return a copy's box as an actor that stands still throughout."""
    trajectory = Trajectory.from_poses(np.zeros(1), copy.world_from_target[None])
    return Actor(
        copy.uid, "Static", copy.source.size_m, trajectory, state.start_s, state.end_s, False, Appearance(copy.uid)
    )


Array = NDArray[np.float32]
ValuesT = TypeVar("ValuesT")
"""Numbers of rays (N, ...) where a tracer computes: an array, or a tensor on a device."""
Maps = dict[str, NDArray[Any]]
"""One array (N, ...) for each pass."""
NEAR_M = 0.5
"""Distance from the sensor at which rays begin, metres."""
BUNDLE_SIDE_RAYS = 8
"""Edge of the square of rays that are traced together."""
FOREIGN_EDGE_CELLS = 8
"""Number of cells by which a foreign actor's features are extended past its edges, for the decoder's convolutions."""
UNIFORM_STEP_M = 0.2
"""Step, in metres, of the uniform march through the volume whose samples are the baseline of saved samples."""


@dataclass
class TraceResult(Generic[ValuesT]):
    """Result of tracing rays (N,). feature (N, F) composited, the background and the sky included where they were asked
    for; depth_m (N,) the mean distance, metres along the ray, of what stopped it, 0 where nothing did; opacity (N,) in
    0..1; maps, one array (N, ...) for each pass."""

    feature: ValuesT
    depth_m: ValuesT
    opacity: ValuesT
    maps: Maps
    foreign_features: list[ValuesT] = field(default_factory=list)
    """Features (N, F') of each foreign scene, composited."""
    foreign_opacity: list[ValuesT] = field(default_factory=list)
    """Opacity (N,) of each foreign scene's actors."""
    without_foreign: ValuesT | None = None
    """``feature`` as if no foreign actor and no mesh were there; None where none is."""
    returned: tuple[ValuesT, ValuesT] | None = None
    """Intensity and the probability of a return (N,) of beams, where they are decoded already and ``feature`` is empty."""
    mesh_opacity: Array | None = None
    """Opacity (N,) of meshes; None where there are none."""


class Backend(Protocol):
    """Trained scenes, or what else rays are traced through, loaded once. It knows no drive: `bind` makes it ready for a
    state of the world, in a few milliseconds."""

    quality: Quality
    """Default quality, which says what may be saved."""
    parked: Mapping[str, Box]
    """Boxes of actors that stood still throughout the recording, by their ids: the static field does not hold them."""
    sees_all: bool
    """Whether a frame depends on actors out of its view."""

    def bind(self, state: WorldState) -> Tracer[Any]:
        """Return the tracer of the scene in this state. Raises `SceneError` for actors that no scene holds."""

    def is_steady(self, sensor_id: str, start_s: float, end_s: float) -> bool:
        """Return whether what stands has the same bits for a sensor that stands at all times from ``start_s`` to
        ``end_s``, seconds, whatever else is traced with it."""

    def overhang_m(self, actor: Actor) -> float:
        """Return the largest distance, metres, by which an actor may extend past its box."""


class Tracer(Protocol[ValuesT]):
    """A scene in a state of the world, ready for rays."""

    upsample: int
    """Image pixels along one edge of a cell of the feature map."""
    reach: int
    """Largest distance, in cells, of a cell that a pixel of `image` depends on."""
    active: ActiveActors
    """The actors of the state, by the scene that their appearances come from."""
    quality: Quality
    """Quality, which says what may be saved; it may be changed between two calls."""
    trained_width: int | None
    """Width in pixels of the images that the scene learnt from; None for the recorded one, 0 for none."""

    def trace(
        self, rays: Rays, passes: set[str], sky: bool, mesh_hits: MeshHits | None, stats: RenderStats
    ) -> TraceResult[ValuesT]:
        """Trace rays (h, w), or (N,), and return their hits as flat arrays, with maps of these passes and no other.
        ``sky`` asks for what gives a camera its background, ``mesh_hits`` is where the rays hit meshes."""

    def image(
        self, traced: TraceResult[ValuesT], directions: FloatArray, camera_id: str, shape: tuple[int, ...]
    ) -> Array:
        """Return the image (h up, w up, 3) in 0..1, display-referred sRGB, of cells in ``shape`` (h, w), seen along
        unit directions (h w, 3), world frame."""

    def returns(self, traced: TraceResult[ValuesT], directions: FloatArray) -> tuple[Array, Array]:
        """Return a LiDAR's intensities in 0..1 (N,), and the probabilities of a return (N,), along unit directions (N,
        3)."""

    def heights(self, points: FloatArray) -> FloatArray:
        """Return the heights (N,), metres, of points (N, 3), world frame, above the ground."""


def tiled(shape: tuple[int, ...]) -> NDArray[np.int64]:
    """Return the numbers (h w,) int64 of rays of ``shape`` (h, w), or (N,), ordered by squares: near rays read the same
    rows."""
    numbers = np.arange(int(np.prod(shape)), dtype=np.int64).reshape(shape)
    if len(shape) < 2:
        return numbers
    h, w = shape
    rows, columns = -(-h // BUNDLE_SIDE_RAYS) * BUNDLE_SIDE_RAYS, -(-w // BUNDLE_SIDE_RAYS) * BUNDLE_SIDE_RAYS
    padded = np.full((rows, columns), -1, np.int64)
    padded[:h, :w] = numbers
    order = (
        padded.reshape(rows // BUNDLE_SIDE_RAYS, BUNDLE_SIDE_RAYS, columns // BUNDLE_SIDE_RAYS, BUNDLE_SIDE_RAYS)
        .swapaxes(1, 2)
        .reshape(-1)
    )
    return np.ascontiguousarray(order[order >= 0])
