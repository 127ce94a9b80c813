"""Surfels: small faces on what LiDAR met, with the intensity that it measured and the colours that cameras saw."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....data.own_vehicle import Outline, outlines_from_json, outlines_to_json
from ....geometry import BoolArray, FloatArray
from ....meshes.intersect import Triangles, check_boxes
from ....ops.constants import CLEARANCE_M
from .drops import DropTable
from .exposure import Exposures
from .ground import HeightGrid

FORMAT_VERSION = 4
META_NAME = "surfels.json"
GOLDEN = np.pi * (3 - np.sqrt(5))


@dataclass(frozen=True)
class SurfelSettings:
    """How surfels are made: one in a cube of ``voxel_m``, a triangle with its corners ``face_m`` from its middle; where returns
    lie farther apart it grows with their distance, up to ``grown_m``. ``mirror`` gives vehicles the faces of their other side
    where nothing was seen of this one."""

    voxel_m: float = 0.08
    face_m: float = 0.10
    grown_m: float = 0.30
    mirror: bool = True


LIDARSIM = SurfelSettings()
"""UniSim's supplementary, 2.4."""
PROXY = SurfelSettings(voxel_m=0.04, face_m=0.05, grown_m=0.30)
"""The geometry that images are warped by: UniSim's supplementary, 2.1."""


@dataclass(frozen=True, eq=False)
class SurfelSet:
    """Faces of one thing, in its own axes: vertices (3 F, 3), those of face f from 3 f on; normals (F, 3), unit, on the side that
    was seen; intensity (F,) in 0..1; colours (F, 3, 3) sRGB of the corners; seen (F,) whether a return is behind the face, and
    painted (F,) whether an image is behind its colours. ``boxes`` are the hierarchy's, where it is known."""

    vertices: NDArray[np.float32]
    normals: NDArray[np.float32]
    intensity: NDArray[np.float32]
    colours: NDArray[np.uint8]
    seen: BoolArray
    painted: BoolArray
    boxes: tuple[NDArray[Any], NDArray[np.int32]] | None = None

    def __len__(self) -> int:
        return len(self.normals)

    @cached_property
    def triangles(self) -> Triangles:
        """The faces, ready to be met."""
        return Triangles(self.vertices, np.arange(3 * len(self), dtype=np.int32).reshape(-1, 3), self.boxes)

    @cached_property
    def centres(self) -> FloatArray:
        """Middles of the faces (F, 3)."""
        return self.vertices.reshape(-1, 3, 3).mean(1, dtype=np.float64)

    def of(self, faces: BoolArray) -> SurfelSet:
        """Those faces (F,) alone."""
        own = {f.name: getattr(self, f.name)[faces] for f in fields(self) if f.name not in ("vertices", "boxes")}
        return SurfelSet(self.vertices.reshape(-1, 3, 3)[faces].reshape(-1, 3), **own)

    def without(self, faces: BoolArray) -> SurfelSet:
        """The same less those faces (F,), which shrink to points: the hierarchy still holds."""
        if not faces.any():
            return self
        vertices = self.vertices.reshape(-1, 3, 3).copy()
        vertices[faces] = vertices[faces][:, :1]
        return replace(self, vertices=vertices.reshape(-1, 3), boxes=self.triangles.boxes)


@dataclass(frozen=True, eq=False)
class SurfelScene:
    """All of a log's surfels: what stands still, in the world, and each actor's in its box. ``ground`` is the ground's height;
    ``dome`` (rows, columns, 3) uint8 sRGB is what cameras saw where no surfel is, by direction, and ``dome_seen`` (rows, columns)
    where they did; ``drops`` say how likely a beam returns; ``outlines`` are those of the recording vehicle in its images, by
    camera. Colours are as if all images were exposed alike; ``exposures`` say how they were."""

    settings: SurfelSettings
    static: SurfelSet
    actors: dict[str, SurfelSet]
    ground: HeightGrid
    dome: NDArray[np.uint8]
    dome_seen: BoolArray
    drops: DropTable
    outlines: dict[str, tuple[Outline, int]] = field(default_factory=dict)
    exposures: Exposures = field(default_factory=Exposures)

    @cached_property
    def upright(self) -> BoolArray:
        """Which faces of what stands still (F,) are above the ground."""
        centres = self.static.centres
        return np.asarray(centres[:, 2] - self.ground.at(centres) > CLEARANCE_M)


def make_faces(
    points: FloatArray, normals: NDArray[np.float32], radius_m: FloatArray, intensity: FloatArray, seen: BoolArray | None = None
) -> SurfelSet:
    """Triangles about points (N, 3) across their normals (N, 3), corners ``radius_m`` (N,) from the middle; grey, not painted."""
    n = len(points)
    up = np.where(np.abs(normals[:, 2:]) < 0.9, np.array([0.0, 0, 1]), np.array([1.0, 0, 0]))
    across = np.cross(up, normals)
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-12)
    along = np.cross(normals, across)
    # each turned by another angle, so that gaps and overlaps form no pattern
    angle = (np.arange(n) * GOLDEN)[:, None] + 2 * np.pi * np.arange(3) / 3
    corners = np.cos(angle)[..., None] * across[:, None] + np.sin(angle)[..., None] * along[:, None]
    vertices = points[:, None] + corners * radius_m[:, None, None]
    return SurfelSet(
        vertices=vertices.reshape(-1, 3).astype(np.float32),
        normals=normals.astype(np.float32),
        intensity=intensity.astype(np.float32),
        colours=np.full((n, 3, 3), 128, np.uint8),
        seen=np.ones(n, bool) if seen is None else seen,
        painted=np.zeros(n, bool),
    )


def joined(sets: Sequence[SurfelSet]) -> SurfelSet:
    """Several sets as one."""
    names = [f.name for f in fields(SurfelSet) if f.name != "boxes"]
    parts: dict[str, Any] = {name: np.concatenate([getattr(one, name) for one in sets]) for name in names}
    return SurfelSet(**parts)


def save_surfels(scene: SurfelScene, folder: Path) -> None:
    """Write a scene's arrays and what belongs to them into a folder, one file each, so that processes can share them mapped."""
    folder.mkdir(parents=True, exist_ok=True)
    everyone = joined([scene.static.of(np.zeros(len(scene.static), bool)), *scene.actors.values()])
    for name, faces in (("static", scene.static), ("actors", everyone)):
        for member in fields(SurfelSet):
            if member.name != "boxes":
                np.save(folder / f"{name}_{member.name}.npy", getattr(faces, member.name))
    boxes = scene.static.triangles.boxes
    if boxes is not None:
        np.save(folder / "static_nodes.npy", boxes[0])
        np.save(folder / "static_order.npy", boxes[1])
    for name, array in (
        ("ground", scene.ground.heights),
        ("known", scene.ground.known),
        ("dome", scene.dome),
        ("dome_seen", scene.dome_seen),
    ):
        np.save(folder / f"{name}.npy", array)
    for table in ("returns", "beams"):
        np.save(folder / f"drops_{table}.npy", getattr(scene.drops, table))
    about = {
        "version": FORMAT_VERSION,
        "settings": asdict(scene.settings),
        "ground_low": scene.ground.low.tolist(),
        "actors": {uid: len(one) for uid, one in scene.actors.items()},
        "own_vehicle": outlines_to_json(scene.outlines),
        "exposures": scene.exposures.to_json(),
    }
    (folder / META_NAME).write_text(json.dumps(about))


def load_surfels(folder: Path) -> SurfelScene:
    """What `save_surfels` wrote, mapped from disk. Raises OSError, ValueError or KeyError where it is not whole."""
    about = json.loads((folder / META_NAME).read_bytes())
    if about["version"] != FORMAT_VERSION:
        raise ValueError(f"{folder}: is of version {about['version']}")

    def array(name: str) -> NDArray[Any]:
        path = folder / f"{name}.npy"
        return np.load(path, mmap_mode="r" if path.stat().st_size > 1 << 20 else None, allow_pickle=False)

    names = [member.name for member in fields(SurfelSet) if member.name != "boxes"]
    parts: dict[str, Any] = {name: array(f"static_{name}") for name in names}
    static = _whole(SurfelSet(**parts))
    if (folder / "static_nodes.npy").exists():
        boxes = array("static_nodes"), array("static_order")
        check_boxes(*boxes, len(static))
        static = replace(static, boxes=boxes)
    everyone, actors, first = {name: array(f"actors_{name}") for name in names}, {}, 0
    for uid, count in about["actors"].items():
        own = {name: values[(3 if name == "vertices" else 1) * first :] for name, values in everyone.items()}
        parts = {name: values[: (3 if name == "vertices" else 1) * count] for name, values in own.items()}
        actors[uid] = _whole(SurfelSet(**parts), count)
        first += count
    ground = HeightGrid(_numbers(about["ground_low"], (2,)), array("ground"), array("known"))
    dome, dome_seen = array("dome"), array("dome_seen")
    drops = DropTable(array("drops_returns"), array("drops_beams"))
    _require(ground.heights, (*ground.heights.shape[:2],), np.float32, 1)
    _require(ground.known, ground.heights.shape, np.bool_)
    _require(dome, (*dome.shape[:2], 3), np.uint8, 1)
    _require(dome_seen, dome.shape[:2], np.bool_)
    for table in (drops.returns, drops.beams):
        _require(table, DropTable.empty().beams.shape, np.float64)
    return SurfelScene(
        settings=SurfelSettings(**about["settings"]),
        static=static,
        actors=actors,
        ground=ground,
        dome=dome,
        dome_seen=dome_seen,
        drops=drops,
        outlines=outlines_from_json(about["own_vehicle"]),
        exposures=Exposures.from_json(about["exposures"]),
    )


def _require(array: NDArray[Any], shape: tuple[int, ...], dtype: Any, at_least: int = 0) -> None:
    """Raise ValueError unless an array has a shape, of no edge below ``at_least``, a dtype, and finite numbers."""
    if array.shape != shape or array.dtype != dtype or min(shape, default=at_least) < at_least:
        raise ValueError(f"has an array of shape {array.shape} and type {array.dtype}")
    if array.dtype.kind == "f" and not np.isfinite(array).all():
        raise ValueError("holds a number that is not finite")


def _whole(faces: SurfelSet, count: int | None = None) -> SurfelSet:
    """The set, whose arrays fit together. Raises ValueError."""
    n = len(faces) if count is None else count
    _require(faces.vertices, (3 * n, 3), np.float32)
    _require(faces.normals, (n, 3), np.float32)
    _require(faces.intensity, (n,), np.float32)
    _require(faces.colours, (n, 3, 3), np.uint8)
    _require(faces.seen, (n,), np.bool_)
    _require(faces.painted, (n,), np.bool_)
    return faces


def _numbers(value: Any, shape: tuple[int, ...]) -> FloatArray:
    """A list of finite numbers as an array. Raises ValueError."""
    array = np.array(value, np.float64)
    _require(array, shape, np.float64)
    return array
