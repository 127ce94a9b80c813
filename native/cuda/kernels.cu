// What a GPU launches: rays, images, their parts, sweeps, and operations of training, one thread each.
#include "sweep.h"
#include "training.h"

namespace {

// The arrays that the threads of a launch share: `samples` (6, capacity, threads) numbers and `segments`
// (threads, segment_capacity).
struct LaunchMemory {
    float *samples;
    Segment *segments;
    int32_t threads, capacity, segment_capacity;
};

// Runs work(i) for this thread's numbers below `count`.
template <class N, class Work> UNISIM_DEVICE void for_numbers(N count, const Work &work) {
    const N threads = gridDim.x * blockDim.x;
    for (N i = blockIdx.x * blockDim.x + threadIdx.x; i < count; i += threads) work(i);
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
                        float *intensity, float *probability, float *range) {
    for_numbers(count, [&](int32_t i) { decode_beam(in, head, i, intensity, probability, range); });
}

extern "C" __global__ void __launch_bounds__(128) unisim_begin_sweep(const __grid_constant__ SweepInputs sweep) {
    for_numbers(sweep.beams * sweep.columns, [&](int32_t i) { begin_beam(sweep, i); });
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

// Training: what torch's operations launch, see core/ops. The level is the slowest number: threads at work at the same
// time read one level of a table.
extern "C" __global__ void __launch_bounds__(128)
    unisim_encode(const __grid_constant__ EncodedPoints of, int64_t n, float *out) {
    const int features = of.grid.features;
    for_numbers(n * of.grid.levels, [&](int64_t i) {
        const int level = static_cast<int>(i / n);
        float *to = out + (i % n * of.grid.levels + level) * features;
        if (features % 4 == 0)
            of.encode_level<4>(i % n, level, to);
        else if (features % 2 == 0)
            of.encode_level<2>(i % n, level, to);
        else
            of.encode_level<1>(i % n, level, to);
    });
}

extern "C" __global__ void __launch_bounds__(128)
    unisim_encode_table_gradient(const __grid_constant__ EncodedPoints of, int64_t n, const float *grad,
                                 float *grad_table) {
    for_numbers(n * of.grid.levels, [&](int64_t i) {
        const int level = static_cast<int>(i / n), features = of.grid.features;
        const float *given = grad + (i % n * of.grid.levels + level) * features;
        if (features % 4 == 0)
            of.add_table_gradient<4>(i % n, level, given, grad_table);
        else if (features % 2 == 0)
            of.add_table_gradient<2>(i % n, level, given, grad_table);
        else
            of.add_table_gradient<1>(i % n, level, given, grad_table);
    });
}

extern "C" __global__ void __launch_bounds__(128)
    unisim_encode_point_gradient(const __grid_constant__ EncodedPoints of, int64_t n, const float *grad,
                                 float *grad_x) {
    for_numbers(n, [&](int64_t i) {
        of.point_gradient(i, grad + i * of.grid.levels * of.grid.features, grad_x + 3 * i);
    });
}

extern "C" __global__ void __launch_bounds__(128)
    unisim_field(const __grid_constant__ EncodedPoints of, const __grid_constant__ unisim_mlp net, int64_t n,
                 float *out) {
    for_numbers(n, [&](int64_t i) {
        if (of.grid.features == 4 && of.grid.levels == 8)
            of.evaluate<32>(i, net, out + i * net.outputs);
        else
            of.evaluate<0>(i, net, out + i * net.outputs);
    });
}

extern "C" __global__ void __launch_bounds__(128)
    unisim_intervals(const float *s, int64_t n, int32_t width, const float *beta, float *tau, float *stop_fraction) {
    for_numbers(n, [&](int64_t i) {
        const bool first = i % width == 0;
        const LogisticInterval interval(s[first ? i : i - 1], s[i], *beta);
        tau[i] = first ? softplus(interval.a1) : interval.tau;
        stop_fraction[i] = first ? 0.0f : interval.stop_fraction();
    });
}

extern "C" __global__ void __launch_bounds__(128)
    unisim_interval_gradients(const float *s, int64_t n, int32_t width, const float *beta, const float *grad_tau,
                              const float *grad_stop_fraction, float *grad) {
    for_numbers(n, [&](int64_t i) { grad[i] = interval_gradient(s, width, *beta, grad_tau, grad_stop_fraction, i); });
}

extern "C" __global__ void __launch_bounds__(128)
    unisim_weigh(const __grid_constant__ GatheredSegments of, float *interval, float *weight, float *sums) {
    for_numbers(of.n, [&](int64_t r) { of.weigh(r, interval, weight, sums); });
}

extern "C" __global__ void __launch_bounds__(128)
    unisim_sum_features(const __grid_constant__ GatheredSegments of, const float *weight, float *sums) {
    for_numbers(of.n * of.length, [&](int64_t i) {
        of.sum_feature(i / of.length, static_cast<int32_t>(i % of.length), weight, sums);
    });
}

extern "C" __global__ void __launch_bounds__(128)
    unisim_weight_gradients(const __grid_constant__ GatheredSegments of, const float *grad_weight,
                            const float *grad_sums, float *grad) {
    for_numbers(of.n * of.width, [&](int64_t i) { grad[i] = of.weight_gradient(i, grad_weight, grad_sums); });
}

extern "C" __global__ void __launch_bounds__(128)
    unisim_gather_gradients(const __grid_constant__ GatheredSegments of, const float *grad_interval,
                            const float *grad_sums, float *grad_tau, float *grad_stop_fraction, float *grad_before) {
    for_numbers(of.n, [&](int64_t r) {
        of.backward(r, grad_interval, grad_sums, grad_tau, grad_stop_fraction, grad_before);
    });
}

extern "C" __global__ void __launch_bounds__(128)
    unisim_feature_gradients(const __grid_constant__ GatheredSegments of, const float *weight, const float *grad_sums,
                             float *grad) {
    for_numbers(of.n * of.width * of.length, [&](int64_t i) {
        const int64_t sample = i / of.length;
        grad[i] = weight[sample] * grad_sums[sample / of.width * (of.length + 3) + i % of.length];
    });
}

extern "C" __global__ void __launch_bounds__(128)
    unisim_propose_places(const __grid_constant__ VoxelRays rays, int64_t n, const float *u, int32_t count, float *t,
                          float *mass) {
    for_numbers(n, [&](int64_t i) { mass[i] = rays.propose(i, u + i * count, count, t + i * count); });
}
