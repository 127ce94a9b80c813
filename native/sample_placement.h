// Placement of samples along a ray: by quantiles of the occupancy along it, and then by quantiles of the weights of
// those samples. `core/ops/propose.py` and `core/ops/quantiles.py` are the specification, in plain torch.
#pragma once
#include "simd.h"
#include "variant.h"

#include <cmath>

namespace {

// The occupied steps of one ray and their cumulative mass.
struct OccupiedSteps {
    size_t count = 0;
    std::vector<int32_t> step; // with room for more than there are
    std::vector<float> mass;

    float total() const { return count ? mass[count - 1] : 0.0f; }
};

// Finds the steps, of half a voxel, in voxels that are not free.
inline void find_occupied(const unisim_scene &scene, const float *o, const float *d, float t_near, float t_far,
                          OccupiedSteps &out) {
    out.step.clear();
    out.mass.clear();
    const float step = scene.voxel_m / 2, inverse = 1.0f / scene.voxel_m;
    const float span = t_far - t_near;
    const int32_t steps = span > 0 ? static_cast<int32_t>(std::ceil(span / step)) : 0;
    const int32_t *shape = scene.voxel_shape;
    float total = 0, depth = 0;
    for (int32_t i = 0; i < steps; ++i) {
        const float t = t_near + (static_cast<float>(i) + 0.5f) * step;
        int64_t cell = 0;
        bool inside = true;
        for (int a = 0; a < 3; ++a) {
            const float x = std::floor((o[a] + t * d[a]) * inverse);
            inside &= x >= 0 && x < static_cast<float>(shape[a]);
            cell = cell * shape[a] + static_cast<int64_t>(inside ? x : 0.0f);
        }
        const uint8_t value = inside ? scene.voxels[cell] : 0;
        if (!value) continue;
        const float p = static_cast<float>(value) * (1.0f / 255.0f);
        total += p * std::exp(-scene.decay_per_m * step * depth);
        depth += p;
        out.mass.push_back(total);
        out.step.push_back(i);
    }
    out.count = out.step.size();
}

// Places t (count), `stride` apart, of rising quantiles u (count), `stride` apart.
inline void place_quantiles(const OccupiedSteps &in, float step, float t_near, const float *u, int count, int stride,
                            float *t) {
    size_t j = 0;
    for (int k = 0; k < count; ++k) {
        const float target = u[k * stride] * in.total();
        while (j + 1 < in.count && in.mass[j] <= target) ++j;
        const float before = j ? in.mass[j - 1] : 0.0f;
        const float fraction = std::fmin(std::fmax((target - before) / (in.mass[j] - before), 0.0f), 1.0f);
        t[k * stride] = t_near + (static_cast<float>(in.step[j]) + fraction) * step;
    }
}

// Cumulative weights cdf (places + 1, stride) of the intervals before, between and after `places` samples, from
// optical depths tau (places, stride): of sample 0, then of the intervals. The fraction `uniform` of the weight is
// distributed evenly.
inline void cumulate_weights(const float *tau, int places, int stride, float uniform, float *cdf) {
    constexpr float MIN_WEIGHT = 1e-5f;
    for (int p = 0; p < stride; p += LANES) {
        simd_float before{}, total{};
        for (int k = 0; k <= places; ++k) {
            simd_float weight = broadcast(MIN_WEIGHT);
            if (k < places) {
                const simd_float depth = load(tau + k * stride + p);
                weight += exp_of(-before) * opacity_of(depth);
                before += depth;
            }
            total += weight;
            store(cdf + k * stride + p, weight);
        }
        const simd_float scale = (1.0f - uniform) / total;
        simd_float sum{};
        for (int k = 0; k <= places; ++k) {
            const float width = (k == 0 || k == places ? 0.5f : 1.0f) / static_cast<float>(places);
            sum += load(cdf + k * stride + p) * scale + uniform * width;
            store(cdf + k * stride + p, sum);
        }
    }
}

// Quantiles u (count), `stride` apart: the middles of `count` equal parts of one ray's cumulative weights.
inline void invert_weights(const float *cdf, int places, int stride, int count, float *u) {
    const float total = cdf[places * stride];
    int k = 0;
    for (int j = 0; j < count; ++j) {
        const float target = (static_cast<float>(j) + 0.5f) / static_cast<float>(count) * total;
        while (k < places && cdf[k * stride] <= target) ++k;
        const float c0 = k ? cdf[(k - 1) * stride] : 0.0f, c1 = cdf[k * stride];
        const float e0 = k ? (static_cast<float>(k) - 0.5f) / static_cast<float>(places) : 0.0f;
        const float e1 = k == places ? 1.0f : (static_cast<float>(k) + 0.5f) / static_cast<float>(places);
        u[j * stride] = e0 + (target - c0) / std::fmax(c1 - c0, 1e-12f) * (e1 - e0);
    }
}

// A point (3) around the volume's centre in the unit cube of the background's grid: mip-NeRF 360's contraction (Barron et
// al., 2022, eq. 10). x is in the volume's coordinates.
inline void contract(const unisim_scene &scene, const float *x, float *out) {
    float y[3], norm = 0;
    for (int a = 0; a < 3; ++a) {
        y[a] = (x[a] - scene.size[a] / 2) / scene.background_radius_m;
        norm += y[a] * y[a];
    }
    norm = std::fmax(std::sqrt(norm), 1e-9f);
    const float scale = norm <= 1 ? 1.0f : (2 - 1 / norm) / norm;
    for (int a = 0; a < 3; ++a) out[a] = y[a] * scale / 4 + 0.5f;
}

constexpr float MAX_LOG_DENSITY = 8.0f;

// Edges (count + 1) of intervals behind the volume, as fractions of disparity, with equal shares of the weights of
// `places` densities at even places; cdf (places + 1) is scratch.
inline void find_background_edges(const float *density, int places, int count, float *cdf, float *edges) {
    float before = 0, total = 0;
    for (int k = 0; k < places; ++k) {
        const float depth_of = density[k] / static_cast<float>(places);
        cdf[k + 1] = exp_of(-before) * opacity_of(depth_of) + 1e-3f;
        total += cdf[k + 1];
        before += depth_of;
    }
    cdf[0] = edges[0] = 0;
    for (int k = 1; k <= places; ++k) cdf[k] = cdf[k - 1] + 0.8f * cdf[k] / total + 0.2f / static_cast<float>(places);
    int j = 1;
    for (int k = 1; k <= count; ++k) {
        const float target = static_cast<float>(k) / static_cast<float>(count) * cdf[places];
        while (j < places && cdf[j] <= target) ++j;
        edges[k] = (static_cast<float>(j - 1) + (target - cdf[j - 1]) / (cdf[j] - cdf[j - 1])) /
                   static_cast<float>(places);
    }
}

} // namespace
