// Operations of training and of torch's tracer, forward and backward, by one thread for each point and level, point, sample
// or ray. The specification is plain torch, in core/ops/encode.py, core/ops/field.py, core/ops/density.py,
// core/ops/gather.py and core/ops/propose.py.
#pragma once
#include "field.h"

namespace {

// F numbers that are read and written at once.
template <int F> struct alignas(F * sizeof(float)) Row {
    float value[F];
};

// Adds to numbers to which other threads add, in any order.
template <int F> UNISIM_DEVICE inline void add_to(float *sum, const Row<F> &row) {
#if defined(__CUDA_ARCH__) && __CUDA_ARCH__ >= 900
    if constexpr (F == 4) {
        atomicAdd(reinterpret_cast<float4 *>(sum), make_float4(row.value[0], row.value[1], row.value[2], row.value[3]));
        return;
    }
#endif
    for (int f = 0; f < F; ++f)
#if defined(__CUDA_ARCH__)
        atomicAdd(sum + f, row.value[f]);
#else
        sum[f] += row.value[f];
#endif
}

// A table of float32, its points (n, 3) and the number of each point's grid, null where there is one grid.
struct EncodedPoints {
    unisim_grid grid;
    const float *table, *x;
    const int32_t *number;

    UNISIM_DEVICE int64_t first_row(int64_t point, int level) const {
        return (number ? number[point] * grid.grid_stride : 0) + grid.offset[level];
    }

    // Runs work(corner, row) for the corners of a point's cell.
    template <class Work> UNISIM_DEVICE void for_corners(const GridCell &cell, int level, const Work &work) const {
        const uint32_t sy = grid.stride_y[level], sz = grid.stride_z[level], mask = grid.size[level] - 1;
        UNISIM_UNROLL
        for (int corner = 0; corner < 8; ++corner) work(corner, static_cast<int64_t>(cell.row(corner, sy, sz, mask)));
    }

    // One level of a point's encoding, F features at a time.
    template <int F> UNISIM_DEVICE void encode_level(int64_t point, int level, float *out) const {
        const GridCell cell(grid, level, x + 3 * point);
        const float *base = table + first_row(point, level) * grid.features;
        for (int first = 0; first < grid.features; first += F) {
            Row<F> sum{};
            for_corners(cell, level, [&](int corner, int64_t row) {
                const Row<F> values = *reinterpret_cast<const Row<F> *>(base + row * grid.features + first);
                const float weight = cell.weight(corner);
                for (int f = 0; f < F; ++f) sum.value[f] += weight * values.value[f];
            });
            *reinterpret_cast<Row<F> *>(out + first) = sum;
        }
    }

    // Adds the table's gradient of one level of a point's encoding, whose gradient is `grad`.
    template <int F>
    UNISIM_DEVICE void add_table_gradient(int64_t point, int level, const float *grad, float *grad_table) const {
        const GridCell cell(grid, level, x + 3 * point);
        float *base = grad_table + first_row(point, level) * grid.features;
        for (int first = 0; first < grid.features; first += F) {
            const Row<F> given = *reinterpret_cast<const Row<F> *>(grad + first);
            for_corners(cell, level, [&](int corner, int64_t row) {
                Row<F> part = given;
                for (int f = 0; f < F; ++f) part.value[f] *= cell.weight(corner);
                add_to(base + row * grid.features + first, part);
            });
        }
    }

    // The gradient (3) of a point, of its encoding's `grad` (levels, features).
    UNISIM_DEVICE void point_gradient(int64_t point, const float *grad, float *grad_x) const {
        const float *p = x + 3 * point;
        float sum[3] = {};
        for (int level = 0; level < grid.levels; ++level) {
            const GridCell cell(grid, level, p);
            const float *base = table + first_row(point, level) * grid.features, *given = grad + level * grid.features;
            float slope[3] = {};
            for_corners(cell, level, [&](int corner, int64_t row) {
                float dot = 0;
                for (int f = 0; f < grid.features; ++f) dot += given[f] * base[row * grid.features + f];
                const float wx = cell.along(corner, 0), wy = cell.along(corner, 1), wz = cell.along(corner, 2);
                slope[0] += (corner & 1 ? dot : -dot) * wy * wz;
                slope[1] += (corner & 2 ? dot : -dot) * wx * wz;
                slope[2] += (corner & 4 ? dot : -dot) * wx * wy;
            });
            for (int a = 0; a < 3; ++a) sum[a] += grid.scale[level * 3 + a] * slope[a];
        }
        // a point that was clamped to a face does not move with x there
        for (int a = 0; a < 3; ++a) grad_x[a] = p[a] > 0 && p[a] < 1 ? sum[a] : 0.0f;
    }

    // The outputs of a network at a point. INPUTS 0: as many as there are; else 8 levels of 4 features.
    template <int INPUTS> UNISIM_DEVICE void evaluate(int64_t point, const unisim_mlp &net, float *out) const {
        float code[INPUTS ? INPUTS : MAX_INPUTS], sum[MAX_OUTPUTS];
        encode<INPUTS ? 4 : 0, INPUTS / 4>(grid, table, number ? number[point] : 0, x + 3 * point, code);
        if (net.outputs == 1) {
            out[0] = evaluate_network<INPUTS>(net, code, 0, nullptr);
            return;
        }
        for (int o = 0; o < net.outputs; ++o) sum[o] = net.bias[o];
        for (int j = 0; j < net.hidden; ++j) {
            float unit = 0;
            UNISIM_UNROLL
            for (int i = 0; i < (INPUTS ? INPUTS : net.inputs); ++i)
                unit += net.w1[j * (INPUTS ? INPUTS : net.inputs) + i] * code[i];
            if (unit <= 0) continue;
            for (int o = 0; o < net.outputs; ++o) sum[o] += net.w2[o * net.hidden + j] * unit;
        }
        for (int o = 0; o < net.outputs; ++o) out[o] = sum[o];
    }
};

constexpr float FLAT = 1e-2f, DEEP = 5.0f;

// An interval of the logistic density between samples with signed distances s0 and s1, and its gradients.
struct LogisticInterval {
    float a1, rise, slope, safe, e, surface, deep, tau, left, alpha, mean;
    bool is_flat, is_deep;

    UNISIM_DEVICE LogisticInterval(float s0, float s1, float beta) {
        const float a0 = -beta * s0, outside = softplus(a0);
        a1 = -beta * s1;
        rise = softplus(a1) - outside;
        slope = a1 - a0;
        is_flat = slope < FLAT && slope > -FLAT;
        is_deep = outside > DEEP;
        safe = is_flat ? 1.0f : slope;
        e = std::exp(lesser_of(outside, DEEP));
        surface = (slope - rise) / safe * e;
        const float y = greater_of(safe, FLAT);
        deep = opacity_of(y) / y;
        tau = greater_of(0.0f, rise);
        left = std::exp(-tau);
        alpha = opacity_of(tau);
        mean = is_flat ? 1.0f - alpha / 2 : is_deep ? deep : surface;
    }

    UNISIM_DEVICE float stop_fraction() const { return lesser_of(greater_of(0.0f, mean - left), alpha); }

    // Of gradients of tau and of the stop fraction: the gradient of a1 without what comes by `softplus`, which is the
    // negative of a0's, and the factors of sigmoid(a0) and sigmoid(a1).
    UNISIM_DEVICE void backward(float g_tau, float g_stop, float &of_slope, float &of_near, float &of_far) const {
        const float raw = mean - left, inside = greater_of(0.0f, raw);
        const float chosen = inside < alpha ? 1.0f : inside == alpha ? 0.5f : 0.0f;
        const float g_mean = raw >= 0.0f ? g_stop * chosen : 0.0f;
        const float g_alpha = g_stop * (1 - chosen) - (is_flat ? g_mean / 2 : 0.0f);
        const float g_surface = is_flat || is_deep ? 0.0f : g_mean;
        const float g_deep = !is_flat && is_deep && slope >= FLAT ? g_mean : 0.0f;
        const float g_depth = g_tau + (g_alpha + g_mean) * left, y = greater_of(safe, FLAT);
        of_far = (rise >= 0.0f ? g_depth : 0.0f) - g_surface * e / safe;
        of_slope = g_surface * e * rise / (safe * safe) + g_deep * (1 - y * deep - deep) / y;
        of_near = g_surface * surface - of_far;
    }
};

// The gradient of -beta s of sample i of rows of `width` samples s, of gradients of tau and stop fractions.
UNISIM_DEVICE inline float interval_gradient(const float *s, int32_t width, float beta, const float *g_tau,
                                             const float *g_stop, int64_t i) {
    const int32_t k = static_cast<int32_t>(i % width);
    float by_slope = 0, by_depth = k ? 0.0f : g_tau[i], of_slope, of_near, of_far;
    if (k) {
        LogisticInterval(s[i - 1], s[i], beta).backward(g_tau[i], g_stop[i], of_slope, of_near, of_far);
        by_slope += of_slope;
        by_depth += of_far;
    }
    if (k + 1 < width) {
        LogisticInterval(s[i], s[i + 1], beta).backward(g_tau[i + 1], g_stop[i + 1], of_slope, of_near, of_far);
        by_slope -= of_slope;
        by_depth += of_near;
    }
    return by_slope + by_depth * sigmoid(-beta * s[i]);
}

// Ray segments (n) of `width` samples whose features, `length` numbers, are `stride` apart.
struct GatheredSegments {
    int64_t n, stride;
    int32_t width, length;
    const float *t, *tau, *stop_fraction, *before, *features;

    // Weights of a segment's intervals and samples (width), and its sums of weight, distance by weight and depth.
    UNISIM_DEVICE void weigh(int64_t r, float *interval, float *weight, float *sums) const {
        // float64: many thin intervals would be lost to rounding one by one
        double whole = 0, far = 0, depth = 0;
        float near = 0;
        for (int64_t i = (r + 1) * width - 1; i >= r * width; --i) {
            const float stops = before[i] * opacity_of(tau[i]), far_part = before[i] * stop_fraction[i];
            // an interval's weight is divided between the samples at its two ends; interval 0 has one sample
            const float w = far_part + near + (i == r * width ? stops : 0.0f);
            near = stops - far_part;
            interval[i] = stops;
            weight[i] = w;
            whole += w;
            far += w * t[i];
            depth += tau[i];
        }
        float *out = sums + r * (length + 3) + length;
        out[0] = static_cast<float>(whole);
        out[1] = static_cast<float>(far);
        out[2] = static_cast<float>(depth);
    }

    UNISIM_DEVICE void sum_feature(int64_t r, int32_t f, const float *weight, float *sums) const {
        float sum = 0;
        for (int64_t i = r * width; i < (r + 1) * width; ++i) sum += weight[i] * features[i * stride + f];
        sums[r * (length + 3) + f] = sum;
    }

    // The gradient of the weight of sample i.
    UNISIM_DEVICE float weight_gradient(int64_t i, const float *g_weight, const float *g_sums) const {
        const float *given = g_sums + i / width * (length + 3);
        float dot = g_weight[i] + given[length] + given[length + 1] * t[i];
        for (int32_t f = 0; f < length; ++f) dot += given[f] * features[i * stride + f];
        return dot;
    }

    // Gradients of a segment's tau, stop fractions and transmittances before, which hold those of its weights at first.
    UNISIM_DEVICE void backward(int64_t r, const float *g_interval, const float *g_sums, float *of_tau,
                                float *of_stop_fraction, float *of_before) const {
        for (int64_t i = (r + 1) * width - 1; i >= r * width; --i) {
            const bool first = i == r * width;
            // the far part is this sample's, the near part the one before's; of interval 0 this one has all
            const float own = of_before[i], near = first ? own : of_before[i - 1], far = first ? own : own - near;
            const float whole = g_interval[i] + near;
            of_tau[i] = whole * before[i] * std::exp(-tau[i]) + g_sums[r * (length + 3) + length + 2];
            of_stop_fraction[i] = far * before[i];
            of_before[i] = far * stop_fraction[i] + whole * opacity_of(tau[i]);
        }
    }
};

// Rays through voxels (shape), values 0 to 255 from `lower` on.
struct VoxelRays {
    const float *origins, *directions, *t_near, *t_far, *lower;
    const uint8_t *voxels;
    int32_t shape[3];
    float per_m, step, decay;

    // Runs work(step's number, mass before it, its mass) for the occupied steps of a ray; returns the sum of the masses.
    template <class Work> UNISIM_DEVICE float walk(int64_t ray, const Work &work) const {
        const float near = t_near[ray], span = t_far[ray] - near;
        const int32_t steps = steps_between(near, t_far[ray], step, MAX_STEPS);
        float total = 0, depth = 0;
        for (int32_t i = 0; i < steps; ++i) {
            const float at = near + (static_cast<float>(i) + 0.5f) * step;
            int64_t cell = 0;
            bool inside = span > 0;
            for (int a = 0; a < 3; ++a) {
                const float x = (origins[3 * ray + a] - lower[a] + at * directions[3 * ray + a]) * per_m;
                inside = inside && x >= 0.0f && x < static_cast<float>(shape[a]);
                cell = cell * shape[a] + static_cast<int64_t>(inside ? x : 0.0f);
            }
            const uint8_t value = inside ? voxels[cell] : 0;
            if (!value) continue;
            const float p = static_cast<float>(value) * (1.0f / 255.0f), mass = p * std::exp(-decay * step * depth);
            work(i, total, mass);
            total += mass;
            depth += p;
        }
        return total;
    }

    // Places t (count) at quantiles u (count), ascending, of the masses along a ray; returns their sum.
    UNISIM_DEVICE float propose(int64_t ray, const float *u, int32_t count, float *t) const {
        const float near = t_near[ray], span = t_far[ray] - near;
        const float total = walk(ray, [](int32_t, float, float) {});
        int32_t k = 0, last = 0;
        float last_before = 0, last_mass = 1;
        const auto place = [&](int32_t i, float before, float mass) {
            const float fraction = (u[k] * total - before) / mass;
            t[k++] = near + (static_cast<float>(i) + (fraction > 0.0f ? lesser_of(fraction, 1.0f) : 0.0f)) * step;
        };
        if (total > 0)
            walk(ray, [&](int32_t i, float before, float mass) {
                while (k < count && u[k] * total < before + mass) place(i, before, mass);
                last = i;
                last_before = before;
                last_mass = mass;
            });
        // quantiles that rounding sends past the last occupied step stand in it
        while (k < count && total > 0) place(last, last_before, last_mass);
        for (; k < count; ++k) t[k] = near + u[k] * (span > 0 ? span : 0.0f);
        return total;
    }
};

} // namespace
