// Compositing along rays, forward and backward. The specification is plain torch, in core/ops/transmittances.py and
// core/ops/gather.py.
//
// A ray segment is one ray inside one field, with `width` intervals. Segments of one field come as a group.
#include "simd.h"
#include "variant.h"

namespace {

// Segments by ray: those of ray r are segment[first[r] .. first[r + 1]), in the order of the groups and their rows.
struct ByRay {
    struct Segment {
        int32_t group;
        int64_t row;
    };
    std::vector<int64_t> first;
    std::vector<Segment> segment;

    ByRay(const unisim_ray_segments *groups, int count, int64_t rays) : first(static_cast<size_t>(rays) + 1, 0) {
        for (int g = 0; g < count; ++g)
            for (int64_t i = 0; i < groups[g].n; ++i) ++first[groups[g].ray[i] + 1];
        for (int64_t r = 0; r < rays; ++r) first[r + 1] += first[r];
        segment.resize(static_cast<size_t>(first[rays]));
        std::vector<int64_t> next(first.begin(), first.end() - 1);
        for (int g = 0; g < count; ++g)
            for (int64_t i = 0; i < groups[g].n; ++i) segment[next[groups[g].ray[i]]++] = {g, i};
    }
};

struct Interval {
    float stop;
    int32_t group;
    int64_t at;
};

// The intervals of one ray, sorted by where a ray that stops in an interval is expected to stop.
void sort_intervals(const unisim_ray_segments *groups, const ByRay &by_ray, int64_t ray,
                    std::vector<Interval> &intervals) {
    intervals.clear();
    const int64_t begin = by_ray.first[ray], end = by_ray.first[ray + 1];
    for (int64_t m = begin; m < end; ++m) {
        const unisim_ray_segments &g = groups[by_ray.segment[m].group];
        const int64_t at = by_ray.segment[m].row * g.width;
        for (int k = 0; k < g.width; ++k) {
            const float near = g.t[at + (k ? k - 1 : 0)], alpha = opacity_of(g.tau[at + k]);
            const float inside = alpha > 1e-4f ? g.stop_fraction[at + k] / alpha : 0.5f;
            intervals.push_back({near + inside * (g.t[at + k] - near), by_ray.segment[m].group, at + k});
        }
    }
    if (end - begin > 1)
        std::stable_sort(intervals.begin(), intervals.end(),
                         [](const Interval &a, const Interval &b) { return a.stop < b.stop; });
}

} // namespace

// before (n, width) of every group: the transmittance before each interval, with all fields of a ray in one order of
// depth.
extern "C" int UNISIM_NAME(unisim_transmittances_forward)(const unisim_ray_segments *groups, int count, int64_t rays,
                                                          float *const *before, int threads) {
    const ByRay by_ray(groups, count, rays);
    parallel_blocks(rays, 256, threads, [&](int64_t begin, int64_t end) {
        std::vector<Interval> intervals;
        for (int64_t r = begin; r < end; ++r) {
            const int64_t members = by_ray.first[r + 1] - by_ray.first[r];
            double depth = 0;
            if (members == 1) {
                const ByRay::Segment &one = by_ray.segment[by_ray.first[r]];
                const unisim_ray_segments &g = groups[one.group];
                for (int64_t i = one.row * g.width; i < (one.row + 1) * g.width; ++i) {
                    before[one.group][i] = static_cast<float>(-depth);
                    depth += g.tau[i];
                }
            } else {
                sort_intervals(groups, by_ray, r, intervals);
                for (const Interval &x : intervals) {
                    before[x.group][x.at] = static_cast<float>(-depth);
                    depth += groups[x.group].tau[x.at];
                }
            }
        }
    });
    for (int g = 0; g < count; ++g)
        parallel_blocks(groups[g].n * groups[g].width, 4096, threads, [&](int64_t begin, int64_t end) {
            for (int64_t i = begin; i < end; ++i) before[g][i] = exp_of(before[g][i]);
        });
    return 0;
}

// grad_tau (n, width) of every group, from the gradients grad_before (n, width) of `before`; the order is constant.
extern "C" int UNISIM_NAME(unisim_transmittances_backward)(const unisim_ray_segments *groups, int count, int64_t rays,
                                                           const float *const *before, const float *const *grad_before,
                                                           float *const *grad_tau, int threads) {
    const ByRay by_ray(groups, count, rays);
    parallel_blocks(rays, 256, threads, [&](int64_t begin, int64_t end) {
        std::vector<Interval> intervals;
        for (int64_t r = begin; r < end; ++r) {
            sort_intervals(groups, by_ray, r, intervals);
            double behind = 0;
            for (auto x = intervals.rbegin(); x != intervals.rend(); ++x) {
                grad_tau[x->group][x->at] = static_cast<float>(-behind);
                behind += static_cast<double>(grad_before[x->group][x->at]) * before[x->group][x->at];
            }
        }
    });
    return 0;
}

// Of segments (n) with `width` samples: weights of intervals and of samples (n, width), and sums (n, length + 3) of
// features by weight, weight, distance by weight, and optical depth. The features of successive samples are `stride`
// numbers apart.
extern "C" int UNISIM_NAME(unisim_gather_forward)(const unisim_ray_segments *g, const float *before,
                                                  const float *features, int64_t stride, int length, float *interval,
                                                  float *weight, float *sums, int threads) {
    const int k = g->width;
    parallel_blocks(g->n, 64, threads, [&](int64_t begin, int64_t end) {
        for (int64_t i = begin * k; i < end * k; ++i) interval[i] = before[i] * opacity_of(g->tau[i]);
        for (int64_t r = begin; r < end; ++r) {
            float *sum = sums + r * (length + 3);
            for (int f = 0; f < length; ++f) sum[f] = 0;
            // float64: many thin intervals would be lost to rounding one by one
            double whole = 0, far = 0, depth = 0;
            for (int j = 0; j < k; ++j) {
                const int64_t i = r * k + j;
                // an interval's weight is divided between the samples at its two ends; interval 0 has one sample
                float w = before[i] * g->stop_fraction[i] + (j ? 0.0f : interval[i]);
                if (j + 1 < k) w += interval[i + 1] - before[i + 1] * g->stop_fraction[i + 1];
                weight[i] = w;
                const float *feature = features + i * stride;
                for (int f = 0; f < length; ++f) sum[f] += w * feature[f];
                whole += w;
                far += w * g->t[i];
                depth += g->tau[i];
            }
            sum[length] = static_cast<float>(whole);
            sum[length + 1] = static_cast<float>(far);
            sum[length + 2] = static_cast<float>(depth);
        }
    });
    return 0;
}

// Gradients of `gather_forward` with respect to tau, stop fraction, before (n, width) and features (n, width, length).
extern "C" int UNISIM_NAME(unisim_gather_backward)(const unisim_ray_segments *g, const float *before,
                                                   const float *features, int64_t stride, int length,
                                                   const float *weight, const float *grad_interval,
                                                   const float *grad_weight, const float *grad_sums, float *grad_tau,
                                                   float *grad_stop_fraction, float *grad_before, float *grad_features,
                                                   int threads) {
    const int k = g->width;
    parallel_blocks(g->n, 64, threads, [&](int64_t begin, int64_t end) {
        std::vector<float> of_weight(static_cast<size_t>(k));
        for (int64_t r = begin; r < end; ++r) {
            const float *sum = grad_sums + r * (length + 3);
            for (int j = 0; j < k; ++j) {
                const int64_t i = r * k + j;
                const float *feature = features + i * stride;
                float *out = grad_features + i * length, dot = 0;
                for (int f = 0; f < length; ++f) {
                    dot += sum[f] * feature[f];
                    out[f] = weight[i] * sum[f];
                }
                of_weight[j] = dot + sum[length] + sum[length + 1] * g->t[i] + grad_weight[i];
            }
            for (int j = 0; j < k; ++j) {
                const int64_t i = r * k + j;
                const float near = of_weight[j ? j - 1 : 0], far = j ? of_weight[j] - near : of_weight[0];
                const float whole = grad_interval[i] + near;
                grad_before[i] = far * g->stop_fraction[i] + whole * opacity_of(g->tau[i]);
                grad_stop_fraction[i] = far * before[i];
                grad_tau[i] = whole * before[i] * exp_of(-g->tau[i]) + sum[length + 2];
            }
        }
    });
    return 0;
}
