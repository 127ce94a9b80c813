// Hash-grid encoding, forward and backward. The specification is plain torch, in core/ops/encode.py.
#include "variant.h"

#include <cmath>
#include <cstring>

namespace {

// The cell corners of up to BLOCK points in one level, as arrays, so that the compiler can vectorize over points.
constexpr int BLOCK = 64;

struct Corners {
    int32_t row[8][BLOCK];
    float weight[8][BLOCK];
    float fraction[3][BLOCK];
};

inline void find_corners(const unisim_grid &g, int level, const float *x, int count, Corners &c) {
    int32_t lower[3][BLOCK];
    for (int a = 0; a < 3; ++a) {
        const float scale = g.scale[level * 3 + a];
        const float last = std::max(std::ceil(scale) - 1.0f, 0.0f);
        for (int s = 0; s < count; ++s) {
            // NaN and points outside the cube are clamped to its nearest face
            float p = x[s * 3 + a] * scale;
            p = p > 0.0f ? p : 0.0f;
            p = p < scale ? p : scale;
            float cell = static_cast<float>(static_cast<int32_t>(p));
            cell = cell < last ? cell : last;
            lower[a][s] = static_cast<int32_t>(cell);
            c.fraction[a][s] = p - cell;
        }
    }
    const uint32_t sy = g.stride_y[level], sz = g.stride_z[level], mask = g.size[level] - 1;
    for (int corner = 0; corner < 8; ++corner) {
        const uint32_t bx = corner & 1, by = corner >> 1 & 1, bz = corner >> 2;
        if (sy)
            for (int s = 0; s < count; ++s)
                c.row[corner][s] =
                    static_cast<int32_t>(lower[0][s] + bx + (lower[1][s] + by) * sy + (lower[2][s] + bz) * sz);
        else
            for (int s = 0; s < count; ++s)
                c.row[corner][s] = static_cast<int32_t>(
                    ((lower[0][s] + bx) ^ (lower[1][s] + by) * 2654435761u ^ (lower[2][s] + bz) * 805459861u) & mask);
        for (int s = 0; s < count; ++s)
            c.weight[corner][s] = (bx ? c.fraction[0][s] : 1 - c.fraction[0][s]) *
                                  (by ? c.fraction[1][s] : 1 - c.fraction[1][s]) *
                                  (bz ? c.fraction[2][s] : 1 - c.fraction[2][s]);
    }
}

template <int F> inline int64_t first_row(const unisim_grid &g, const int32_t *grid, int64_t sample, int level) {
    return ((grid ? grid[sample] * g.grid_stride : 0) + g.offset[level]) * F;
}

template <int F>
void encode_forward(const unisim_grid &g, const float *x, const int32_t *grid, int64_t n, const float *table,
                    float *out, int threads) {
    const int64_t width = static_cast<int64_t>(g.levels) * F;
    parallel_blocks(n, 8 * BLOCK, threads, [&](int64_t begin, int64_t end) {
        Corners c;
        for (int level = 0; level < g.levels; ++level)
            for (int64_t first = begin; first < end; first += BLOCK) {
                const int count = static_cast<int>(std::min<int64_t>(BLOCK, end - first));
                find_corners(g, level, x + first * 3, count, c);
                for (int s = 0; s < count; ++s) {
                    const float *base = table + first_row<F>(g, grid, first + s, level);
                    for (int corner = 0; corner < 8; ++corner)
                        __builtin_prefetch(base + static_cast<int64_t>(c.row[corner][s]) * F);
                }
                for (int s = 0; s < count; ++s) {
                    const float *base = table + first_row<F>(g, grid, first + s, level);
                    float sum[F] = {};
                    for (int corner = 0; corner < 8; ++corner) {
                        const float *row = base + static_cast<int64_t>(c.row[corner][s]) * F;
                        const float w = c.weight[corner][s];
                        for (int f = 0; f < F; ++f) sum[f] += w * row[f];
                    }
                    std::memcpy(out + (first + s) * width + level * F, sum, sizeof sum);
                }
            }
    });
}

template <int F>
void encode_backward_table(const unisim_grid &g, const float *x, const int32_t *grid, int64_t n, const float *grad_out,
                           float *grad_table, int threads) {
    const int64_t width = static_cast<int64_t>(g.levels) * F;
    // one thread owns a level: no two write to the same row, and the order of the sums is fixed
    parallel_blocks(g.levels, 1, threads, [&](int64_t begin, int64_t end) {
        Corners c;
        for (int level = static_cast<int>(begin); level < end; ++level)
            for (int64_t first = 0; first < n; first += BLOCK) {
                const int count = static_cast<int>(std::min<int64_t>(BLOCK, n - first));
                find_corners(g, level, x + first * 3, count, c);
                // points whose gradient is zero, which are many behind surfaces, add nothing
                bool adds[BLOCK];
                for (int s = 0; s < count; ++s) {
                    const float *go = grad_out + (first + s) * width + level * F;
                    adds[s] = !std::all_of(go, go + F, [](float v) { return v == 0.0f; });
                    if (!adds[s]) continue;
                    const float *base = grad_table + first_row<F>(g, grid, first + s, level);
                    for (int corner = 0; corner < 8; ++corner)
                        __builtin_prefetch(base + static_cast<int64_t>(c.row[corner][s]) * F, 1);
                }
                for (int s = 0; s < count; ++s) {
                    if (!adds[s]) continue;
                    const float *go = grad_out + (first + s) * width + level * F;
                    float *base = grad_table + first_row<F>(g, grid, first + s, level);
                    for (int corner = 0; corner < 8; ++corner) {
                        float *row = base + static_cast<int64_t>(c.row[corner][s]) * F;
                        const float w = c.weight[corner][s];
                        float sum[F];
                        for (int f = 0; f < F; ++f) sum[f] = row[f] + w * go[f];
                        std::memcpy(row, sum, sizeof sum);
                    }
                }
            }
    });
}

template <int F>
void encode_backward_input(const unisim_grid &g, const float *x, const int32_t *grid, int64_t n, const float *table,
                           const float *grad_out, float *grad_x, int threads) {
    const int64_t width = static_cast<int64_t>(g.levels) * F;
    parallel_blocks(n, BLOCK, threads, [&](int64_t begin, int64_t end) {
        Corners c;
        const int count = static_cast<int>(end - begin);
        std::memset(grad_x + begin * 3, 0, sizeof(float) * 3 * static_cast<size_t>(count));
        for (int level = 0; level < g.levels; ++level) {
            find_corners(g, level, x + begin * 3, count, c);
            for (int s = 0; s < count; ++s) {
                const float *base = table + first_row<F>(g, grid, begin + s, level);
                const float *go = grad_out + (begin + s) * width + level * F;
                float dot[8];
                for (int corner = 0; corner < 8; ++corner) {
                    const float *row = base + static_cast<int64_t>(c.row[corner][s]) * F;
                    dot[corner] = 0;
                    for (int f = 0; f < F; ++f) dot[corner] += go[f] * row[f];
                }
                const float fx = c.fraction[0][s], fy = c.fraction[1][s], fz = c.fraction[2][s];
                const float gx[3] = {(1 - fy) * (1 - fz) * (dot[1] - dot[0]) + fy * (1 - fz) * (dot[3] - dot[2]) +
                                         (1 - fy) * fz * (dot[5] - dot[4]) + fy * fz * (dot[7] - dot[6]),
                                     (1 - fx) * (1 - fz) * (dot[2] - dot[0]) + fx * (1 - fz) * (dot[3] - dot[1]) +
                                         (1 - fx) * fz * (dot[6] - dot[4]) + fx * fz * (dot[7] - dot[5]),
                                     (1 - fx) * (1 - fy) * (dot[4] - dot[0]) + fx * (1 - fy) * (dot[5] - dot[1]) +
                                         (1 - fx) * fy * (dot[6] - dot[2]) + fx * fy * (dot[7] - dot[3])};
                for (int a = 0; a < 3; ++a) {
                    const float p = x[(begin + s) * 3 + a];
                    // a point that was clamped to a face does not move with x there
                    if (p > 0 && p < 1) grad_x[(begin + s) * 3 + a] += g.scale[level * 3 + a] * gx[a];
                }
            }
        }
    });
}

} // namespace

#define UNISIM_BY_FEATURES(call)                                               \
    switch (g->features) {                                                     \
    case 1: call(1); return 0;                                                 \
    case 2: call(2); return 0;                                                 \
    case 4: call(4); return 0;                                                 \
    case 8: call(8); return 0;                                                 \
    default: return 1;                                                         \
    }

extern "C" int UNISIM_NAME(unisim_encode_forward)(const unisim_grid *g, const float *x, const int32_t *grid, int64_t n,
                                                  const float *table, float *out, int threads) {
#define CALL(F) encode_forward<F>(*g, x, grid, n, table, out, threads)
    UNISIM_BY_FEATURES(CALL)
#undef CALL
}

extern "C" int UNISIM_NAME(unisim_encode_backward_table)(const unisim_grid *g, const float *x, const int32_t *grid,
                                                         int64_t n, const float *grad_out, float *grad_table,
                                                         int threads) {
#define CALL(F) encode_backward_table<F>(*g, x, grid, n, grad_out, grad_table, threads)
    UNISIM_BY_FEATURES(CALL)
#undef CALL
}

extern "C" int UNISIM_NAME(unisim_encode_backward_input)(const unisim_grid *g, const float *x, const int32_t *grid,
                                                         int64_t n, const float *table, const float *grad_out,
                                                         float *grad_x, int threads) {
#define CALL(F) encode_backward_input<F>(*g, x, grid, n, table, grad_out, grad_x, threads)
    UNISIM_BY_FEATURES(CALL)
#undef CALL
}
