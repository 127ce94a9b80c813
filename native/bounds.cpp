// Which rays may hit which boxes. The specification is plain torch, in core/ops/near_spheres.py.
#include "variant.h"

// near (n, boxes): 1 where a ray (n), with unit direction, intersects the bounding sphere of a box at the ray's time.
// Spheres are centres (bins, boxes, 3) and radii (bins, boxes), negative where a box is absent; bin (n) is a ray's
// time bin, -1 for none.
extern "C" int UNISIM_NAME(unisim_near_spheres)(const float *origins, const float *directions, const int64_t *bin,
                                                int64_t n, const float *centres, const float *radii, int64_t boxes,
                                                uint8_t *near, int threads) {
    parallel_blocks(n, 256, threads, [&](int64_t begin, int64_t end) {
        for (int64_t r = begin; r < end; ++r) {
            const float *o = origins + r * 3, *d = directions + r * 3;
            const float *c = centres + std::max<int64_t>(bin[r], 0) * boxes * 3,
                        *radius = radii + std::max<int64_t>(bin[r], 0) * boxes;
            const float present = bin[r] >= 0 ? 1.0f : -1.0f;
            for (int64_t b = 0; b < boxes; ++b) {
                const float x = c[b * 3] - o[0], y = c[b * 3 + 1] - o[1], z = c[b * 3 + 2] - o[2];
                const float along = x * d[0] + y * d[1] + z * d[2], ahead = along > 0.0f ? along : 0.0f;
                const float size = radius[b] * present;
                near[r * boxes + b] = (size > 0.0f) & (x * x + y * y + z * z - ahead * ahead <= size * size);
            }
        }
    });
    return 0;
}
