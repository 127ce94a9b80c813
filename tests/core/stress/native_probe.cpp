// Functions of the kernels' headers, one at a time, for tests: compiled by `probe.py`, part of no library.
#include "ray_segments.h"

namespace {

template <class F> void over(const float *x, float *out, int64_t n, const F &f) {
    for (int64_t i = 0; i < n; i += LANES) store(out + i, f(load(x + i)));
}

StaticSegments segments_of(int count, int samples, const float *t, const float *tau, const float *stop_fraction) {
    StaticSegments b;
    const float zero[3] = {};
    b.begin();
    for (int p = 0; p < count; ++p) b.add(0, zero, zero, 0, 0);
    b.allocate(samples);
    for (int k = 0; k < samples; ++k)
        for (int p = 0; p < count; ++p) {
            const size_t to = static_cast<size_t>(k) * b.stride + p, from = static_cast<size_t>(p) * samples + k;
            b.t[to] = t[from], b.tau[to] = tau[from], b.stop_fraction[to] = stop_fraction[from];
        }
    return b;
}

} // namespace

extern "C" int probe_lanes() { return LANES; }

// x, out (n), n a multiple of `probe_lanes`.
extern "C" void probe_exp(const float *x, float *out, int64_t n) { over(x, out, n, exp_of<simd_float>); }
extern "C" void probe_softplus(const float *x, float *out, int64_t n) { over(x, out, n, softplus<simd_float>); }
extern "C" void probe_opacity(const float *x, float *out, int64_t n) { over(x, out, n, opacity_of<simd_float>); }
extern "C" void probe_log1p(const float *x, float *out, int64_t n) { over(x, out, n, log1p_of<simd_float>); }

// Every half (65536) by its bits.
extern "C" void probe_halves(float *out) {
    for (uint32_t h = 0; h < 65536; ++h) out[h] = float_of(static_cast<uint16_t>(h));
}

// Two rows of four halves at a time, as tables of four features are read; one at a time where the instruction set has no such
// conversion.
extern "C" void probe_halves_in_rows(float *out) {
    for (uint32_t h = 0; h < 65536; h += 8) {
        uint16_t row[8];
        for (uint32_t i = 0; i < 8; ++i) row[i] = static_cast<uint16_t>(h + i);
#if defined(__F16C__)
        _mm256_storeu_ps(out + h, two_rows(row, row + 4));
#else
        for (int i = 0; i < 8; ++i) out[h + i] = float_of(row[i]);
#endif
    }
}

// t, tau, stop_fraction, before (count, samples) of segments of one ray; returns the optical depth of all.
extern "C" float probe_merge(int count, int samples, const float *t, const float *tau, const float *stop_fraction, float *before) {
    StaticSegments b = segments_of(count, samples, t, tau, stop_fraction);
    std::vector<SegmentRef> all;
    for (int p = 0; p < count; ++p) all.push_back({&b, p});
    std::vector<int> next;
    std::vector<float> stops;
    const float depth = merge_by_depth(all, next, stops);
    for (int p = 0; p < count; ++p)
        for (int k = 0; k < samples; ++k) before[static_cast<size_t>(p) * samples + k] = b.transmittance_before[static_cast<size_t>(k) * b.stride + p];
    return depth;
}

// The same of segments that are alone on their rays, with the samples' weights (count, samples).
extern "C" void probe_weights(int count, int samples, const float *t, const float *tau, const float *stop_fraction, float *before, float *weight) {
    StaticSegments b = segments_of(count, samples, t, tau, stop_fraction);
    find_transmittances_alone(b);
    find_weights(b);
    for (int p = 0; p < count; ++p)
        for (int k = 0; k < samples; ++k) {
            const size_t to = static_cast<size_t>(p) * samples + k, from = static_cast<size_t>(k) * b.stride + p;
            before[to] = b.transmittance_before[from], weight[to] = b.weight[from];
        }
}

// Optical depths and stop fractions (count, samples) of signed distances s at distances t.
extern "C" void probe_depths(int count, int samples, const float *t, const float *s, float beta, int limit_sharpness, float *tau, float *stop_fraction) {
    const std::vector<float> none(static_cast<size_t>(count) * samples, 0.0f);
    StaticSegments b = segments_of(count, samples, t, none.data(), none.data());
    for (int k = 0; k < samples; ++k)
        for (int p = 0; p < count; ++p) b.s[static_cast<size_t>(k) * b.stride + p] = s[static_cast<size_t>(p) * samples + k];
    find_intervals(b, 0, samples, beta, limit_sharpness != 0);
    for (int p = 0; p < count; ++p)
        for (int k = 0; k < samples; ++k) {
            const size_t to = static_cast<size_t>(p) * samples + k, from = static_cast<size_t>(k) * b.stride + p;
            tau[to] = b.tau[from], stop_fraction[to] = b.stop_fraction[from];
        }
}
