// Where along a ray samples are placed: quantiles of the occupied voxels along it, and those near the surface that a few signed
// distances point to. `core/ops/march.py` says what these are, in plain torch.
#pragma once
#include "lanes.h"
#include "variant.h"

#include <cmath>

namespace {

// The occupied steps of one ray and their summed mass.
struct Occupied {
    std::vector<int32_t> step;
    std::vector<float> mass;

    float total() const { return mass.empty() ? 0.0f : mass.back(); }
};

// Steps of half a voxel through what is not free.
inline void find_occupied(const unisim_scene &scene, const float *o, const float *d, float t_near, float t_far, Occupied &out) {
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
}

// Places t (count), `stride` apart, of rising quantiles u (count), `stride` apart.
inline void place_in(const Occupied &in, float step, float t_near, const float *u, int count, int stride, float *t) {
    size_t j = 0;
    for (int k = 0; k < count; ++k) {
        const float target = u[k * stride] * in.total();
        while (j + 1 < in.mass.size() && in.mass[j] <= target) ++j;
        const float before = j ? in.mass[j - 1] : 0.0f;
        const float fraction = std::fmin(std::fmax((target - before) / (in.mass[j] - before), 0.0f), 1.0f);
        t[k * stride] = t_near + (static_cast<float>(in.step[j]) + fraction) * step;
    }
}

// Summed shares (places + 1, stride) of what stops rays before, between and behind `places` samples, from the optical depths
// tau (places, stride): sample 0's own, then the intervals'. `even` of it is spread over the quantiles.
inline void sum_shares(const float *tau, int places, int stride, float even, float *share) {
    constexpr float LEAST = 1e-5f;
    for (int p = 0; p < stride; p += LANES) {
        lanes before{}, total{};
        for (int k = 0; k <= places; ++k) {
            lanes weight = spread(LEAST);
            if (k < places) {
                const lanes depth = load(tau + k * stride + p);
                weight += exp_of(-before) * stopped_by(depth);
                before += depth;
            }
            total += weight;
            store(share + k * stride + p, weight);
        }
        const lanes scale = (1.0f - even) / total;
        lanes sum{};
        for (int k = 0; k <= places; ++k) {
            const float width = (k == 0 || k == places ? 0.5f : 1.0f) / static_cast<float>(places);
            sum += load(share + k * stride + p) * scale + even * width;
            store(share + k * stride + p, sum);
        }
    }
}

// The middles of `count` equal parts of what `sum_shares` summed for one ray, as quantiles (count), `stride` apart.
inline void invert_shares(const float *share, int places, int stride, int count, float *u) {
    const float total = share[places * stride];
    int k = 0;
    for (int j = 0; j < count; ++j) {
        const float target = (static_cast<float>(j) + 0.5f) / static_cast<float>(count) * total;
        while (k < places && share[k * stride] <= target) ++k;
        const float c0 = k ? share[(k - 1) * stride] : 0.0f, c1 = share[k * stride];
        const float e0 = k ? (static_cast<float>(k) - 0.5f) / static_cast<float>(places) : 0.0f;
        const float e1 = k == places ? 1.0f : (static_cast<float>(k) + 0.5f) / static_cast<float>(places);
        u[j * stride] = e0 + (target - c0) / std::fmax(c1 - c0, 1e-12f) * (e1 - e0);
    }
}

} // namespace
