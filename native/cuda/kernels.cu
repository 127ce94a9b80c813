// What a GPU launches: rays, images, and their parts, one thread each.
#include "image.h"

namespace {

// The arrays that the threads of a launch share: `samples` (6, capacity, threads) numbers and `segments`
// (threads, segment_capacity).
struct LaunchMemory {
    float *samples;
    Segment *segments;
    int32_t threads, capacity, segment_capacity;
};

// Runs work(i) for this thread's numbers below `count`.
template <class Work> UNISIM_DEVICE void for_numbers(int32_t count, const Work &work) {
    const int32_t threads = gridDim.x * blockDim.x;
    for (int32_t i = blockIdx.x * blockDim.x + threadIdx.x; i < count; i += threads) work(i);
}

UNISIM_DEVICE int32_t pixels_of(const ImageInputs &image) { return image.height * image.width; }

} // namespace

// `core/render/tracers/compiled/gpu.py` has their sizes.
static_assert(sizeof(Segment) == 104, "SEGMENT_BYTES");

// Traces the first rays of the order: as many as `count` says, or all of them where it is null. One that finds no room
// is noted in `refused` (its count first), and traced again with more of it.
extern "C" __global__ void __launch_bounds__(128, 3)
    unisim_trace_rays(const __grid_constant__ TraceInputs in, const __grid_constant__ LaunchMemory memory,
                      const int64_t *count, int64_t *refused) {
    int32_t evaluations = 0;
    for_numbers(static_cast<int32_t>(count ? *count : in.rays.n), [&](int32_t i) {
        const int thread = blockIdx.x * blockDim.x + threadIdx.x;
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
    });
    atomicAdd(reinterpret_cast<unsigned long long *>(in.result.samples), static_cast<unsigned long long>(evaluations));
}

extern "C" __global__ void __launch_bounds__(128)
    unisim_decode_beams(const __grid_constant__ TraceInputs in, const __grid_constant__ unisim_head head, int32_t count,
                        float *out) {
    for_numbers(count, [&](int32_t i) { decode_beam(in, head, i, out + 2 * static_cast<int64_t>(i)); });
}

extern "C" __global__ void __launch_bounds__(128) unisim_begin_image(const __grid_constant__ ImageInputs image) {
    for_numbers(pixels_of(image), [&](int32_t i) { begin_pixel(image, i); });
}

extern "C" __global__ void __launch_bounds__(128)
    unisim_collect_pixels(const __grid_constant__ ImageInputs image, int32_t stride, int64_t *count) {
    const int32_t side = 8 * stride;
    const int32_t across = (image.width + side - 1) / side, down = (image.height + side - 1) / side;
    for_numbers(across * down, [&](int32_t i) { collect_tile(image, stride, i, count); });
}

extern "C" __global__ void __launch_bounds__(128)
    unisim_finish_pixels(const __grid_constant__ TraceInputs in, const __grid_constant__ ImageInputs image,
                         const int64_t *count) {
    for_numbers(static_cast<int32_t>(*count), [&](int32_t i) { finish_pixel(in, image, image.order[i]); });
}

// `by_middles`: of blocks that are in doubt.
extern "C" __global__ void __launch_bounds__(128)
    unisim_judge_blocks(const __grid_constant__ ImageInputs image, int32_t size, int32_t by_middles) {
    const BlockGrid grid(image, size);
    for_numbers(grid.rows * grid.columns, [&](int32_t i) {
        if (by_middles)
            judge_middle(image, size, i);
        else
            judge_block(image, size, i);
    });
}

extern "C" __global__ void __launch_bounds__(128) unisim_fill_pixels(const __grid_constant__ ImageInputs image) {
    for_numbers(pixels_of(image), [&](int32_t i) { fill_pixel(image, i); });
}
