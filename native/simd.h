// Vectors of floats, as wide as the instruction set's registers, and vector versions of exp, log and the like.
//
// Each lane's result depends on that lane alone, so a ray's result does not depend on the rays computed with it.
// Templates over F take simd_float or float and have no branches, so that the compiler can vectorize loops over
// floats. NaN stays NaN.
#pragma once
#include <cstdint>
#include <cstring>
#if defined(__AVX512F__)
#include <immintrin.h>
#endif

namespace {

#if defined(__AVX512F__)
constexpr int LANES = 16;
#elif defined(__AVX2__)
constexpr int LANES = 8;
#else
constexpr int LANES = 4;
#endif

typedef float simd_float __attribute__((vector_size(LANES * sizeof(float))));
typedef int32_t simd_int __attribute__((vector_size(LANES * sizeof(int32_t))));

inline simd_float broadcast(float x) { return x - simd_float{}; }

inline simd_float load(const float *p) {
    simd_float a;
    std::memcpy(&a, p, sizeof a);
    return a;
}

inline void store(float *p, const simd_float &a) { std::memcpy(p, &a, sizeof a); }

inline simd_int load(const int32_t *p) {
    simd_int a;
    std::memcpy(&a, p, sizeof a);
    return a;
}

inline void store(int32_t *p, const simd_int &a) { std::memcpy(p, &a, sizeof a); }

// Whether any bit of any lane is set.
inline bool any(const simd_int &a) {
    int64_t v[LANES / 2], all = 0;
    std::memcpy(v, &a, sizeof v);
    for (const int64_t x : v) all |= x;
    return all != 0;
}

// As SSE's maxps and minps: b where either is NaN.
template <class F> inline F max_of(F a, F b) { return a > b ? a : b; }
template <class F> inline F min_of(F a, F b) { return a < b ? a : b; }
inline simd_float relu(simd_float a) { return max_of(a, simd_float{}); }

inline float sum_of(const simd_float &a) {
#if defined(__AVX512F__)
    return _mm512_reduce_add_ps((__m512)a); // the order of the loop below
#endif
    float v[LANES];
    store(v, a);
    for (int width = LANES / 2; width; width /= 2)
        for (int i = 0; i < width; ++i) v[i] += v[i + width];
    return v[0];
}

inline simd_float power_of_two(simd_float n) {
    const simd_int bits = (__builtin_convertvector(n, simd_int) + 127) << 23;
    simd_float power;
    std::memcpy(&power, &bits, sizeof power);
    return power;
}

inline float power_of_two(float n) {
    const int32_t bits = (static_cast<int32_t>(n) + 127) << 23;
    float power;
    std::memcpy(&power, &bits, sizeof power);
    return power;
}

// exp(x) to 2 units in the last place; 1e-38 below and 3e38 above the range of float32. Cephes' expf (Moshier, 1992).
template <class F> inline F exp_of(F x) {
    x = min_of(F{} + 88.3f, max_of(F{} - 87.3f, x));
    // adding and subtracting 1.5 * 2^23 rounds to a whole number
    const F n = (x * 1.44269504088896341f + 12582912.0f) - 12582912.0f;
    F r = x - n * 0.693359375f;
    r = r - n * -2.12194440e-4f;
    F p = F{} + 1.9875691500e-4f;
    p = p * r + 1.3981999507e-3f;
    p = p * r + 8.3334519073e-3f;
    p = p * r + 4.1665795894e-2f;
    p = p * r + 1.6666665459e-1f;
    p = p * r + 5.0000001201e-1f;
    p = p * r * r + r + 1.0f;
    return p * power_of_two(n);
}

// Opacity of an optical depth: 1 - exp(-x) for x >= 0, precise where that is small.
template <class F> inline F opacity_of(F x) {
    F p = F{} - 1.0f / 720;
    p = p * x + 1.0f / 120;
    p = p * x - 1.0f / 24;
    p = p * x + 1.0f / 6;
    p = p * x - 0.5f;
    p = p * x + 1.0f;
    const F small = p * x, large = 1.0f - exp_of(-x);
    return x < 0.125f ? small : large;
}

// log(1 + y) for y in [0, 1]: 2 atanh(y / (2 + y)).
template <class F> inline F log1p_of(F y) {
    const F z = y / (2.0f + y), zz = z * z;
    F p = F{} + 1.0f / 15;
    p = p * zz + 1.0f / 13;
    p = p * zz + 1.0f / 11;
    p = p * zz + 1.0f / 9;
    p = p * zz + 1.0f / 7;
    p = p * zz + 1.0f / 5;
    p = p * zz + 1.0f / 3;
    p = p * zz + 1.0f;
    return 2.0f * z * p;
}

// log(x) of a normal x > 0, to 2 units in the last place. Cephes' logf (Moshier, 1992).
inline simd_float log_of(simd_float x) {
    simd_int bits;
    std::memcpy(&bits, &x, sizeof bits);
    // x = m 2^e, m from sqrt(1/2) to sqrt(2)
    const simd_int e = (bits - 0x3f3504f3) >> 23;
    bits -= e << 23;
    simd_float m;
    std::memcpy(&m, &bits, sizeof m);
    m -= 1.0f;
    const simd_float z = m * m, n = __builtin_convertvector(e, simd_float);
    simd_float p = broadcast(7.0376836292e-2f);
    p = p * m - 1.1514610310e-1f;
    p = p * m + 1.1676998740e-1f;
    p = p * m - 1.2420140846e-1f;
    p = p * m + 1.4249322787e-1f;
    p = p * m - 1.6668057665e-1f;
    p = p * m + 2.0000714765e-1f;
    p = p * m - 2.4999993993e-1f;
    p = p * m + 3.3333331174e-1f;
    return n * 0.693359375f + (m + (p * m * z - n * 2.12194440e-4f - 0.5f * z));
}

template <class F> inline F softplus(F x) {
    const F magnitude = x > 0.0f ? x : -x;
    return max_of(F{}, x) + log1p_of(exp_of(-magnitude));
}

template <class F> inline F sigmoid(F x) { return 1.0f / (1.0f + exp_of(-x)); }

} // namespace
