// A step of Adam (Kingma and Ba, 2015) that leaves gradients of zero: a table's memory is gone through once instead of
// twice, by the kernels' threads. The specification is torch.optim.Adam.
#include "simd.h"
#include "variant.h"

#include <cmath>

namespace {

inline simd_float root_of(simd_float x) {
    float v[LANES];
    store(v, x);
    for (float &lane : v) lane = std::sqrt(lane);
    return load(v);
}

} // namespace

extern "C" int UNISIM_NAME(unisim_adam)(const unisim_adam_part *parts, int count, float beta1, float beta2,
                                        int threads) {
    for (int i = 0; i < count; ++i) {
        const unisim_adam_part part = parts[i];
        const auto update = [&](float *value, float *gradient, float *mean, float *square) {
            const simd_float g = load(gradient), m = load(mean), v = load(square);
            simd_int bits[3];
            std::memcpy(&bits[0], &g, sizeof g);
            std::memcpy(&bits[1], &m, sizeof m);
            std::memcpy(&bits[2], &v, sizeof v);
            // rows that no point has touched yet: nothing is written
            if (!any(bits[0] | bits[1] | bits[2])) return;
            const simd_float m1 = m + (1 - beta1) * (g - m), v1 = beta2 * v + (1 - beta2) * g * g;
            store(value, load(value) - part.rate * m1 / (root_of(v1) / part.root + part.eps));
            store(mean, m1);
            store(square, v1);
            store(gradient, simd_float{});
        };
        parallel_blocks(part.n, 1 << 16, threads, [&](int64_t begin, int64_t end) {
            int64_t k = begin;
            for (; k + LANES <= end; k += LANES)
                update(part.value + k, part.gradient + k, part.mean + k, part.square + k);
            if (k == end) return;
            float rest[4][LANES] = {}, *from[4] = {part.value + k, part.gradient + k, part.mean + k, part.square + k};
            for (int j = 0; j < 4; ++j) std::memcpy(rest[j], from[j], sizeof(float) * (end - k));
            update(rest[0], rest[1], rest[2], rest[3]);
            for (int j = 0; j < 4; ++j) std::memcpy(from[j], rest[j], sizeof(float) * (end - k));
        });
    }
    return 0;
}
