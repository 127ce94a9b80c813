// Intervals of the logistic density, forward and backward. The specification is plain torch, in core/ops/density.py,
// including its gradients at kinks and ties.
#include "simd.h"
#include "variant.h"

namespace {

constexpr int64_t ROWS = 64;
constexpr float FLAT = 1e-2f, DEEP = 5.0f;

// Intermediate values at the samples of a few rows; an interval lies between its own sample and the one before.
struct Samples {
    std::vector<float> a, outside;

    void fill(const float *s, int64_t n, float beta) {
        a.resize(static_cast<size_t>(n));
        outside.resize(a.size());
        for (int64_t i = 0; i < n; ++i) {
            a[i] = -beta * s[i];
            outside[i] = softplus(a[i]);
        }
    }
};

struct Mean {
    float slope, safe, e, surface, deep;
    bool is_flat, is_deep;
};

// Mean transmittance over an interval, in its three forms; `outside` belongs to the sample at the near end.
inline Mean mean_of(float slope, float rise, float outside) {
    Mean m;
    m.slope = slope;
    m.is_flat = slope < FLAT && slope > -FLAT;
    m.is_deep = outside > DEEP;
    m.safe = m.is_flat ? 1.0f : slope;
    m.e = exp_of(min_of(outside, DEEP));
    m.surface = (slope - rise) / m.safe * m.e;
    const float y = max_of(m.safe, FLAT);
    m.deep = opacity_of(y) / y;
    return m;
}

} // namespace

// tau and stop_fraction (n, k) of samples with signed distances s (n, k).
extern "C" int UNISIM_NAME(unisim_intervals_forward)(const float *s, int64_t n, int k, float beta, float *tau,
                                                     float *stop_fraction, int threads) {
    parallel_blocks(n, ROWS, threads, [&](int64_t begin, int64_t end) {
        const int64_t count = (end - begin) * k;
        float *t = tau + begin * k, *h = stop_fraction + begin * k;
        Samples x;
        x.fill(s + begin * k, count, beta);
        const float *a = x.a.data(), *outside = x.outside.data();
        for (int64_t i = 1; i < count; ++i) {
            const float rise = outside[i] - outside[i - 1];
            const Mean m = mean_of(a[i] - a[i - 1], rise, outside[i - 1]);
            const float depth = max_of(0.0f, rise), alpha = opacity_of(depth);
            float mean = m.is_deep ? m.deep : m.surface;
            mean = m.is_flat ? 1.0f - alpha / 2 : mean;
            t[i] = depth;
            h[i] = min_of(max_of(0.0f, mean - exp_of(-depth)), alpha);
        }
        for (int64_t i = 0; i < count; i += k) {
            t[i] = outside[i];
            h[i] = 0;
        }
    });
    return 0;
}

// grad_s (n, k) and grad_beta (1), from gradients grad_tau and grad_stop_fraction (n, k) of the function above.
extern "C" int UNISIM_NAME(unisim_intervals_backward)(const float *s, int64_t n, int k, float beta,
                                                      const float *grad_tau, const float *grad_stop_fraction,
                                                      float *grad_s, float *grad_beta, int threads) {
    // each block has its own sum, and these are added in order: the bits do not depend on the number of threads
    std::vector<double> sums(static_cast<size_t>((n + ROWS - 1) / ROWS), 0.0);
    parallel_blocks(n, ROWS, threads, [&](int64_t begin, int64_t end) {
        const int64_t count = (end - begin) * k;
        const float *g_tau = grad_tau + begin * k, *g_stop = grad_stop_fraction + begin * k;
        float *out = grad_s + begin * k;
        Samples x;
        x.fill(s + begin * k, count, beta);
        const float *a = x.a.data(), *outside = x.outside.data();
        // gradients of an interval with respect to `outside` and `a` at its two ends; those of the near end are
        // stored one place further on
        std::vector<float> far_o(static_cast<size_t>(count) + 1, 0.0f), near_o(far_o), slopes(far_o);
        for (int64_t i = 1; i < count; ++i) {
            const float rise = outside[i] - outside[i - 1];
            const Mean m = mean_of(a[i] - a[i - 1], rise, outside[i - 1]);
            const float depth = max_of(0.0f, rise), alpha = opacity_of(depth), left = exp_of(-depth);
            float mean = m.is_deep ? m.deep : m.surface;
            mean = m.is_flat ? 1.0f - alpha / 2 : mean;
            const float raw = mean - left, inside = max_of(0.0f, raw);
            float chosen = inside < alpha ? 1.0f : 0.0f;
            chosen = inside == alpha ? 0.5f : chosen;
            const float g_mean = raw >= 0.0f ? g_stop[i] * chosen : 0.0f;
            const float g_alpha = g_stop[i] * (1 - chosen) - (m.is_flat ? g_mean / 2 : 0.0f);
            const float g_surface = m.is_flat || m.is_deep ? 0.0f : g_mean;
            const float g_deep = !m.is_flat && m.is_deep && m.slope >= FLAT ? g_mean : 0.0f;
            const float g_depth = g_tau[i] + (g_alpha + g_mean) * left;
            const float g_rise = (rise >= 0.0f ? g_depth : 0.0f) - g_surface * m.e / m.safe;
            const float y = max_of(m.safe, FLAT);
            slopes[i] = g_surface * m.e * rise / (m.safe * m.safe) + g_deep * (1 - y * m.deep - m.deep) / y;
            far_o[i] = g_rise;
            near_o[i] = g_surface * m.surface - g_rise;
        }
        for (int64_t i = 0; i < count; i += k) {
            far_o[i] = g_tau[i];
            near_o[i] = slopes[i] = 0;
        }
        for (int64_t i = 0; i < count; ++i) {
            const float g_a = slopes[i] - slopes[i + 1] + (far_o[i] + near_o[i + 1]) * sigmoid(a[i]);
            out[i] = g_a;
        }
        double sum = 0;
        for (int64_t i = 0; i < count; ++i) {
            sum -= static_cast<double>(s[begin * k + i]) * out[i];
            out[i] *= -beta;
        }
        sums[static_cast<size_t>(begin / ROWS)] = sum;
    });
    double total = 0;
    for (const double sum : sums) total += sum;
    *grad_beta = static_cast<float>(total);
    return 0;
}
