// The strands of one medium in a tile of rays: their samples, what the field says there, and what of a ray they stop.
//
// Sample k of strand p is number k * stride + p, so that a vector holds one sample of many strands.
#pragma once
#include "boxes.h"
#include "field_tile.h"

namespace {

enum class Medium { fixed, actor, copy, mesh };

struct Batch {
    Medium medium = Medium::fixed;
    int troupe = -1, count = 0, stride = 0, samples = 0;
    std::vector<int> ray, box, last; // last: samples of a strand before the ones that nothing reaches
    std::vector<float> o, d, t_near, t_far, size; // o, d, size (count, 3) in the medium's coordinates, metres
    std::vector<float> rotation;                  // (count, 9): what turns the medium's normals into the world's
    std::vector<float> stretch;                   // the medium's metres for each metre along the ray; padded to `stride` by `lay`
    std::vector<float> t, s, tau, share, front, weight;
    std::vector<int> slot;     // of a sample's hidden units, -1 where they were not asked for
    size_t slots = 0;
    std::vector<float> units;  // (slots, wide)

    void begin(Medium kind, int owner) {
        medium = kind;
        troupe = owner;
        count = 0;
        for (auto *v : {&ray, &box}) v->clear();
        for (auto *v : {&o, &d, &t_near, &t_far, &size, &rotation, &stretch}) v->clear();
    }

    void add(int ray_of, int box_of, const float *origin, const float *direction, float near, float far, const float *size_of,
             const float *turn, float longer = 1.0f) {
        ray.push_back(ray_of);
        box.push_back(box_of);
        o.insert(o.end(), origin, origin + 3);
        d.insert(d.end(), direction, direction + 3);
        size.insert(size.end(), size_of, size_of + 3);
        rotation.insert(rotation.end(), turn, turn + 9);
        t_near.push_back(near);
        t_far.push_back(far);
        stretch.push_back(longer);
        ++count;
    }

    // Takes back what was added last.
    void drop() {
        --count;
        for (auto *v : {&ray, &box}) v->pop_back();
        for (auto *v : {&o, &d, &size}) v->resize(v->size() - 3);
        rotation.resize(rotation.size() - 9);
        for (auto *v : {&t_near, &t_far, &stretch}) v->pop_back();
    }

    // Room for k samples a strand, and no units yet.
    void sample(int k) {
        lay(k);
        slots = 0;
    }

    // Room for k samples a strand. What is behind the last strand keeps lanes busy and is never read.
    void lay(int k) {
        samples = k;
        stride = (count + LANES - 1) / LANES * LANES;
        const size_t n = static_cast<size_t>(stride) * k;
        for (auto *v : {&t, &s, &tau, &share, &front, &weight}) v->assign(n, 0.0f);
        slot.assign(n, -1);
        last.assign(count, 0);
        stretch.resize(static_cast<size_t>(stride), 1.0f);
    }
};

// Optical depths and shares of intervals `from` to before `to`; `core/ops/density.py` says what these are. `widened` bounds the
// sharpness by an interval's length, for samples that only say where others shall be.
inline void find_depths(Batch &b, int from, int to, float beta, bool widened) {
    for (int k = from; k < to; ++k)
        for (int p = 0; p < b.stride; p += LANES) {
            const int64_t i = static_cast<int64_t>(k) * b.stride + p;
            const lanes s = load(&b.s[i]);
            if (k == 0) {
                store(&b.tau[i], softplus(-beta * s));
                continue;
            }
            const lanes s0 = load(&b.s[i - b.stride]);
            lanes sharp = spread(beta);
            if (widened) sharp = least(sharp, 4.0f / most((load(&b.t[i]) - load(&b.t[i - b.stride])) * load(&b.stretch[p]), spread(1e-4f)));
            const lanes outside0 = softplus(-sharp * s0), rise = softplus(-sharp * s) - outside0, tau = most(rise, lanes{});
            store(&b.tau[i], tau);
            if (widened) continue;
            const lanes slope = beta * (s0 - s), steep = slope > 0.0f ? slope : -slope;
            const lanes safe = steep < 1e-2f ? spread(1.0f) : slope;
            // the mean transmittance over the interval; behind the surface the difference would cancel
            lanes mean = (slope - rise) / safe * exp_of(least(outside0, spread(5.0f)));
            const lanes deep = most(safe, spread(1e-2f));
            mean = outside0 > 5.0f ? stopped_by(deep) / deep : mean;
            const lanes alpha = stopped_by(tau);
            mean = steep < 1e-2f ? 1.0f - alpha / 2.0f : mean;
            store(&b.share[i], least(most(mean - exp_of(-tau), lanes{}), alpha));
        }
}

// The same for the paper's density, in steps of `step_m`.
inline void find_paper_depths(Batch &b, int from, int to, float beta, float step_m) {
    for (int k = from; k < to; ++k)
        for (int p = 0; p < b.stride; p += LANES) {
            const int64_t i = static_cast<int64_t>(k) * b.stride + p;
            const lanes length = k ? (load(&b.t[i]) - load(&b.t[i - b.stride])) * load(&b.stretch[p]) / step_m : spread(1.0f);
            const lanes tau = softplus(-beta * load(&b.s[i])) * length;
            store(&b.tau[i], tau);
            store(&b.share[i], k ? stopped_by(tau) : lanes{});
        }
}

// Transmittances in front of the intervals of strands that are alone on their rays.
inline void find_fronts(Batch &b) {
    for (int p = 0; p < b.stride; p += LANES) {
        // what the sum's rounding takes away is added with the next interval: many thin ones would be lost one by one
        lanes before{}, lost{};
        for (int k = 0; k < b.samples; ++k) {
            const int64_t i = static_cast<int64_t>(k) * b.stride + p;
            store(&b.front[i], exp_of(-before));
            const lanes depth = load(&b.tau[i]) + lost, sum = before + depth;
            lost = depth - (sum - before);
            before = sum;
        }
    }
}

// Weights of the samples: an interval's goes to the samples at its two ends.
inline void find_weights(Batch &b) {
    for (int p = 0; p < b.stride; p += LANES) {
        lanes near_part{};
        for (int k = b.samples - 1; k >= 0; --k) {
            const int64_t i = static_cast<int64_t>(k) * b.stride + p;
            const lanes front = load(&b.front[i]), interval = front * stopped_by(load(&b.tau[i])), far_part = front * load(&b.share[i]);
            // interval 0 has no length: all of it is its sample's
            store(&b.weight[i], (k ? far_part : interval) + near_part);
            near_part = interval - far_part;
        }
    }
}

struct Strand {
    Batch *batch;
    int p;
};

// The sample of strand p that weighs most.
inline int heaviest(const Batch &b, int p) {
    int best = 0;
    for (int k = 1; k < b.samples; ++k)
        if (b.weight[static_cast<size_t>(k * b.stride + p)] > b.weight[static_cast<size_t>(best * b.stride + p)]) best = k;
    return best;
}

inline float weight_of(const Batch &b, int p) {
    float sum = 0;
    for (int k = 0; k < b.samples; ++k) sum += b.weight[static_cast<size_t>(k * b.stride + p)];
    return sum;
}

// Transmittances in front of the intervals of all strands of one ray, in one order of depth: by where a ray that stops in an
// interval is expected to. Returns the optical depth of all.
inline float merge_fronts(const std::vector<Strand> &strands, std::vector<int> &next, std::vector<float> &stops) {
    constexpr float END = 3.4e38f;
    const auto stop_of = [](const Batch &b, int p, int k) {
        const int64_t i = static_cast<int64_t>(k) * b.stride + p;
        const float t = b.t[i], near = k ? b.t[i - b.stride] : t, alpha = stopped_by(b.tau[i]);
        return near + (alpha > 1e-4f ? b.share[i] / alpha : 0.5f) * (t - near);
    };
    next.assign(strands.size(), 0);
    stops.clear();
    for (const Strand &s : strands) stops.push_back(stop_of(*s.batch, s.p, 0));
    double before = 0; // many thin intervals would be lost one by one in float32
    for (;;) {
        size_t first = 0;
        for (size_t i = 1; i < strands.size(); ++i)
            if (stops[i] < stops[first]) first = i;
        if (stops[first] == END) return static_cast<float>(before);
        Batch &b = *strands[first].batch;
        const int k = next[first]++, p = strands[first].p;
        b.front[static_cast<int64_t>(k) * b.stride + p] = exp_of(-static_cast<float>(before));
        before += b.tau[static_cast<int64_t>(k) * b.stride + p];
        stops[first] = k + 1 < b.samples ? stop_of(b, p, k + 1) : END;
    }
}

// How far into interval k of a strand the transmittance falls to `wanted`, as a place along the ray; the distance is linear there.
inline float place_of(const Batch &b, int p, int k, float wanted, float beta, bool paper) {
    const int64_t i = static_cast<int64_t>(k) * b.stride + p;
    if (k == 0 || paper) return b.t[i];
    const float s1 = b.s[i - b.stride], s2 = b.s[i];
    const float a = -beta * s1, outside = std::fmax(a, 0.0f) + std::log1p(std::exp(-std::fabs(a)));
    // -log Phi at the place, then its distance: the inverse of softplus(-beta s)
    const float y = outside + std::log(b.front[i] / wanted);
    const float at = -(y + std::log(-std::expm1(-std::fmax(y, 1e-12f)))) / beta;
    const float share = std::fmin(std::fmax((s1 - at) / std::fmax(s1 - s2, 1e-9f), 0.0f), 1.0f);
    return b.t[i - b.stride] + share * (b.t[i] - b.t[i - b.stride]);
}

} // namespace
