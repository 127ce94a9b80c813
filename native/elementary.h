// Exponentials and logarithms in plain arithmetic, without a branch, so that the compiler can do many at once. Relative errors stay
// below 3e-7.
#pragma once
#include <cstdint>
#include <cstring>

namespace {

inline float exp_of(float x) {
    x = x < -87.0f ? -87.0f : x;
    x = x > 88.0f ? 88.0f : x;
    // adding and taking away 1.5 * 2^23 rounds to a whole number
    const float n = (x * 1.44269504f + 12582912.0f) - 12582912.0f;
    const float r = (x - n * 0.693359375f) + n * 2.12194440e-4f;
    const float p = 1.9875691500e-4f * r + 1.3981999507e-3f;
    const float q = (((p * r + 8.3334519073e-3f) * r + 4.1665795894e-2f) * r + 1.6666665459e-1f) * r + 5.0000001201e-1f;
    const int32_t bits = (static_cast<int32_t>(n) + 127) << 23;
    float power;
    std::memcpy(&power, &bits, sizeof power);
    return (q * r * r + r + 1.0f) * power;
}

// 1 - exp(-x) of x >= 0.
inline float stopped(float x) {
    const float small = x < 0.5f ? x : 0.5f;
    float sum = 1.0f / 362880;
    sum = 1.0f / 40320 - small * sum;
    sum = 1.0f / 5040 - small * sum;
    sum = 1.0f / 720 - small * sum;
    sum = 1.0f / 120 - small * sum;
    sum = 1.0f / 24 - small * sum;
    sum = 1.0f / 6 - small * sum;
    sum = 0.5f - small * sum;
    sum = small - small * small * sum;
    const float large = 1.0f - exp_of(-x);
    return x < 0.5f ? sum : large;
}

// log(1 + exp(x)).
inline float softplus(float x) {
    const float size = x < 0.0f ? -x : x;
    const float y = exp_of(-size);
    // log(1 + y) = 2 atanh(y / (2 + y))
    const float z = y / (2.0f + y), zz = z * z;
    const float series = ((((((1.0f / 15 * zz + 1.0f / 13) * zz + 1.0f / 11) * zz + 1.0f / 9) * zz + 1.0f / 7) * zz + 0.2f) * zz + 1.0f / 3) * zz + 1.0f;
    return (x > 0.0f ? x : 0.0f) + 2.0f * z * series;
}

// 1 / (1 + exp(-x)).
inline float sigmoid(float x) {
    const float size = x < 0.0f ? -x : x;
    const float y = exp_of(-size);
    return (x < 0.0f ? y : 1.0f) / (1.0f + y);
}

} // namespace
