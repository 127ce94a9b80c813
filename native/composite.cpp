// Compositing along rays, forward and backward. The functions are the plain torch ones in composite.py, which are the specification.
//
// A strand is one ray inside one medium, with `width` intervals; strands of one medium come as a group.
#include "lanes.h"
#include "variant.h"

namespace {

// Strands by ray: those of ray r are strand[first[r] .. first[r + 1]), in the order in which they were given.
struct ByRay {
    struct Strand {
        int32_t group;
        int64_t row;
    };
    std::vector<int64_t> first;
    std::vector<Strand> strand;

    ByRay(const unisim_strands *groups, int count, int64_t rays) : first(static_cast<size_t>(rays) + 1, 0) {
        for (int g = 0; g < count; ++g)
            for (int64_t i = 0; i < groups[g].n; ++i) ++first[groups[g].ray[i] + 1];
        for (int64_t r = 0; r < rays; ++r) first[r + 1] += first[r];
        strand.resize(static_cast<size_t>(first[rays]));
        std::vector<int64_t> next(first.begin(), first.end() - 1);
        for (int g = 0; g < count; ++g)
            for (int64_t i = 0; i < groups[g].n; ++i) strand[next[groups[g].ray[i]]++] = {g, i};
    }
};

struct Interval {
    float place;
    int32_t group;
    int64_t at;
};

// The intervals of one ray in order of the depth where a ray that stops in them is expected to.
void in_order(const unisim_strands *groups, const ByRay &by_ray, int64_t ray, std::vector<Interval> &intervals) {
    intervals.clear();
    const int64_t begin = by_ray.first[ray], end = by_ray.first[ray + 1];
    for (int64_t m = begin; m < end; ++m) {
        const unisim_strands &g = groups[by_ray.strand[m].group];
        const int64_t at = by_ray.strand[m].row * g.width;
        for (int k = 0; k < g.width; ++k) {
            const float near = g.t[at + (k ? k - 1 : 0)], alpha = stopped_by(g.tau[at + k]);
            const float inside = alpha > 1e-4f ? g.share[at + k] / alpha : 0.5f;
            intervals.push_back({near + inside * (g.t[at + k] - near), by_ray.strand[m].group, at + k});
        }
    }
    if (end - begin > 1)
        std::stable_sort(intervals.begin(), intervals.end(), [](const Interval &a, const Interval &b) { return a.place < b.place; });
}

} // namespace

// front (n, width) of every group: the transmittance in front of each interval, all media of a ray in one order of depth.
extern "C" int UNISIM_NAME(unisim_transmittances_forward)(const unisim_strands *groups, int count, int64_t rays, float *const *front,
                                                          int threads) {
    const ByRay by_ray(groups, count, rays);
    parallel_blocks(rays, 256, threads, [&](int64_t begin, int64_t end) {
        std::vector<Interval> intervals;
        for (int64_t r = begin; r < end; ++r) {
            const int64_t members = by_ray.first[r + 1] - by_ray.first[r];
            double before = 0;
            if (members == 1) {
                const ByRay::Strand &one = by_ray.strand[by_ray.first[r]];
                const unisim_strands &g = groups[one.group];
                for (int64_t i = one.row * g.width; i < (one.row + 1) * g.width; ++i) {
                    front[one.group][i] = static_cast<float>(-before);
                    before += g.tau[i];
                }
            } else {
                in_order(groups, by_ray, r, intervals);
                for (const Interval &x : intervals) {
                    front[x.group][x.at] = static_cast<float>(-before);
                    before += groups[x.group].tau[x.at];
                }
            }
        }
    });
    for (int g = 0; g < count; ++g)
        parallel_blocks(groups[g].n * groups[g].width, 4096, threads, [&](int64_t begin, int64_t end) {
            for (int64_t i = begin; i < end; ++i) front[g][i] = exp_of(front[g][i]);
        });
    return 0;
}

// grad_tau (n, width) of every group, of what has the gradients grad_front (n, width) of `front`; the order is held.
extern "C" int UNISIM_NAME(unisim_transmittances_backward)(const unisim_strands *groups, int count, int64_t rays,
                                                           const float *const *front, const float *const *grad_front,
                                                           float *const *grad_tau, int threads) {
    const ByRay by_ray(groups, count, rays);
    parallel_blocks(rays, 256, threads, [&](int64_t begin, int64_t end) {
        std::vector<Interval> intervals;
        for (int64_t r = begin; r < end; ++r) {
            in_order(groups, by_ray, r, intervals);
            double behind = 0;
            for (auto x = intervals.rbegin(); x != intervals.rend(); ++x) {
                grad_tau[x->group][x->at] = static_cast<float>(-behind);
                behind += static_cast<double>(grad_front[x->group][x->at]) * front[x->group][x->at];
            }
        }
    });
    return 0;
}

// What strands (n) of `width` samples give: weights of intervals and of samples (n, width), and of each strand sums (n, features + 3):
// features by weight, the weight, distance by weight, optical depth. A sample's features are `stride` numbers apart.
extern "C" int UNISIM_NAME(unisim_gather_forward)(const unisim_strands *g, const float *front, const float *features, int64_t stride,
                                                  int length, float *interval, float *weight, float *sums, int threads) {
    const int k = g->width;
    parallel_blocks(g->n, 64, threads, [&](int64_t begin, int64_t end) {
        for (int64_t i = begin * k; i < end * k; ++i) interval[i] = front[i] * stopped_by(g->tau[i]);
        for (int64_t r = begin; r < end; ++r) {
            float *sum = sums + r * (length + 3);
            for (int f = 0; f < length; ++f) sum[f] = 0;
            // many thin intervals add up to what each alone would be lost in
            double whole = 0, far = 0, depth = 0;
            for (int j = 0; j < k; ++j) {
                const int64_t i = r * k + j;
                // an interval's weight goes to the samples at its two ends; interval 0 has only its own
                float w = front[i] * g->share[i] + (j ? 0.0f : interval[i]);
                if (j + 1 < k) w += interval[i + 1] - front[i + 1] * g->share[i + 1];
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

// The above's gradients with respect to tau, share, front (n, width) and features (n, width, length), from those of what it gives.
extern "C" int UNISIM_NAME(unisim_gather_backward)(const unisim_strands *g, const float *front, const float *features, int64_t stride,
                                                   int length, const float *weight, const float *grad_interval,
                                                   const float *grad_weight, const float *grad_sums, float *grad_tau,
                                                   float *grad_share, float *grad_front, float *grad_features, int threads) {
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
                grad_front[i] = far * g->share[i] + whole * stopped_by(g->tau[i]);
                grad_share[i] = far * front[i];
                grad_tau[i] = whole * front[i] * exp_of(-g->tau[i]) + sum[length + 2];
            }
        }
    });
    return 0;
}
