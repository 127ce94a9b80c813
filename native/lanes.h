// Vectors of floats, as wide as the instruction set has them, and the functions of them that libraries have for one float only.
//
// A lane's result depends on that lane alone, so it does not matter in which company a ray is computed. A function of a type F is
// for lanes and for a float, without a branch, so that the compiler can do a loop's many at once. What is not a number stays so.
#pragma once
#include <cstdint>
#include <cstring>

namespace {

#if defined(__AVX512F__)
constexpr int LANES = 16;
#elif defined(__AVX2__)
constexpr int LANES = 8;
#else
constexpr int LANES = 4;
#endif

typedef float lanes __attribute__((vector_size(LANES * sizeof(float))));
typedef int32_t int_lanes __attribute__((vector_size(LANES * sizeof(int32_t))));

inline lanes spread(float x) { return x - lanes{}; }

inline lanes load(const float *p) {
    lanes a;
    std::memcpy(&a, p, sizeof a);
    return a;
}

inline void store(float *p, const lanes &a) { std::memcpy(p, &a, sizeof a); }

inline int_lanes load(const int32_t *p) {
    int_lanes a;
    std::memcpy(&a, p, sizeof a);
    return a;
}

inline void store(int32_t *p, const int_lanes &a) { std::memcpy(p, &a, sizeof a); }

// Whether any lane has a bit.
inline bool any(const int_lanes &a) {
    int64_t v[LANES / 2], all = 0;
    std::memcpy(v, &a, sizeof v);
    for (const int64_t x : v) all |= x;
    return all != 0;
}

// Where one is not a number, it is b.
template <class F> inline F most(F a, F b) { return a > b ? a : b; }
template <class F> inline F least(F a, F b) { return a < b ? a : b; }
inline lanes rectified(lanes a) { return most(a, lanes{}); }

inline float sum_of(const lanes &a) {
    float v[LANES];
    store(v, a);
    for (int width = LANES / 2; width; width /= 2)
        for (int i = 0; i < width; ++i) v[i] += v[i + width];
    return v[0];
}

inline lanes power_of_two(lanes n) {
    const int_lanes bits = (__builtin_convertvector(n, int_lanes) + 127) << 23;
    lanes power;
    std::memcpy(&power, &bits, sizeof power);
    return power;
}

inline float power_of_two(float n) {
    const int32_t bits = (static_cast<int32_t>(n) + 127) << 23;
    float power;
    std::memcpy(&power, &bits, sizeof power);
    return power;
}

// exp(x) to 2 units in the last place; 1e-38 below, 3e38 above what float32 holds. Cephes' expf (Moshier, 1992).
template <class F> inline F exp_of(F x) {
    x = least(F{} + 88.3f, most(F{} - 87.3f, x));
    // adding and taking away 1.5 * 2^23 rounds to a whole number
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

// 1 - exp(-x) for x >= 0, also where that is small.
template <class F> inline F stopped_by(F x) {
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
inline lanes log_of(lanes x) {
    int_lanes bits;
    std::memcpy(&bits, &x, sizeof bits);
    // x = m 2^e, m from sqrt(1/2) to sqrt(2)
    const int_lanes e = (bits - 0x3f3504f3) >> 23;
    bits -= e << 23;
    lanes m;
    std::memcpy(&m, &bits, sizeof m);
    m -= 1.0f;
    const lanes z = m * m, n = __builtin_convertvector(e, lanes);
    lanes p = spread(7.0376836292e-2f);
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
    return most(F{}, x) + log1p_of(exp_of(-magnitude));
}

template <class F> inline F sigmoid(F x) { return 1.0f / (1.0f + exp_of(-x)); }

} // namespace
