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
    const int_lanes shape[3] = {scene.voxel_shape[0] - int_lanes{}, scene.voxel_shape[1] - int_lanes{}, scene.voxel_shape[2] - int_lanes{}};
    float ramp[LANES];
    for (int k = 0; k < LANES; ++k) ramp[k] = static_cast<float>(k) + 0.5f;
    float total = 0, depth = 0;
    for (int32_t i = 0; i < steps;) {
        // one vector of steps: they do not wait for each other
        const lanes t = t_near + (static_cast<float>(i) + load(ramp)) * step;
        int_lanes cell{}, inside = ~int_lanes{};
        for (int a = 0; a < 3; ++a) {
            // truncation is the floor where the result is not negative; what lies before 0 is outside
            const lanes x = (o[a] + t * d[a]) * inverse;
            const int_lanes c = __builtin_convertvector(x, int_lanes);
            inside &= (x >= 0.0f) & (c < shape[a]);
            cell = cell * shape[a] + c;
        }
        cell &= inside;
        int32_t at[LANES], in[LANES], next = LANES, found = 0;
        std::memcpy(at, &cell, sizeof at);
        std::memcpy(in, &inside, sizeof in);
        uint8_t clear[LANES];
        for (int k = 0; k < LANES; ++k) clear[k] = in[k] ? scene.clearance[at[k]] : 1;
        for (int k = 0; k < LANES; ++k) found |= !clear[k];
        for (int k = 0; k < LANES; ++k) next = std::max(next, k + static_cast<int32_t>(static_cast<float>(clear[k] - 1) * steps_a_voxel));
        for (int k = 0; found && k < std::min(LANES, steps - i); ++k) {
            if (clear[k]) continue;
            const float p = static_cast<float>(scene.voxels[at[k]]) * (1.0f / 255.0f);
            total += p * std::exp(-scene.decay_per_m * step * depth);
            depth += p;
            out.mass.push_back(total);
            out.step.push_back(i + k);
        }
        i += next;
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
