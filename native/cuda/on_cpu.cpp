// The GPU's tracer, compiled by the C++ compiler: a variant of the kernels by which tests run what a GPU runs.
#include "../variant.h"
#include "trace_ray.h"

extern "C" int UNISIM_NAME(unisim_trace)(const unisim_scene *scene, const unisim_active_actors *active,
                                         const unisim_rays *rays, const unisim_mesh_hits *meshes,
                                         const unisim_sampling *sampling, const unisim_trace_result *result,
                                         int threads) {
    const TraceInputs in{*scene, *active, *rays, meshes ? *meshes : unisim_mesh_hits{}, *sampling, *result};
    std::atomic<int64_t> samples{0};
    parallel_bodies(rays->n, 256, threads, [&] {
        return [&, room = 64, segments = std::vector<Segment>(), numbers = std::vector<float>()](int64_t begin,
                                                                                                 int64_t end) mutable {
            int32_t evaluations = 0;
            for (int64_t at = begin; at < end;) {
                segments.resize(static_cast<size_t>(room / 8));
                numbers.resize(static_cast<size_t>(6 * room));
                float *x = numbers.data();
                const Workspace work{segments.data(),
                                     room / 8,
                                     {x, x + room, x + 2 * room, x + 3 * room, x + 4 * room, x + 5 * room, 1, room}};
                // a ray without room is traced again with more of it
                if (RayTracer(in, work).trace(rays->order ? rays->order[at] : at, evaluations))
                    ++at;
                else
                    room *= 2;
            }
            samples += evaluations;
        };
    });
    *result->samples = samples;
    return 0;
}
