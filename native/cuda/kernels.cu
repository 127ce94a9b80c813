// What a GPU launches: one thread a ray.
#include "trace_ray.h"

namespace {

// The arrays that the threads of a launch share: `samples` (6, capacity, threads) numbers and `segments`
// (threads, segment_capacity).
struct LaunchMemory {
    float *samples;
    Segment *segments;
    int32_t threads, capacity, segment_capacity;
};

} // namespace

// `core/render/tracers/compiled/gpu.py` has their sizes.
static_assert(sizeof(Segment) == 104, "SEGMENT_BYTES");

// Traces rays number begin to before end of the order; one that finds no room is noted in `refused` (its count first),
// and traced again with more of it.
extern "C" __global__ void __launch_bounds__(128)
    unisim_trace_rays(const __grid_constant__ TraceInputs in, const LaunchMemory memory, int64_t begin, int64_t end,
                      int64_t *refused) {
    const int thread = blockIdx.x * blockDim.x + threadIdx.x;
    int64_t evaluations = 0;
    for (int64_t i = begin + thread; i < end; i += memory.threads) {
        float *x = memory.samples + thread;
        const int64_t of = static_cast<int64_t>(memory.capacity) * memory.threads;
        const Workspace work{
            memory.segments + static_cast<int64_t>(thread) * memory.segment_capacity,
            memory.segment_capacity,
            {x, x + of, x + 2 * of, x + 3 * of, x + 4 * of, x + 5 * of, memory.threads, memory.capacity}};
        const int64_t ray = in.rays.order ? in.rays.order[i] : i;
        if (!RayTracer(in, work).trace(ray, evaluations)) {
            const int64_t slot = atomicAdd(reinterpret_cast<unsigned long long *>(refused), 1ull);
            refused[1 + slot] = ray;
        }
    }
    atomicAdd(reinterpret_cast<unsigned long long *>(in.result.samples), static_cast<unsigned long long>(evaluations));
}
