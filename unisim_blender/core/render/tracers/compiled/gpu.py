"""Rays traced on an NVIDIA GPU, one thread a ray, by CUDA's driver alone: the compiled tracer with its scenes, rays and
results in the GPU's memory. Sensors are decoded by the CPU's kernels.

`native/cuda/trace_ray.h` is what a thread does. CPU and GPU place the same samples; sums differ by rounding.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....cuda_driver import Gpu, GpuMemory, GpuMemoryError
from ....meshes.hits import MeshHits
from ....native import HeadStruct, LayerStruct, MlpStruct
from ....sensors.frames import RenderStats
from ....sensors.rays import Rays
from ....world.replay import WorldState
from ...quality import QUALITIES, Quality
from ...tracer import Array, Maps, TraceResult
from .scene import CompiledScene
from .structs import (
    ActiveActorsStruct,
    ActorSetStruct,
    MeshHitsStruct,
    RaysStruct,
    SamplingStruct,
    SceneStruct,
    TraceResultStruct,
    doubles,
)
from .tracer import CompiledBackend, CompiledTracer, MeshHitArrays

BLOCK = 128
"""Threads of a block."""
THREADS = 1 << 16
"""Threads of a launch at most: each has room of its own for a ray's samples and segments."""
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

    def _moved_head(self, head: HeadStruct, uploaded: Uploaded) -> HeadStruct:
        of = (LayerStruct * head.count).from_address(head.layers)
        layers = (LayerStruct * head.count)(*(uploaded.moved(layer) for layer in of))
        return HeadStruct(head.features, head.extra_inputs, head.count, self.memory.upload(layers))


class GpuBackend(CompiledBackend):
    """Trained scenes on a GPU: a `tracer.Backend`."""

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
        outputs: dict[str, list[Array]] = {
            "feature": [traced.feature],
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
        with GpuMemory(self._gpu) as memory:
            active, skipped = self._active(memory, some)
            at = {name: [memory.allocate(n * array[:1].nbytes) for array in arrays] for name, arrays in outputs.items()}
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
            for name, arrays in outputs.items():
                for place, array in zip(at[name], arrays, strict=True):
                    part = np.empty((n, *array.shape[1:]), array.dtype)
                    memory.download(place, part)
                    array[order] = part
            spent = np.zeros(1, np.int64)
            memory.download(samples, spent)
        stats.rays += n
        stats.actors_skipped += skipped
        stats.samples_spent += int(spent[0])
        stats.samples_saved += max(0, self._uniform(some) - int(spent[0]))

    def _active(self, memory: GpuMemory, rays: Rays) -> tuple[ActiveActorsStruct, int]:
        """Return the active actors that these rays can hit, on the GPU, and the number of the others."""
        actors = self._compiled_actors
        struct, _referenced, skipped = actors.struct(rays)
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


RESULTS = {"median": "depth", "instance": "instance", "normal": "normal"}
"""Passes of a trace by their names in `TraceResultStruct`."""


def launch(memory: GpuMemory, inputs: TraceInputsStruct, n: int) -> None:
    """Trace n rays of the inputs on a GPU. Rays without room are traced again with twice as much of it; where memory does
    not suffice, fewer at a time. Raises `GpuMemoryError`."""
    threads, samples, segments = min(THREADS, -(-n // BLOCK) * BLOCK), SAMPLES, SEGMENTS
    while n:
        with GpuMemory(memory.gpu) as room:
            try:
                refused = room.allocate(8 * (n + 1), clear=True)
                block = LaunchMemoryStruct(
                    room.allocate(4 * 6 * samples * threads),
                    room.allocate(SEGMENT_BYTES * segments * threads),
                    threads,
                    samples,
                    segments,
                )
            except GpuMemoryError:
                if threads == BLOCK:
                    raise
                threads = max(BLOCK, threads // 2 // BLOCK * BLOCK)
                continue
            begin, end = ctypes.c_int64(0), ctypes.c_int64(n)
            memory.gpu.launch(
                "unisim_trace_rays", threads, (inputs, block, begin, end, ctypes.c_void_p(refused)), BLOCK
            )
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
