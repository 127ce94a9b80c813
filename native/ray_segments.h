// Ray segments of a tile of rays, by kind. A ray segment is one ray inside one field, or at one intersection with a
// mesh.
//
// Segments of one kind come together: sample k of segment p is number k * stride + p, so that a vector holds one
// sample of many segments. Code for all kinds is a template or takes `Samples`; what differs is an overload for the
// kind.
#pragma once
#include "boxes.h"
#include "field_tile.h"

namespace {

// What all kinds have: which ray each segment belongs to, its samples, and their part in compositing.
struct Samples {
    int count = 0, stride = 0, samples = 0;
    bool foreign = false; // mesh actors, or actors of another scene: the scene's own decoder must not see them
    std::vector<int> ray; // (count)
    // (samples, stride): distance, signed distance, optical depth and stop fraction of the interval that ends at the
    // sample, transmittance before that interval, weight of the sample
    std::vector<float> t, s, tau, stop_fraction, transmittance_before, weight;
    std::vector<float> total_depth; // (stride): optical depths of whole segments

    size_t number(int k, int p) const { return static_cast<size_t>(k * stride + p); }

    // Room for k samples per segment. Samples of segments from `count` to `stride` fill up vectors and are never read.
    void allocate(int k) {
        samples = k;
        stride = (count + LANES - 1) / LANES * LANES;
        const size_t n = static_cast<size_t>(stride) * k;
        for (auto *v : {&t, &s, &tau, &stop_fraction, &transmittance_before, &weight}) v->assign(n, 0.0f);
    }

  protected:
    void clear() {
        count = 0;
        ray.clear();
    }
};

// A ray inside a field: origin and direction in the field's axes, metres, and the interval in it, metres along the
// ray.
struct FieldSegments : Samples {
    std::vector<float> o, d;          // (count, 3)
    std::vector<float> t_near, t_far; // (count)
    std::vector<int> evaluated;       // (count): samples before this one have been evaluated
    std::vector<int> slot;            // (samples, stride): of a sample's hidden units, -1 where these are not kept
    size_t slots = 0;
    std::vector<float> units;         // (slots, wide): hidden units

    // Room for k samples per segment; hidden units are kept.
    void allocate(int k) {
        Samples::allocate(k);
        slot.assign(t.size(), -1);
        evaluated.assign(static_cast<size_t>(count), 0);
    }

  protected:
    void clear() {
        Samples::clear();
        for (auto *v : {&o, &d, &t_near, &t_far}) v->clear();
    }

    void add(int ray_number, const float *origin, const float *direction, float near, float far) {
        ray.push_back(ray_number);
        o.insert(o.end(), origin, origin + 3);
        d.insert(d.end(), direction, direction + 3);
        t_near.push_back(near);
        t_far.push_back(far);
        ++count;
    }
};

// Rays inside the volume of the static field, in volume coordinates; at most one segment per ray.
struct StaticSegments : FieldSegments {
    void begin() { clear(); }

    using FieldSegments::add;

    void remove_last() {
        --count;
        ray.pop_back();
        for (auto *v : {&o, &d}) v->resize(v->size() - 3);
        for (auto *v : {&t_near, &t_far}) v->pop_back();
    }
};

// Rays inside copied boxes of static space: in the coordinates of the static field at the source of the copy.
struct CopySegments : FieldSegments {
    std::vector<float> rotation; // (count, 9): from the world's axes at the source to the world's axes at the copy

    void begin() {
        clear();
        rotation.clear();
    }

    void add(int ray_number, const float *origin, const float *direction, float near, float far, const float *turn) {
        FieldSegments::add(ray_number, origin, direction, near, far);
        rotation.insert(rotation.end(), turn, turn + 9);
    }
};

// Rays inside the boxes of one actor set, in the boxes' axes and the metres of the set's fields.
struct ActorSegments : FieldSegments {
    const unisim_actor_set *actors = nullptr;
    int set = 0;                 // the actor set's number
    std::vector<int> box;        // (count): the actor's number in the set
    std::vector<int32_t> row;    // (count): of the scene's actor grids
    std::vector<float> size;     // (count, 3): of the box
    std::vector<float> rotation; // (count, 9): takes the field's gradients to the world
    std::vector<float> stretch;  // (stride): field metres per metre along the ray

    void begin(const unisim_actor_set &actor_set, int number) {
        clear();
        actors = &actor_set;
        set = number;
        foreign = number > 0;
        box.clear();
        row.clear();
        for (auto *v : {&size, &rotation, &stretch}) v->clear();
    }

    void add(const BoxHit &hit) {
        FieldSegments::add(hit.ray, hit.o, hit.d, hit.t_near, hit.t_far);
        const float *edges = actors->sizes + 3 * hit.box;
        box.push_back(hit.box);
        row.push_back(hit.row);
        size.insert(size.end(), edges, edges + 3);
        rotation.insert(rotation.end(), hit.rotation, hit.rotation + 9);
        stretch.push_back(hit.stretch);
    }

    void allocate(int k) {
        FieldSegments::allocate(k);
        stretch.resize(static_cast<size_t>(stride), 1.0f);
    }
};

// Intersections with meshes: one sample each, at the surface.
struct MeshSegments : Samples {
    std::vector<int> actor;    // (count): the mesh actor's number
    std::vector<float> normal; // (count, 3), world frame

    void begin() {
        clear();
        foreign = true;
        actor.clear();
        normal.clear();
    }

    void add(int ray_number, int actor_number, const float *unit_normal) {
        ray.push_back(ray_number);
        actor.push_back(actor_number);
        normal.insert(normal.end(), unit_normal, unit_normal + 3);
        ++count;
    }
};

// Lengths of the intervals that end at the samples from number i on, a vector of segments from p on, in the field's
// metres.
inline simd_float lengths(const FieldSegments &b, int64_t i, int) { return load(&b.t[i]) - load(&b.t[i - b.stride]); }
inline simd_float lengths(const ActorSegments &b, int64_t i, int p) {
    return (load(&b.t[i]) - load(&b.t[i - b.stride])) * load(&b.stretch[p]);
}

// Field metres per metre along a ray.
inline float stretch_of(const FieldSegments &, size_t) { return 1.0f; }
inline float stretch_of(const ActorSegments &b, size_t p) { return b.stretch[p]; }

// Optical depths and stop fractions of intervals `from` to before `to`, see `core/ops/density.py`.
// `limit_sharpness` bounds the sharpness by the interval's length, for samples that only decide where others are
// placed; these get no stop fractions.
template <class Segments> void find_intervals(Segments &b, int from, int to, float beta, bool limit_sharpness) {
    for (int k = from; k < to; ++k)
        for (int p = 0; p < b.stride; p += LANES) {
            const int64_t i = static_cast<int64_t>(k) * b.stride + p;
            const simd_float s = load(&b.s[i]);
            if (k == 0) {
                store(&b.tau[i], softplus(-beta * s));
                continue;
            }
            const simd_float s0 = load(&b.s[i - b.stride]);
            simd_float sharpness = broadcast(beta);
            if (limit_sharpness) sharpness = min_of(sharpness, 4.0f / max_of(lengths(b, i, p), broadcast(1e-4f)));
            const simd_float outside0 = softplus(-sharpness * s0), rise = softplus(-sharpness * s) - outside0;
            const simd_float tau = max_of(rise, simd_float{});
            store(&b.tau[i], tau);
            if (limit_sharpness) continue;
            const simd_float slope = beta * (s0 - s), steep = slope > 0.0f ? slope : -slope;
            const simd_float safe = steep < 1e-2f ? broadcast(1.0f) : slope;
            // the mean transmittance over the interval; behind the surface the difference would cancel
            simd_float mean = (slope - rise) / safe * exp_of(min_of(outside0, broadcast(5.0f)));
            const simd_float deep = max_of(safe, broadcast(1e-2f));
            mean = outside0 > 5.0f ? opacity_of(deep) / deep : mean;
            const simd_float alpha = opacity_of(tau);
            mean = steep < 1e-2f ? 1.0f - alpha / 2.0f : mean;
            store(&b.stop_fraction[i], min_of(max_of(mean - exp_of(-tau), simd_float{}), alpha));
        }
}

// The same for the paper's density, in steps of `step_m`.
template <class Segments> void find_unisim_intervals(Segments &b, int from, int to, float beta, float step_m) {
    for (int k = from; k < to; ++k)
        for (int p = 0; p < b.stride; p += LANES) {
            const int64_t i = static_cast<int64_t>(k) * b.stride + p;
            const simd_float steps = k ? lengths(b, i, p) / step_m : broadcast(1.0f);
            const simd_float tau = softplus(-beta * load(&b.s[i])) * steps;
            store(&b.tau[i], tau);
            store(&b.stop_fraction[i], k ? opacity_of(tau) : simd_float{});
        }
}

// Transmittances before the intervals of segments, each as if it were the only one on its ray, and total depths.
inline void find_transmittances_alone(Samples &b) {
    b.total_depth.resize(static_cast<size_t>(b.stride));
    for (int p = 0; p < b.stride; p += LANES) {
        // compensated summation: many thin intervals would be lost to rounding one by one
        simd_float before{}, lost{};
        for (int k = 0; k < b.samples; ++k) {
            const int64_t i = static_cast<int64_t>(k) * b.stride + p;
            store(&b.transmittance_before[i], exp_of(-before));
            const simd_float depth = load(&b.tau[i]) + lost, sum = before + depth;
            lost = depth - (sum - before);
            before = sum;
        }
        store(&b.total_depth[static_cast<size_t>(p)], before);
    }
}

// Weights of the samples: an interval's weight is divided between the samples at its two ends.
inline void find_weights(Samples &b) {
    for (int p = 0; p < b.stride; p += LANES) {
        simd_float near_part{};
        for (int k = b.samples - 1; k >= 0; --k) {
            const int64_t i = static_cast<int64_t>(k) * b.stride + p;
            const simd_float before = load(&b.transmittance_before[i]), interval = before * opacity_of(load(&b.tau[i]));
            const simd_float far_part = before * load(&b.stop_fraction[i]);
            // interval 0 has no length: its whole weight belongs to its sample
            store(&b.weight[i], (k ? far_part : interval) + near_part);
            near_part = interval - far_part;
        }
    }
}

// One segment, of any kind.
struct SegmentRef {
    Samples *segments;
    int p;
};

// The sample of segment p with the largest weight.
inline int heaviest_sample(const Samples &b, int p) {
    int best = 0;
    for (int k = 1; k < b.samples; ++k)
        if (b.weight[b.number(k, p)] > b.weight[b.number(best, p)]) best = k;
    return best;
}

inline float weight_of(const Samples &b, int p) {
    float sum = 0;
    for (int k = 0; k < b.samples; ++k) sum += b.weight[b.number(k, p)];
    return sum;
}

// Transmittances before the intervals of all segments of one ray, in one order of depth: by where a ray that stops in
// an interval is expected to stop. Returns the optical depth of the whole ray.
inline float merge_by_depth(const std::vector<SegmentRef> &segments, std::vector<int> &next,
                            std::vector<float> &stops) {
    constexpr float END = 3.4e38f;
    const auto stop_of = [](const Samples &b, int p, int k) {
        const int64_t i = static_cast<int64_t>(k) * b.stride + p;
        const float t = b.t[i], near = k ? b.t[i - b.stride] : t, alpha = opacity_of(b.tau[i]);
        return near + (alpha > 1e-4f ? b.stop_fraction[i] / alpha : 0.5f) * (t - near);
    };
    next.assign(segments.size(), 0);
    stops.clear();
    for (const SegmentRef &s : segments) stops.push_back(stop_of(*s.segments, s.p, 0));
    double before = 0; // many thin intervals would be lost one by one in float32
    for (;;) {
        size_t first = 0;
        for (size_t i = 1; i < segments.size(); ++i)
            if (stops[i] < stops[first]) first = i;
        if (stops[first] == END) return static_cast<float>(before);
        Samples &b = *segments[first].segments;
        const int k = next[first]++, p = segments[first].p;
        b.transmittance_before[static_cast<int64_t>(k) * b.stride + p] = exp_of(-static_cast<float>(before));
        before += b.tau[static_cast<int64_t>(k) * b.stride + p];
        stops[first] = k + 1 < b.samples ? stop_of(b, p, k + 1) : END;
    }
}

// Where in interval k of segment p the transmittance falls to `wanted`, metres along the ray; the distance is linear
// there.
inline float crossing_of(const FieldSegments &b, int p, int k, float wanted, float beta, bool unisim_density) {
    const int64_t i = static_cast<int64_t>(k) * b.stride + p;
    if (k == 0 || unisim_density) return b.t[i];
    const float s1 = b.s[i - b.stride], s2 = b.s[i];
    const float a = -beta * s1, outside = std::fmax(a, 0.0f) + std::log1p(std::exp(-std::fabs(a)));
    // -log Phi at the crossing, then its distance: the inverse of softplus(-beta s)
    const float y = outside + std::log(b.transmittance_before[i] / wanted);
    const float at = -(y + std::log(-std::expm1(-std::fmax(y, 1e-12f)))) / beta;
    const float fraction = std::fmin(std::fmax((s1 - at) / std::fmax(s1 - s2, 1e-9f), 0.0f), 1.0f);
    return b.t[i - b.stride] + fraction * (b.t[i] - b.t[i - b.stride]);
}

} // namespace
