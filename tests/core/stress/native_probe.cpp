// What the kernels' headers compute, one function at a time, for tests: compiled by `probe.py`, part of no library.
#include "strands.h"

namespace {

template <class F> void over(const float *x, float *out, int64_t n, const F &f) {
    for (int64_t i = 0; i < n; i += LANES) store(out + i, f(load(x + i)));
}

Batch batch_of(int strands, int samples, const float *t, const float *tau, const float *share) {
    Batch b;
    const float none[9] = {};
    b.begin(Medium::fixed, 0);
    for (int p = 0; p < strands; ++p) b.add(0, 0, none, none, 0, 0, none, none);
    b.sample(samples);
    for (int k = 0; k < samples; ++k)
        for (int p = 0; p < strands; ++p) {
            const size_t to = static_cast<size_t>(k) * b.stride + p, from = static_cast<size_t>(p) * samples + k;
            b.t[to] = t[from], b.tau[to] = tau[from], b.share[to] = share[from];
        }
    return b;
}

} // namespace

extern "C" int probe_lanes() { return LANES; }

// x, out (n), n a multiple of `probe_lanes`.
extern "C" void probe_exp(const float *x, float *out, int64_t n) { over(x, out, n, exp_of<lanes>); }
extern "C" void probe_softplus(const float *x, float *out, int64_t n) { over(x, out, n, softplus<lanes>); }
extern "C" void probe_stopped(const float *x, float *out, int64_t n) { over(x, out, n, stopped_by<lanes>); }
extern "C" void probe_log1p(const float *x, float *out, int64_t n) { over(x, out, n, log1p_of<lanes>); }

// Every half (65536) by its bits.
extern "C" void probe_halves(float *out) {
    for (uint32_t h = 0; h < 65536; ++h) out[h] = float_of(static_cast<uint16_t>(h));
}

// Four halves at a time, as tables of four features are read; the same as above where the instruction set has no such thing.
extern "C" void probe_halves_by_four(float *out) {
    for (uint32_t h = 0; h < 65536; h += 4) {
        const uint16_t row[4] = {static_cast<uint16_t>(h), static_cast<uint16_t>(h + 1), static_cast<uint16_t>(h + 2),
                                 static_cast<uint16_t>(h + 3)};
#if defined(__F16C__)
        _mm_storeu_ps(out + h, four(row));
#else
        for (int i = 0; i < 4; ++i) out[h + i] = float_of(row[i]);
#endif
    }
}

// t, tau, share, front (strands, samples) of strands of one ray; returns the optical depth of all.
extern "C" float probe_merge(int strands, int samples, const float *t, const float *tau, const float *share, float *front) {
    Batch b = batch_of(strands, samples, t, tau, share);
    std::vector<Strand> all;
    for (int p = 0; p < strands; ++p) all.push_back({&b, p});
    std::vector<int> next;
    std::vector<float> stops;
    const float depth = merge_fronts(all, next, stops);
    for (int p = 0; p < strands; ++p)
        for (int k = 0; k < samples; ++k) front[static_cast<size_t>(p) * samples + k] = b.front[static_cast<size_t>(k) * b.stride + p];
    return depth;
}

// The same of strands that are alone on their rays, with the samples' weights (strands, samples).
extern "C" void probe_weights(int strands, int samples, const float *t, const float *tau, const float *share, float *front, float *weight) {
    Batch b = batch_of(strands, samples, t, tau, share);
    find_fronts(b);
    find_weights(b);
    for (int p = 0; p < strands; ++p)
        for (int k = 0; k < samples; ++k) {
            const size_t to = static_cast<size_t>(p) * samples + k, from = static_cast<size_t>(k) * b.stride + p;
            front[to] = b.front[from], weight[to] = b.weight[from];
        }
}

// Optical depths and shares (strands, samples) of signed distances s at places t.
extern "C" void probe_depths(int strands, int samples, const float *t, const float *s, float beta, int widened, float *tau, float *share) {
    const std::vector<float> none(static_cast<size_t>(strands) * samples, 0.0f);
    Batch b = batch_of(strands, samples, t, none.data(), none.data());
    for (int k = 0; k < samples; ++k)
        for (int p = 0; p < strands; ++p) b.s[static_cast<size_t>(k) * b.stride + p] = s[static_cast<size_t>(p) * samples + k];
    find_depths(b, 0, samples, beta, widened != 0);
    for (int p = 0; p < strands; ++p)
        for (int k = 0; k < samples; ++k) {
            const size_t to = static_cast<size_t>(p) * samples + k, from = static_cast<size_t>(k) * b.stride + p;
            tau[to] = b.tau[from], share[to] = b.share[from];
        }
}
