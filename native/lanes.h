// Registers of floats, as wide as the instruction set that a file is compiled for has them.
#pragma once
#include <cstring>

namespace {

#if defined(__AVX512F__)
constexpr int LANES = 16;
#elif defined(__AVX2__)
constexpr int LANES = 8;
#else
constexpr int LANES = 4;
#endif

#if defined(__GNUC__)
typedef float lanes __attribute__((vector_size(LANES * sizeof(float))));
inline lanes spread(float x) { return x - lanes{}; }
inline lanes rectified(lanes a) { return a > lanes{} ? a : lanes{}; }
#else
struct lanes {
    float v[LANES];
};
inline lanes operator*(lanes a, const lanes &b) {
    for (int i = 0; i < LANES; ++i) a.v[i] *= b.v[i];
    return a;
}
inline lanes &operator+=(lanes &a, const lanes &b) {
    for (int i = 0; i < LANES; ++i) a.v[i] += b.v[i];
    return a;
}
inline lanes spread(float x) {
    lanes a;
    for (int i = 0; i < LANES; ++i) a.v[i] = x;
    return a;
}
inline lanes rectified(lanes a) {
    for (int i = 0; i < LANES; ++i) a.v[i] = a.v[i] > 0.0f ? a.v[i] : 0.0f;
    return a;
}
#endif

inline lanes load(const float *p) {
    lanes a;
    std::memcpy(&a, p, sizeof a);
    return a;
}

inline void store(float *p, const lanes &a) { std::memcpy(p, &a, sizeof a); }

} // namespace
