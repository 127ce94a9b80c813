"""Images, sweeps and rays on an NVIDIA GPU, one thread a ray, by CUDA's driver alone: the compiled tracer with its scenes, rays
and results in the GPU's memory.

`native/cuda/trace_ray.h` is what a thread does for a ray, `image.h` and `sweep.h` there what it does for a pixel and a
beam. An image whose pixels depend on their own rays alone is finished on the GPU, and so are sweeps; other images are
decoded by the CPU's kernels. CPU and GPU place the same samples; sums differ by rounding.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....cuda_driver import BLOCK, Gpu, GpuMemory, GpuMemoryError
from ....errors import UnisimError
from ....meshes.hits import MeshHits
from ....native import BlockToleranceStruct, HeadStruct, LayerStruct, MlpStruct, PlaneStruct, SceneStruct
from ....sensors.camera import camera_rays, line_times, pixel_directions, pixel_grid
from ....sensors.frames import RenderStats
from ....sensors.lidar import column_azimuths, column_times, lidar_rays
from ....sensors.rays import MAX_DISTANCE_M, Rays, exposure_window
from ....sensors.unprojection import least_pixels_per_rad
from ....world.drive import Camera, CameraModel, Lidar, RollingShutter
from ....world.replay import WorldState
from ...lattice import MAP_KINDS, block_tolerance
from ...quality import QUALITIES, Quality
from ...tracer import Array, Maps, TraceResult, tiled
from .scene import CompiledScene
from .structs import (
    ActiveActorsStruct,
    ActorSetStruct,
    MeshHitsStruct,
    RaysStruct,
    SamplingStruct,
    TraceResultStruct,
    doubles,
)
from .tracer import CompiledBackend, CompiledTracer, MeshHitArrays

THREADS = 1 << 16
"""Threads at most that trace rays: each has room of its own for a ray's samples and segments."""
PIXEL_THREADS = 1 << 18
"""Threads at most of a launch that traces no rays."""
MAX_WIDTH = 128
"""Largest width of a decoder's layer in native/cuda/field.h."""
LAUNCHES = 64
"""Number of times that an image's pixels can be traced."""
GRID_PX = 32
"""Distance of the pixels by whose rays actors are culled."""
SPARSE_BEAMS, SPARSE_COLUMNS = 8, 64
"""Numbers of a sweep's beams and columns by whose rays actors are culled."""
MAX_LENS_TABLES = 8
"""Largest number of cameras whose lenses' directions stay on the GPU."""
SAMPLES, SEGMENTS = 192, 24
"""Room of a thread; rays that find too little are traced again with twice as much."""
SEGMENT_BYTES = 104
"""Size of a `Segment` in native/cuda/trace_ray.h."""


class TraceInputsStruct(ctypes.Structure):
    """`TraceInputs` in native/cuda/trace_ray.h."""

    _fields_ = [
        ("scene", SceneStruct),
        ("active", ActiveActorsStruct),
        ("rays", RaysStruct),
        ("meshes", MeshHitsStruct),
        ("sampling", SamplingStruct),
        ("result", TraceResultStruct),
    ]


class LaunchMemoryStruct(ctypes.Structure):
    """`LaunchMemory` in native/cuda/kernels.cu."""

    _fields_ = [
        ("samples", ctypes.c_void_p),
        ("segments", ctypes.c_void_p),
        ("threads", ctypes.c_int32),
        ("capacity", ctypes.c_int32),
        ("segment_capacity", ctypes.c_int32),
    ]


class ImageInputsStruct(ctypes.Structure):
    """`ImageInputs` in native/cuda/image.h."""

    _fields_ = [
        *((name, ctypes.c_int32) for name in ("height", "width", "top", "left", "up")),
        *((name, ctypes.c_int32) for name in ("lens_width", "reads_columns")),
        *((name, ctypes.c_double) for name in ("fx", "fy", "cx", "cy")),
        *((name, ctypes.c_void_p) for name in ("lens", "poses", "line_times")),
        ("axis", ctypes.c_double * 3),
        *((name, ctypes.c_void_p) for name in ("origins", "directions", "times")),
        ("head", HeadStruct),
        ("convolutions", ctypes.c_void_p),
        ("convolution_count", ctypes.c_int32),
        ("size", ctypes.c_int32),
        ("planes", ctypes.c_void_p),
        ("plane_count", ctypes.c_int32),
        ("deciding_count", ctypes.c_int32),
        ("tolerance", BlockToleranceStruct),
        *((name, ctypes.c_void_p) for name in ("observed", "rgb", "along", "unsupported", "wanted", "known")),
        *((name, ctypes.c_void_p) for name in ("blocks", "order", "counts")),
    ]


class SweepInputsStruct(ctypes.Structure):
    """`SweepInputs` in native/cuda/sweep.h."""

    _fields_ = [
        *((name, ctypes.c_int32) for name in ("beams", "columns", "keys")),
        *((name, ctypes.c_void_p) for name in ("elevation", "azimuth_offset", "delay", "azimuth", "time")),
        *((name, ctypes.c_void_p) for name in ("key_times", "positions", "quaternions")),
        *((name, ctypes.c_void_p) for name in ("origins", "directions", "times")),
    ]


class Uploaded:
    """Structures of the kernels copied to a GPU with the arrays that they point to."""

    def __init__(self, memory: GpuMemory, arrays: Iterable[NDArray[Any]]) -> None:
        self.memory = memory
        # an empty array may lie where another one begins
        self._arrays = {array.ctypes.data: array for array in sorted(arrays, key=lambda array: array.size)}
        self._addresses: dict[int, int] = {}

    def at(self, host: int | None) -> int | None:
        """Return the GPU's address of a copy of the array at an address; None for None."""
        if not host:
            return None
        if host not in self._addresses:
            self._addresses[host] = self.memory.upload(self._arrays[host])
        return self._addresses[host]

    def moved(self, struct: Any, *leave: str) -> Any:
        """Return a copy of a structure whose pointers, but for those to leave away, are the GPU's."""
        copy = type(struct).from_buffer_copy(struct)
        for name, kind in struct._fields_:
            if kind is ctypes.c_void_p:
                setattr(copy, name, None if name in leave else self.at(getattr(struct, name)))
        return copy


class GpuScene:
    """A compiled scene in a GPU's memory, whole, and with only the voxels that the recording shows."""

    def __init__(self, scene: CompiledScene, gpu: Gpu) -> None:
        self.scene, self.gpu, self.memory = scene, gpu, GpuMemory(gpu)
        self._structs: dict[bool, tuple[SceneStruct, int]] = {}
        self._networks: dict[int, tuple[HeadStruct, int, int]] = {}
        self._lenses: dict[CameraModel, tuple[GpuMemory, int]] = {}
        self._orders: dict[tuple[int, int], int] = {}
        self.room = 1
        """How many times the usual room a thread needs for a ray."""

    def struct(self, clipped: bool = False) -> tuple[SceneStruct, int]:
        """Return the scene's structure with the GPU's pointers, and the address of a copy of it there."""
        if clipped not in self._structs:
            source = self.scene.observed_struct if clipped else self.scene.struct
            head, arrays = self.scene.decoder.sample_arrays
            uploaded = Uploaded(self.memory, [*self.scene.arrays, *arrays])
            copy = uploaded.moved(source, "sample_head")
            for name in ("static_field", "background", "actor_fields"):
                field = uploaded.moved(getattr(source, name))
                field.grid, field.net = uploaded.moved(field.grid), uploaded.moved(field.net)
                setattr(copy, name, field)
            if source.light:
                light = uploaded.moved(source.light.contents)
                copy.light = ctypes.cast(self.memory.upload(light), ctypes.POINTER(MlpStruct))
            if head is not None:
                copy.sample_head = self.memory.upload(self._moved_head(head, uploaded))
            self._structs[clipped] = copy, self.memory.upload(copy)
        return self._structs[clipped]

    def network(self, camera_id: str) -> tuple[HeadStruct, int, int]:
        """Return a camera's head with the GPU's pointers, the address of the convolutions there, and their number."""
        code = self.scene.camera_code(camera_id)
        if code not in self._networks:
            head, layers, referenced = self.scene.decoder.network(code)
            uploaded = Uploaded(self.memory, [array for array in referenced if isinstance(array, np.ndarray)])
            self._networks[code] = self._moved_head(head, uploaded), self._layers(layers, uploaded), len(layers)
        return self._networks[code]

    @cached_property
    def lidar_head(self) -> HeadStruct | None:
        """The head of a LiDAR's beams with the GPU's pointers; None where a thread has no room for its layers."""
        head, arrays = self.scene.decoder.lidar_network
        if _widest((LayerStruct * head.count).from_address(head.layers)) > MAX_WIDTH:
            return None
        return self._moved_head(head, Uploaded(self.memory, arrays))

    @cached_property
    def decodes(self) -> bool:
        """Whether the GPU decodes its images: cells by their own features, by layers that a thread has room for."""
        scene = self.scene
        head, layers, _referenced = scene.decoder.network(-1)
        widest = _widest([*(LayerStruct * head.count).from_address(head.layers), *layers])
        return scene.decoder.reach == 0 and widest <= MAX_WIDTH

    @cached_property
    def observed(self) -> int:
        """The address of the voxels that the recording shows."""
        return self.memory.upload(np.ascontiguousarray(self.scene.observed))

    def lens(self, model: CameraModel) -> int | None:
        """Return the address of the directions of a camera's pixels; None for a pinhole, whose are computed."""
        if model.is_pinhole:
            return None
        key = replace(model, shutter=RollingShutter())
        if key not in self._lenses:
            memory = GpuMemory(self.gpu)
            self._lenses[key] = (
                memory,
                memory.upload(doubles(pixel_directions(model, *pixel_grid(model, self.scene.config.upsample)))),
            )
            if len(self._lenses) > MAX_LENS_TABLES:
                del self._lenses[next(iter(self._lenses))]
        return self._lenses[key][1]

    def order(self, shape: tuple[int, int]) -> int:
        """Return the address of the order in which a sweep's rays (beams, columns) are traced."""
        if shape not in self._orders:
            self._orders[shape] = self.memory.upload(tiled(shape))
        return self._orders[shape]

    def _moved_head(self, head: HeadStruct, uploaded: Uploaded) -> HeadStruct:
        of = (LayerStruct * head.count).from_address(head.layers)
        return HeadStruct(head.features, head.extra_inputs, head.count, self._layers(of, uploaded))

    def _layers(self, layers: ctypes.Array[LayerStruct], uploaded: Uploaded) -> int:
        return self.memory.upload((LayerStruct * len(layers))(*map(uploaded.moved, layers)))


def _widest(layers: Iterable[LayerStruct]) -> int:
    return max(max(layer.inputs, layer.outputs) for layer in layers)


class GpuBackend(CompiledBackend):
    """Trained scenes on a GPU: a `tracer.Backend`."""

    launches = True
    """Whether a frame can be begun before the one before it is waited for (`GpuTracer.lattice_image`, `sweep`)."""

    def __init__(
        self,
        scene: GpuScene,
        quality: Quality = QUALITIES["balanced"],
        others: Mapping[str, GpuScene] | None = None,
    ) -> None:
        self.gpu_scenes = {"": scene, **(others or {})}
        super().__init__(scene.scene, quality, {name: other.scene for name, other in (others or {}).items()})

    def bind(self, state: WorldState) -> CompiledTracer:
        return GpuTracer(self, state)


class GpuTracer(CompiledTracer):
    """A `tracer.Tracer`: a backend's scenes in a state of the world, traced on its GPU."""

    def __init__(self, backend: GpuBackend, state: WorldState) -> None:
        super().__init__(backend, state)
        self._scenes = [backend.gpu_scenes[name] for name in ("", *self.active.foreign)]
        self._gpu = self._scenes[0].gpu

    def _run(
        self,
        rays: Rays,
        order: NDArray[np.int64],
        some: Rays,
        sky: bool,
        mesh_hits: MeshHits | None,
        traced: TraceResult[Array],
        maps: Maps,
        stats: RenderStats,
        starts: Array | None = None,
    ) -> None:
        n = len(order)
        if not n:
            return
        self._gpu.enter()
        head = None if sky or self._foreign else self._scenes[0].lidar_head
        if head is not None and traced.returned is None:
            traced.feature = traced.feature[:0]
            traced.returned = np.empty_like(traced.depth_m), np.empty_like(traced.depth_m)
        outputs: dict[str, list[Array]] = {
            "feature": [traced.feature] if head is None else [],
            "depth": [traced.depth_m],
            "opacity": [traced.opacity],
            **{name: [maps[key]] for name, key in RESULTS.items() if key in maps},
            "foreign_feature": traced.foreign_features,
            "foreign_opacity": traced.foreign_opacity,
        }
        if traced.without_foreign is not None:
            outputs["feature_without_foreign"] = [traced.without_foreign]
        if traced.mesh_opacity is not None:
            outputs["mesh_opacity"] = [traced.mesh_opacity]
        with GpuMemory(self._gpu, reuse=True) as memory:
            active, skipped = self._active(memory, some)
            at = {name: [memory.allocate(n * array[:1].nbytes) for array in arrays] for name, arrays in outputs.items()}
            if head is not None:
                at["feature"] = [memory.allocate(4 * n * head.features)]
            samples = memory.allocate(8, clear=True)
            lists = {
                name: memory.upload((ctypes.c_void_p * len(at[name]))(*at[name])) if at[name] else None
                for name in ("foreign_feature", "foreign_opacity")
            }
            single = {name: places[0] for name, places in at.items() if name not in lists}
            inputs = TraceInputsStruct(
                self._scenes[0].struct(self.clipped)[0],
                active,
                RaysStruct(
                    n,
                    *map(memory.upload, map(doubles, (some.origins, some.directions, some.time_s))),
                    None,
                    None if starts is None else memory.upload(np.ascontiguousarray(starts[order])),
                ),
                self._meshes(memory, mesh_hits, order, len(rays.time_s)),
                self._sampling(sky),
                TraceResultStruct(samples=samples, **single, **lists),
            )
            launch(memory, inputs, n)
            if head is not None and traced.returned is not None:
                at["returned"] = [memory.allocate(4 * n) for _ in traced.returned]
                outputs["returned"] = list(traced.returned)
                decode_beams(self._gpu, inputs, head, n, *at["returned"])
            for name, arrays in outputs.items():
                for place, array in zip(at[name] if arrays else (), arrays, strict=True):
                    part = np.empty((n, *array.shape[1:]), array.dtype)
                    memory.download(place, part)
                    array[order] = part
            spent = np.zeros(1, np.int64)
            memory.download(samples, spent)
        stats.rays += n
        stats.actors_skipped += skipped
        stats.samples_spent += int(spent[0])
        stats.samples_saved += max(0, self._uniform(some) - int(spent[0]))

    def lattice_image(
        self,
        camera: Camera,
        time_s: float,
        cells: tuple[slice, slice],
        size: int,
        spread: float,
        passes: set[str],
        undeciding: set[str],
    ) -> Callable[[RenderStats], Maps | None] | None:
        """Launch the rows and columns ``cells`` of an image, traced from a lattice of ``size`` with ``spread`` as in
        `lattice.progressive_strides`, which does not look at the passes ``undeciding``; None where the GPU cannot finish the
        image. The function that is returned waits: colours, passes, and what depths are multiplied by along the optical
        axis, "along", (h w, ...), or None where memory did not suffice. Where a cell is several pixels, its colours are
        theirs: (h w, up up 3), as they lie in the image of (h up, w up).
        """
        if self.space is not None or self._foreign or not self._scenes[0].decodes:
            return None
        return self._begun(lambda: LatticeImage(self, camera, time_s, cells, size, spread, passes, undeciding))

    def sweep(self, lidar: Lidar, time_s: float) -> Callable[[RenderStats], Maps | None] | None:
        """Launch the sweep at ``time_s``; None where the GPU cannot finish it. The function that is returned waits: the
        rays' "origins", "directions" and "times", and "depth", 0 where a beam hits nothing, "instance", "intensity" and
        "probability" of a return, (beams, columns, ...), or None where memory did not suffice."""
        if self.space is not None or self._foreign or self._scenes[0].lidar_head is None:
            return None
        return self._begun(lambda: LaunchedSweep(self, lidar, time_s))

    def _begun(self, launched: Callable[[], Launched]) -> Callable[[RenderStats], Maps | None] | None:
        """Return what waits for launches, and repeats them where a thread's room did not suffice."""
        self._gpu.enter()

        def finish(stats: RenderStats) -> Maps | None:
            self._gpu.enter()
            with suppress(GpuMemoryError):
                frame = frames.pop()
                while (maps := frame.result(stats)) is None:
                    self._scenes[0].room = max(self._scenes[0].room, 2 * frame.room)
                    frame = launched()
                return maps
            return None

        with suppress(GpuMemoryError):
            frames = [launched()]
            return finish if frames[0].sound else None
        return None

    def _active(self, memory: GpuMemory, rays: Rays, slack_rad: float = 0.0) -> tuple[ActiveActorsStruct, int]:
        """Return the active actors that these rays can hit, on the GPU, and the number of the others."""
        actors = self._compiled_actors
        struct, _referenced, skipped = actors.struct(rays, slack_rad)
        numbers = [array for array in _referenced if isinstance(array, np.ndarray)]
        uploaded = Uploaded(memory, [*actors.arrays, *numbers])
        sets = (ActorSetStruct * struct.actor_set_count)()
        for i, scene in enumerate(self._scenes):
            sets[i] = self._moved_set(uploaded, struct.actor_sets[i], scene)
        copies = None
        if struct.copies:
            copy = self._moved_set(uploaded, struct.copies.contents, self._scenes[0])
            copies = ctypes.cast(memory.upload(copy), ctypes.POINTER(ActorSetStruct))
        moved = uploaded.moved(struct)
        moved.actor_sets = ctypes.cast(memory.upload(sets), ctypes.POINTER(ActorSetStruct))
        moved.copies = copies
        return moved, skipped

    @staticmethod
    def _moved_set(uploaded: Uploaded, source: ActorSetStruct, scene: GpuScene) -> ActorSetStruct:
        moved = uploaded.moved(source)
        moved.scene = ctypes.cast(scene.struct()[1], ctypes.POINTER(SceneStruct))
        return moved

    @staticmethod
    def _meshes(memory: GpuMemory, mesh_hits: MeshHits | None, order: NDArray[np.int64], count: int) -> MeshHitsStruct:
        """Return the intersections with meshes of the rays of these numbers, of ``count`` rays, which the GPU numbers
        anew."""
        if mesh_hits is None:
            return MeshHitsStruct()
        numbers = np.full(count, -1, np.int64)
        numbers[order] = np.arange(len(order))
        ray = numbers[mesh_hits.ray]
        chosen = np.argsort(ray, kind="stable")[np.count_nonzero(ray < 0) :]
        some = MeshHits(
            ray[chosen],
            mesh_hits.t[chosen],
            mesh_hits.share[chosen],
            mesh_hits.normals[chosen],
            mesh_hits.actor[chosen],
        )
        arrays = MeshHitArrays(some)
        return Uploaded(memory, arrays.arrays).moved(arrays.struct) if len(chosen) else MeshHitsStruct()


PASSES: dict[str, tuple[str, int, type[Any]]] = {
    "depth": ("median", 1, np.float32), "instance": ("instance", 1, np.int32), "normal": ("normal", 3, np.float32),
    "opacity": ("opacity", 1, np.float32), "unsupported": ("", 1, np.bool_),
}  # fmt: skip
"""Passes of an image: names in `TraceResultStruct`, numbers a pixel, and their type."""


class Launched:
    """One frame in a GPU's memory: everything is launched at once, and only what is finished is copied, beside the launches
    of the next frame. It is launched only where its rays are ``sound``."""

    sound: bool
    _grid: Rays
    """Some of the frame's rays, by which actors are culled."""
    _skipped: int
    _inputs: TraceInputsStruct

    def __init__(self, tracer: GpuTracer) -> None:
        self._gpu, self._tracer = tracer._gpu, tracer
        self._memory, self._results = (GpuMemory(self._gpu, reuse=True) for _ in range(2))
        self._copied: ctypes.c_void_p | None = None
        self.room = tracer._scenes[0].room

    def _begin(self, rays: int, launches: int) -> None:
        """Allocate what counts samples and the rays of each launch, and a thread's room."""
        self._numbers = self._results.allocate(8 * (1 + launches), clear=True)
        self._refused = self._results.allocate(8 * (rays + 1), clear=True)
        threads = min(THREADS, -(-rays // BLOCK) * BLOCK)
        self._room = launch_memory(self._memory, threads, SAMPLES * self.room, SEGMENTS * self.room)
        self._counts = 1 + launches

    def _copy(self, maps: Maps, at: Mapping[str, int]) -> None:
        """Have the finished maps copied into these arrays from their addresses."""
        self._maps = maps
        self._found = {
            at: self._gpu.pinned((n,), np.int64) for at, n in ((self._refused, 1), (self._numbers, self._counts))
        }
        self._copied = self._gpu.copy([*((at[name], values) for name, values in maps.items()), *self._found.items()])
        self._memory.release()

    def __del__(self) -> None:
        with suppress(UnisimError):
            if self._copied is not None:
                self._gpu.wait(self._copied)

    def _launch(self, name: str, threads: int, *arguments: Any) -> None:
        self._gpu.launch(f"unisim_{name}", min(max(threads, 1), PIXEL_THREADS), arguments)

    def _trace_rays(self, count: ctypes.c_void_p) -> None:
        refused = ctypes.c_void_p(self._refused)
        self._gpu.launch("unisim_trace_rays", self._room.threads, (self._inputs, self._room, count, refused))

    def result(self, stats: RenderStats) -> Maps | None:
        """Wait, and return the finished maps; None where a thread's room did not suffice."""
        assert self._copied is not None
        self._gpu.wait(self._copied)
        self._copied = None
        self._memory.free()
        self._results.free()
        refused, (spent, *counts) = (values.tolist() for values in self._found.values())
        if refused[0]:
            return None
        traced = sum(counts) if counts else self._inputs.rays.n
        stats.rays += traced
        stats.actors_skipped += self._skipped
        stats.samples_spent += spent
        uniform = self._tracer._uniform(self._grid) * traced // len(self._grid.time_s)
        stats.samples_saved += max(0, uniform - spent)
        return self._maps


class LaunchedSweep(Launched):
    """A LiDAR's sweep."""

    def __init__(self, tracer: GpuTracer, lidar: Lidar, time_s: float) -> None:
        super().__init__(tracer)
        memory, results, scene = self._memory, self._results, tracer._scenes[0]
        head, model, window = scene.lidar_head, lidar.model_at(time_s), exposure_window(lidar, time_s)
        assert head is not None
        keys = lidar.world_from_lidar.between(*window)
        delays = np.zeros(model.beams) if model.beam_time_s is None else model.beam_time_s
        table = [
            model.elevation_rad, model.azimuth_offset_rad, delays, column_azimuths(model), column_times(lidar, time_s),
            keys.times_s, keys.positions, keys.quaternions_wxyz,
        ]  # fmt: skip
        self.sound = all(np.isfinite(values).all() for values in table)
        if not self.sound:
            return
        self._grid, slack_rad = _sparse_beams(lidar, time_s)
        self.sound = bool(np.abs(self._grid.origins).max() < MAX_DISTANCE_M)
        if not self.sound:
            return
        active, self._skipped = tracer._active(memory, self._grid, slack_rad)
        shape = model.beams, model.columns
        n = shape[0] * shape[1]
        kinds: dict[str, tuple[tuple[int, ...], type[Any]]] = {
            **{name: ((*shape, 3), np.float64) for name in ("origins", "directions")}, "times": (shape, np.float64),
            **{name: (shape, np.float32) for name in ("depth", "intensity", "probability")}, "instance": (shape, np.int32),
        }  # fmt: skip
        maps = {name: self._gpu.pinned(*kind) for name, kind in kinds.items()}
        at = {name: results.allocate(values.nbytes) for name, values in maps.items()}
        rays = [at[name] for name in ("origins", "directions", "times")]
        beams = SweepInputsStruct(*shape, len(keys.times_s), *(memory.upload(doubles(x)) for x in table), *rays)
        self._begin(n, 0)
        self._inputs = TraceInputsStruct(
            scene.struct(tracer.clipped)[0],
            active,
            RaysStruct(n, *rays, scene.order(shape)),
            MeshHitsStruct(),
            tracer._sampling(False),
            TraceResultStruct(
                memory.allocate(4 * n * head.features), memory.allocate(4 * n), memory.allocate(4 * n), at["depth"],
                at["instance"], samples=self._numbers,
            ),
        )  # fmt: skip
        self._launch("begin_sweep", n, beams)
        self._trace_rays(ctypes.c_void_p())
        decode_beams(self._gpu, self._inputs, head, n, at["intensity"], at["probability"], at["depth"])
        self._copy(maps, at)


class LatticeImage(Launched):
    """An image that is traced from a lattice."""

    def __init__(
        self,
        tracer: GpuTracer,
        camera: Camera,
        time_s: float,
        cells: tuple[slice, slice],
        size: int,
        spread: float,
        passes: set[str],
        undeciding: set[str],
    ) -> None:
        super().__init__(tracer)
        memory, results = self._memory, self._results
        (rows, columns), model, scene = cells, camera.model, tracer._scenes[0]
        self._up = up = tracer.upsample
        self._shape = shape = rows.stop - rows.start, columns.stop - columns.start
        self._pixels = n = shape[0] * shape[1]
        by_columns = model.shutter.axis == "columns"
        lines = columns if by_columns else rows
        moments = np.broadcast_to(
            line_times(camera, time_s, (np.arange(lines.start, lines.stop) + 0.5) * up), lines.stop - lines.start
        )
        poses = camera.world_from_camera.at(moments)[:, :3]
        self.sound = bool(np.isfinite(poses).all() and np.abs(poses[:, :, 3]).max() < MAX_DISTANCE_M)
        if not self.sound:
            return
        self._grid = grid = _sparse_rays(camera, time_s, rows, columns, up)
        active, self._skipped = tracer._active(memory, grid, 2 * GRID_PX * up / least_pixels_per_rad(model))
        origins, directions, times = (memory.allocate(8 * n * width) for width in (3, 3, 1))
        order = memory.allocate(8 * n)
        self._at = {"rgb": results.allocate(12 * n * up**2)}
        names = passes | ({"depth", "instance"} if "unsupported" in passes else set()) | {"opacity"}
        for name in sorted(names):
            _, width, kind = PASSES[name]
            self._at[name] = results.allocate(n * width * np.dtype(kind).itemsize)
        if "depth" in passes:
            self._at["along"] = results.allocate(4 * n)
        self._begin(n, LAUNCHES)
        head, convolutions, count = scene.network(camera.sensor_id)
        planes = [PlaneStruct(self._at["rgb"], 3, 4, MAP_KINDS["rgb"])]
        for name in (*sorted(passes - undeciding), *sorted(undeciding)):
            _, width, kind = PASSES[name]
            planes.append(PlaneStruct(self._at[name], width, np.dtype(kind).itemsize, MAP_KINDS.get(name, 3)))
        self._image = ImageInputsStruct(
            *shape, rows.start, columns.start, up, -(-model.width // up), by_columns, model.fx, model.fy, model.cx, model.cy,
            scene.lens(model), memory.upload(doubles(poses)), memory.upload(doubles(moments)),
            (ctypes.c_double * 3)(*camera.world_from_camera.at(time_s)[:3, 2]), origins, directions, times,
            head, convolutions, count, size, memory.upload((PlaneStruct * len(planes))(*planes)), len(planes),
            len(planes) - len(undeciding), block_tolerance(spread), scene.observed if "unsupported" in passes else None,
            self._at["rgb"], self._at.get("along"), self._at.get("unsupported"),
            memory.allocate(n), memory.allocate(n), memory.allocate(n // 3 + 1, clear=True), order,
            self._numbers + 8,
        )  # fmt: skip
        of_rays = {PASSES[name][0]: at for name, at in self._at.items() if name in PASSES and PASSES[name][0]}
        self._inputs = TraceInputsStruct(
            scene.struct()[0],
            active,
            RaysStruct(n, origins, directions, times, order),
            MeshHitsStruct(),
            tracer._sampling(True),
            TraceResultStruct(
                feature=memory.allocate(4 * n * head.features),
                depth=memory.allocate(4 * n),
                samples=self._numbers,
                **of_rays,
            ),
        )
        self._traces = 0
        self._launch_all()
        self._copy({name: self._pinned(name) for name in self._at if name in ("rgb", "along", *passes)}, self._at)

    def _pinned(self, name: str) -> NDArray[Any]:
        _, width, kind = PASSES.get(name, ("", 3 * self._up**2 if name == "rgb" else 1, np.float32))
        return self._gpu.pinned((self._pixels, width) if width > 1 else (self._pixels,), kind)

    def _launch_all(self) -> None:
        image, size = self._image, self._image.size
        self._launch("begin_image", self._pixels, image)
        self._trace({size, 1})
        blocks = self._pixels // size**2
        while size > 1:
            for by_middles in (0, 1):
                self._launch("judge_blocks", blocks, image, ctypes.c_int32(size), ctypes.c_int32(by_middles))
                self._trace({size // 2})
            size, blocks = size // 2, 4 * blocks
        self._launch("fill_pixels", self._pixels, image)

    def _trace(self, strides: set[int]) -> None:
        """Trace the pixels that are wanted, at multiples of the strides."""
        assert self._traces < LAUNCHES
        count = ctypes.c_void_p(self._numbers + 8 * (1 + self._traces))
        self._traces += 1
        for stride in strides:
            self._launch(
                "collect_pixels", self._pixels // stride**2 // 64 + 1, self._image, ctypes.c_int32(stride), count
            )
        self._trace_rays(count)
        self._launch("finish_pixels", self._pixels, self._inputs, self._image, count)


def _sparse_rays(camera: Camera, time_s: float, rows: slice, columns: slice, up: int) -> Rays:
    """Return the rays (N,) of cells of ``up`` x ``up`` pixels `GRID_PX` apart, those at the edges included."""
    v, u = (np.append(np.arange(of.start, of.stop - 1, GRID_PX), of.stop - 1) * up + up / 2 for of in (rows, columns))
    return camera_rays(camera, time_s, *np.meshgrid(u, v)).flat()


def _sparse_beams(lidar: Lidar, time_s: float) -> tuple[Rays, float]:
    """Return rays (N,) of some beams and columns of a sweep, at the first and the last time of all, and the largest angle of a
    beam from one of them, radians."""
    model, window = lidar.model_at(time_s), exposure_window(lidar, time_s)
    beams, columns = (
        slice(0, None, -(-n // m)) for n, m in ((model.beams, SPARSE_BEAMS), (model.columns, SPARSE_COLUMNS))
    )
    rays = lidar_rays(lidar, time_s, beams, columns).flat()
    times = np.resize(window, len(rays.time_s))
    apart = (
        (model.elevation_rad, beams.step),
        (model.azimuth_offset_rad, beams.step),
        (np.unwrap(column_azimuths(model)), columns.step),
    )
    slack_rad = sum(float(np.abs(x - x[np.arange(len(x)) // step * step]).max()) for x, step in apart)
    # and the sensor turns: the norm is larger than the angle
    rotations = lidar.world_from_lidar.at(np.linspace(*window, 9))[:, :3, :3]
    slack_rad += float(np.linalg.norm(np.diff(rotations, axis=0), axis=(1, 2)).sum())
    return Rays(rays.origins, rays.directions, times), slack_rad


RESULTS = {"median": "depth", "instance": "instance", "normal": "normal"}
"""Passes of a trace by their names in `TraceResultStruct`."""


def launch_memory(memory: GpuMemory, threads: int, samples: int, segments: int) -> LaunchMemoryStruct:
    """Return room for so many samples and segments of a ray in each thread. Raises `GpuMemoryError`."""
    return LaunchMemoryStruct(
        memory.allocate(4 * 6 * samples * threads),
        memory.allocate(SEGMENT_BYTES * segments * threads),
        threads,
        samples,
        segments,
    )


def decode_beams(
    gpu: Gpu,
    inputs: TraceInputsStruct,
    head: HeadStruct,
    n: int,
    intensity: int,
    probability: int,
    depth: int | None = None,
) -> None:
    """Have the returns of n traced beams written to these addresses, and to ``depth`` their depths, 0 where they hit
    nothing."""
    places = map(ctypes.c_void_p, (intensity, probability, depth))
    gpu.launch("unisim_decode_beams", n, (inputs, head, ctypes.c_int32(n), *places))


def launch(memory: GpuMemory, inputs: TraceInputsStruct, n: int) -> None:
    """Trace n rays of the inputs on a GPU. Rays without room are traced again with twice as much of it; where memory does
    not suffice, fewer at a time. Raises `GpuMemoryError`."""
    threads, samples, segments = min(THREADS, -(-n // BLOCK) * BLOCK), SAMPLES, SEGMENTS
    while n:
        with GpuMemory(memory.gpu, reuse=True) as room:
            try:
                refused = room.allocate(8 * (n + 1), clear=True)
                block = launch_memory(room, threads, samples, segments)
            except GpuMemoryError:
                if threads == BLOCK:
                    raise
                threads = max(BLOCK, threads // 2 // BLOCK * BLOCK)
                continue
            all_of_them = ctypes.c_void_p()
            memory.gpu.launch("unisim_trace_rays", threads, (inputs, block, all_of_them, ctypes.c_void_p(refused)))
            count = np.zeros(1, np.int64)
            room.download(refused, count)
            n = int(count[0])
            if n:
                numbers = np.zeros(n + 1, np.int64)
                room.download(refused, numbers)
                inputs.rays.order = memory.upload(np.sort(numbers[1:]))
                inputs.rays.n = n
                samples, segments = 2 * samples, 2 * segments
                threads = min(threads, -(-n // BLOCK) * BLOCK)
