// Ray proposals. The specification is plain torch, in core/ops/propose.py and core/ops/quantiles.py.
#include "simd.h"
#include "variant.h"

#include <cmath>

namespace {

constexpr int BLOCK = 64;

// A ray that steps through the voxels.
struct VoxelRay {
    const float *o, *d;
    const uint8_t *voxels;
    const int32_t *shape;
    const float *lower;
    float inverse, near, step;

    // Values (BLOCK) of the voxels at the centres of the steps from `first` on, 0 outside the grid. Returns whether
    // one is not 0.
    bool values(int64_t first, uint8_t *value) const {
        int32_t cell[3][BLOCK], inside[BLOCK];
        for (int i = 0; i < BLOCK; ++i) inside[i] = 1;
        for (int a = 0; a < 3; ++a) {
            const float origin = o[a] - lower[a], along = d[a], end = static_cast<float>(shape[a]);
            for (int i = 0; i < BLOCK; ++i) {
                const float t = near + (static_cast<float>(static_cast<int32_t>(first) + i) + 0.5f) * step;
                const float x = (origin + t * along) * inverse;
                const int32_t in = (x >= 0.0f) & (x < end);
                cell[a][i] = static_cast<int32_t>(in ? x : 0.0f);
                inside[i] &= in;
            }
        }
        uint8_t any = 0;
        for (int i = 0; i < BLOCK; ++i) {
            const int64_t row = static_cast<int64_t>(cell[0][i]) * shape[1] + cell[1][i];
            value[i] = voxels[row * shape[2] + cell[2][i]] & static_cast<uint8_t>(-inside[i]);
            any |= value[i];
        }
        return any != 0;
    }
};

} // namespace

// Finds the occupied voxels along each ray, and `count` places in them by inverse CDF.
//
// A ray is divided into steps of `step` from t_near[r] on. The voxel at the centre of a step has a value p in 0..1
// (uint8 / 255), and the step has the mass p * exp(-decay * step * sum of earlier p). u (n, count) in 0..1,
// increasing along each row, are the quantiles. t (n, count); mass (n) is the sum of the masses, 0 where a ray hits
// no occupied voxel (its t are then even between near and far).
extern "C" int UNISIM_NAME(unisim_propose)(const float *origins, const float *directions, const float *t_near,
                                           const float *t_far, int64_t n, const uint8_t *voxels, const int32_t *shape,
                                           const float *lower, const float *voxel_m, float step, float decay,
                                           const float *u, int count, float *t, float *mass, int threads) {
    parallel_blocks(n, 64, threads, [&](int64_t begin, int64_t end) {
        std::vector<float> cdf; // of all steps: where a voxel is free it stays as it is
        uint8_t value[BLOCK];
        for (int64_t r = begin; r < end; ++r) {
            const VoxelRay ray{origins + r * 3, directions + r * 3, voxels,    shape,
                               lower,           1.0f / voxel_m[0],  t_near[r], step};
            const float span = t_far[r] - t_near[r];
            const int64_t steps = span > 0 ? static_cast<int64_t>(std::ceil(span / step)) : 0;
            float total = 0, depth = 0;
            int64_t last = 0; // occupied step
            cdf.resize(static_cast<size_t>((steps + BLOCK - 1) / BLOCK * BLOCK));
            for (int64_t first = 0; first < steps; first += BLOCK) {
                float p[BLOCK], before[BLOCK], *sums = &cdf[static_cast<size_t>(first)];
                if (!ray.values(first, value)) {
                    std::fill(sums, sums + BLOCK, total);
                    continue;
                }
                const int64_t inside = std::min<int64_t>(BLOCK, steps - first);
                for (int64_t i = 0; i < BLOCK; ++i)
                    p[i] = i < inside ? static_cast<float>(value[i]) * (1.0f / 255.0f) : 0.0f;
                for (int64_t i = 0; i < BLOCK; ++i) {
                    before[i] = depth;
                    depth += p[i];
                }
                for (int64_t i = 0; i < BLOCK; ++i) p[i] *= exp_of(-decay * step * before[i]);
                for (int64_t i = 0; i < BLOCK; ++i) {
                    total += p[i];
                    sums[i] = total;
                    last = p[i] > 0 ? first + i : last;
                }
            }
            mass[r] = total;
            const float *ur = u + r * count;
            if (total <= 0) {
                for (int k = 0; k < count; ++k) t[r * count + k] = t_near[r] + ur[k] * std::max(span, 0.0f);
                continue;
            }
            int64_t j = 0;
            for (int k = 0; k < count; ++k) {
                const float target = ur[k] * total;
                while (j < last && cdf[j] <= target) ++j;
                const float before = j ? cdf[j - 1] : 0.0f;
                const float fraction = std::min(std::max((target - before) / (cdf[j] - before), 0.0f), 1.0f);
                t[r * count + k] = t_near[r] + (static_cast<float>(j) + fraction) * step;
            }
        }
    });
    return 0;
}

// Quantiles out (n, count) near the surface of signed distances s (n, k), metres, at places t (n, k), metres, and
// quantiles u (n, k), by the weights of the logistic density of sharpness beta. The fraction `uniform` of the weight is
// distributed evenly over the quantiles. jitter (n, count) in 0..1 increases along each row.
extern "C" int UNISIM_NAME(unisim_refine)(const float *u, const float *t, const float *s, int64_t n, int k, float beta,
                                          float uniform, const float *jitter, int count, float *out, int threads) {
    parallel_blocks(n, 64, threads, [&](int64_t begin, int64_t end) {
        const size_t size = static_cast<size_t>(k) + 1;
        std::vector<float> tau(size), weight(size), edge(size + 1);
        std::vector<double> cdf(size + 1); // sums in double, as torch has them: flat parts enlarge their error
        for (int64_t r = begin; r < end; ++r) {
            const float *ur = u + r * k, *tr = t + r * k, *sr = s + r * k;
            tau[0] = softplus(-beta * sr[0]);
            for (int i = 1; i < k; ++i) {
                const float sharp = min_of(4.0f / max_of(tr[i] - tr[i - 1], 1e-4f), beta);
                tau[i] = max_of(0.0f, softplus(-sharp * sr[i]) - softplus(-sharp * sr[i - 1]));
            }
            double depth = 0;
            for (int i = 0; i < k; ++i) {
                weight[i] = static_cast<float>(-depth);
                depth += tau[i];
            }
            for (int i = 0; i < k; ++i) weight[i] = exp_of(weight[i]) * opacity_of(tau[i]) + 1e-5f;
            weight[k] = 1e-5f;
            double total = 0;
            for (int i = 0; i <= k; ++i) total += weight[i];
            // the ends of [0, 1] belong to the first and last interval
            edge[0] = cdf[0] = 0;
            edge[k + 1] = 1;
            for (int i = 0; i < k; ++i) edge[i + 1] = ur[i];
            for (int i = 0; i <= k; ++i)
                cdf[i + 1] = cdf[i] + (1.0 - uniform) * weight[i] / total + uniform * (edge[i + 1] - edge[i]);
            int j = 1;
            for (int c = 0; c < count; ++c) {
                const double target = jitter[r * count + c] * cdf[k + 1];
                while (j <= k && cdf[j] <= target) ++j;
                const double fraction = (target - cdf[j - 1]) / max_of(cdf[j] - cdf[j - 1], 1e-12);
                out[r * count + c] = edge[j - 1] + static_cast<float>(fraction) * (edge[j] - edge[j - 1]);
            }
        }
    });
    return 0;
}
