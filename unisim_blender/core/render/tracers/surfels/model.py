"""Surfels: small faces at LiDAR returns, with the measured intensity and the colours that cameras saw, and the
probability that a beam returns, counted from the recorded beams.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....data.exposures import Exposures
from ....data.own_vehicle import Outline, check_outlines, outlines_from_json, outlines_to_json
from ....errors import SceneError, in_a_line
from ....files import BROKEN_ARRAYS
from ....geometry import BoolArray, FloatArray
from ....json_file import Node, read_json
from ....meshes.intersect import NODE, Triangles, check_boxes
from ....ops.constants import GROUND_CLEARANCE_M
from .ground import HeightGrid

Bins = NDArray[np.int64]

RANGE_EDGES_M = np.array([5.0, 10, 20, 30, 45, 60, 80, 100, 130, 160])
COSINE_EDGES = np.array([0.05, 0.1, 0.2, 0.4, 0.7])
INTENSITY_EDGES = np.array([0.01, 0.02, 0.04, 0.08, 0.16, 0.4])
PRIOR_BEAMS = 20.0
"""Weight of the prior, in beams: each bin has so many that return as all do on average."""


@dataclass(frozen=True, eq=False)
class DropTable:
    """Numbers of recorded beams that hit a surface and of those that returned: ``beams`` and ``returns`` (ranges,
    cosines, intensities), by bins of range, cosine of incidence and intensity."""

    returns: FloatArray
    beams: FloatArray

    @staticmethod
    def empty() -> DropTable:
        """Return the table without beams: every beam that hits something returns."""
        shape = tuple(len(edges) + 1 for edges in (RANGE_EDGES_M, COSINE_EDGES, INTENSITY_EDGES))
        return DropTable(np.zeros(shape), np.zeros(shape))

    def counted(self, depth_m: FloatArray, cosine: FloatArray, intensity: FloatArray, returned: BoolArray) -> DropTable:
        """Return the table with more beams: depths, metres, cosines of incidence, intensities in 0..1, returned; (N,)
        each."""
        assert depth_m.shape == cosine.shape == intensity.shape == returned.shape, (depth_m.shape, returned.shape)
        bins, shape = _bins(depth_m, cosine, intensity), self.beams.shape
        size = int(np.prod(shape))
        flat = np.ravel_multi_index(bins, shape)
        returns = np.bincount(flat, returned.astype(np.float64), size).reshape(shape)
        return DropTable(self.returns + returns, self.beams + np.bincount(flat, minlength=size).reshape(shape))

    def probability(self, depth_m: FloatArray, cosine: FloatArray, intensity: FloatArray) -> FloatArray:
        """Return the probabilities (N,) that beams return which hit a surface at depths, metres, cosines of incidence
        and intensities in 0..1, (N,) each."""
        average = (self.returns.sum() + 1) / (self.beams.sum() + 1)
        share = (self.returns + PRIOR_BEAMS * average) / (self.beams + PRIOR_BEAMS)
        return np.asarray(share[_bins(depth_m, cosine, intensity)])


def _bins(depth_m: FloatArray, cosine: FloatArray, intensity: FloatArray) -> tuple[Bins, Bins, Bins]:
    bins = (
        np.searchsorted(edges, x)
        for edges, x in ((RANGE_EDGES_M, depth_m), (COSINE_EDGES, cosine), (INTENSITY_EDGES, intensity))
    )
    a, b, c = bins
    return a, b, c


FORMAT_VERSION = 4
META_NAME = "surfels.json"
GOLDEN_ANGLE_RAD = np.pi * (3 - np.sqrt(5))


@dataclass(frozen=True)
class SurfelSettings:
    """Settings of surfels: one in a cube of ``voxel_m``, a triangle with its corners ``face_m`` from its middle; where
    returns lie farther apart it grows with their distance, up to ``face_max_m``. ``mirror`` gives vehicles the faces of
    their other side where nothing was seen of this one."""

    voxel_m: float = 0.08
    face_m: float = 0.10
    face_max_m: float = 0.30
    mirror: bool = True


LIDARSIM = SurfelSettings()
"""UniSim's supplementary, 2.4."""
PROXY = SurfelSettings(voxel_m=0.04, face_m=0.05, face_max_m=0.30)
"""The geometry that images are warped by: UniSim's supplementary, 2.1."""


@dataclass(frozen=True, eq=False)
class SurfelSet:
    """Faces of one object, in its own axes, metres: vertices (3 F, 3), those of face f from 3 f on; normals (F, 3),
    unit, on the side that was seen; intensity (F,) in 0..1; colours (F, 3, 3) sRGB of the corners; seen (F,) whether
    the face is at a return, and painted (F,) whether its colours are from an image. ``boxes`` are the hierarchy's,
    where it is known."""

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
        """The faces with their hierarchy of boxes for rays."""
        return Triangles(self.vertices, np.arange(3 * len(self), dtype=np.int32).reshape(-1, 3), self.boxes)

    @cached_property
    def centres(self) -> FloatArray:
        """Middles of the faces (F, 3)."""
        return self.vertices.reshape(-1, 3, 3).mean(1, dtype=np.float64)

    def of(self, faces: BoolArray) -> SurfelSet:
        """Return the faces of a mask (F,)."""
        own = {f.name: getattr(self, f.name)[faces] for f in fields(self) if f.name not in ("vertices", "boxes")}
        return SurfelSet(self.vertices.reshape(-1, 3, 3)[faces].reshape(-1, 3), **own)

    def without(self, faces: BoolArray) -> SurfelSet:
        """Return the set without the faces of a mask (F,), which shrink to points, so that the hierarchy stays
        valid."""
        if not faces.any():
            return self
        vertices = self.vertices.reshape(-1, 3, 3).copy()
        vertices[faces] = vertices[faces][:, :1]
        return replace(self, vertices=vertices.reshape(-1, 3), boxes=self.triangles.boxes)


@dataclass(frozen=True, eq=False)
class SurfelScene:
    """All of a log's surfels: what stands still, in the world, and each actor's in its box. ``ground`` is the ground's
    height; ``dome`` (rows, columns, 3) uint8 sRGB is what cameras saw where no surfel is, by direction, and
    ``dome_seen`` (rows, columns) where they did; ``drops`` say how likely a beam returns; ``outlines`` are those of the
    recording vehicle in its images, by camera. Colours are as if all images were exposed alike; ``exposures``
    say how they were."""

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
        """Whether each static face (F,) is above the ground."""
        centres = self.static.centres
        return np.asarray(centres[:, 2] - self.ground.at(centres) > GROUND_CLEARANCE_M)


def make_faces(
    points: FloatArray,
    normals: NDArray[np.float32],
    radius_m: FloatArray,
    intensity: FloatArray,
    seen: BoolArray | None = None,
) -> SurfelSet:
    """Return triangles around points (N, 3), metres, across their unit normals (N, 3), with corners ``radius_m`` (N,)
    from the middle and ``intensity`` (N,); grey, not painted."""
    shapes = points.shape, normals.shape, radius_m.shape, intensity.shape
    n = len(points)
    assert shapes == ((n, 3), (n, 3), (n,), (n,)), shapes
    up = np.where(np.abs(normals[:, 2:]) < 0.9, np.array([0.0, 0, 1]), np.array([1.0, 0, 0]))
    across = np.cross(up, normals)
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-12)
    along = np.cross(normals, across)
    # each turned by another angle, so that gaps and overlaps form no pattern
    angle = (np.arange(n) * GOLDEN_ANGLE_RAD)[:, None] + 2 * np.pi * np.arange(3) / 3
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
    """Return several sets as one."""
    names = [f.name for f in fields(SurfelSet) if f.name != "boxes"]
    parts: dict[str, Any] = {name: np.concatenate([getattr(surfels, name) for surfels in sets]) for name in names}
    return SurfelSet(**parts)


def save_surfels(scene: SurfelScene, folder: Path) -> None:
    """Write a scene's arrays and settings into a folder, one file each, so that processes can share them mapped."""
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
        "actors": {uid: len(surfels) for uid, surfels in scene.actors.items()},
        "own_vehicle": outlines_to_json(scene.outlines),
        "exposures": scene.exposures.to_json(),
    }
    (folder / META_NAME).write_text(json.dumps(about))


def load_surfels(folder: Path) -> SurfelScene:
    """Return the scene that `save_surfels` wrote, memory-mapped from disk. Raises `SceneError` where it is not whole:
    kernels follow its indices unchecked."""
    file = folder / META_NAME
    about = Node(read_json(file, SceneError), f"{file}: ", SceneError)
    if about.key("version").integer() != FORMAT_VERSION:
        about.key("version").fail(f"must be {FORMAT_VERSION}")

    def array(name: str, dtype: Any, *shape: int) -> NDArray[Any]:
        return _mapped(folder / f"{name}.npy", dtype, shape)

    def faces(name: str) -> dict[str, Any]:
        vertices = array(f"{name}_vertices", np.float32, -1, 3)
        n = len(vertices) // 3
        return {
            "vertices": vertices, "normals": array(f"{name}_normals", np.float32, n, 3),
            "intensity": array(f"{name}_intensity", np.float32, n),
            "colours": array(f"{name}_colours", np.uint8, n, 3, 3),
            "seen": array(f"{name}_seen", np.bool_, n), "painted": array(f"{name}_painted", np.bool_, n),
        }  # fmt: skip

    static = SurfelSet(**faces("static"))
    if (folder / "static_nodes.npy").exists():
        boxes = array("static_nodes", NODE, -1), array("static_order", np.int32, len(static))
        try:
            check_boxes(*boxes, len(static))
        except ValueError as fault:
            raise SceneError(f"{folder / 'static_nodes.npy'}: {fault}") from fault
        static = replace(static, boxes=boxes)
    everyone, actors, first = faces("actors"), {}, 0
    for uid, node in about.key("actors").members():
        last = first + node.integer(at_least=0)
        if 3 * last > len(everyone["vertices"]):
            node.fail(f"has more faces than there are: {len(everyone['normals'])}")
        actors[uid] = SurfelSet(
            **{n: v[3 * first : 3 * last] if n == "vertices" else v[first:last] for n, v in everyone.items()}
        )
        first = last
    heights, dome = array("ground", np.float32, -1, -1), array("dome", np.uint8, -1, -1, 3)
    if not heights.size or not dome.size:
        raise SceneError(f"{folder}: has no ground or no dome")
    table = DropTable.empty().beams.shape
    return SurfelScene(
        settings=_settings(about.key("settings")),
        static=static,
        actors=actors,
        ground=HeightGrid(about.key("ground_low").array(2), heights, array("known", np.bool_, *heights.shape)),
        dome=dome,
        dome_seen=array("dome_seen", np.bool_, *dome.shape[:2]),
        drops=DropTable(array("drops_returns", np.float64, *table), array("drops_beams", np.float64, *table)),
        outlines=outlines_from_json(check_outlines(about.key("own_vehicle"))),
        exposures=Exposures.from_json(about.key("exposures")),
    )


def _mapped(path: Path, dtype: Any, shape: tuple[int, ...]) -> NDArray[Any]:
    """Return the array of a file, mapped where it is large; -1 stands for any edge. Raises `SceneError`."""
    try:
        array = np.load(path, mmap_mode="r" if path.stat().st_size > 1 << 20 else None, allow_pickle=False)
    except BROKEN_ARRAYS as fault:
        raise SceneError(f"{path}: is no array: {in_a_line(fault)}") from fault
    fits = isinstance(array, np.ndarray) and array.ndim == len(shape) and array.dtype == dtype
    if not fits or any(n not in (-1, m) for n, m in zip(shape, array.shape, strict=True)):
        raise SceneError(f"{path}: is no array of {np.dtype(dtype)} of the shape {shape}")
    return np.asarray(array) if array.flags.c_contiguous else np.ascontiguousarray(array)


def _settings(node: Node) -> SurfelSettings:
    voxel_m, face_m, face_max_m = (node.key(name).number() for name in ("voxel_m", "face_m", "face_max_m"))
    return SurfelSettings(voxel_m, face_m, face_max_m, node.key("mirror").flag())
