// Where along a ray samples are placed: quantiles of the occupied voxels along it, and those near the surface that a few signed
// distances point to. `core/march.py` says what these are, in plain torch.
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

// Steps of half a voxel through what is not free. `clearance` says how many steps meet nothing, without being looked at.
inline void find_occupied(const unisim_scene &scene, const float *o, const float *d, float t_near, float t_far, Occupied &out) {
    out.step.clear();
    out.mass.clear();
    const float step = scene.voxel_m / 2, inverse = 1.0f / scene.voxel_m;
    const float fastest = std::fmax(std::fabs(d[0]), std::fmax(std::fabs(d[1]), std::fabs(d[2])));
    // a little short of it, for rounding
    const float steps_a_voxel = fastest > 1e-6f ? 1.999f / fastest : 2.0f;
    const float span = t_far - t_near;
    const int32_t steps = span > 0 ? static_cast<int32_t>(std::ceil(span / step)) : 0;
    const int32_t *shape = scene.voxel_shape;
    float total = 0, depth = 0;
    for (int32_t i = 0; i < steps;) {
        const float t = t_near + (static_cast<float>(i) + 0.5f) * step;
        const int32_t a = static_cast<int32_t>(std::floor((o[0] + t * d[0]) * inverse));
        const int32_t b = static_cast<int32_t>(std::floor((o[1] + t * d[1]) * inverse));
        const int32_t c = static_cast<int32_t>(std::floor((o[2] + t * d[2]) * inverse));
        if (a < 0 || b < 0 || c < 0 || a >= shape[0] || b >= shape[1] || c >= shape[2]) {
            ++i;
            continue;
        }
        const int64_t cell = (static_cast<int64_t>(a) * shape[1] + b) * shape[2] + c;
        if (const int free = scene.clearance[cell]) {
            i += std::max(1, static_cast<int>(static_cast<float>(free - 1) * steps_a_voxel));
            continue;
        }
        const float p = static_cast<float>(scene.voxels[cell]) * (1.0f / 255.0f);
        total += p * std::exp(-scene.decay_per_m * step * depth);
        depth += p;
        out.mass.push_back(total);
        out.step.push_back(i);
        ++i;
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
