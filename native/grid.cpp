// Hash-grid encoding, forward and backward. The specification is plain torch, in core/ops/encode.py.
#include "field_tile.h"

namespace {

template <int F> inline int64_t first_row(const unisim_grid &g, const int32_t *grid, int64_t sample, int level) {
    return ((grid ? grid[sample] * g.grid_stride : 0) + g.offset[level]) * F;
}

// The weights of the two corners of an edge.
struct Ends {
    float first, second;

    Ends(const Corners &c, int edge, int s)
        : first(c.weight[edge][s] * (1 - c.along[s])), second(c.weight[edge][s] * c.along[s]) {}
};

template <int F>
void encode_forward(const unisim_grid &g, const float *x, const int32_t *grid, int64_t n, const float *table,
                    float *out, int threads) {
    parallel_blocks(n, 16 * BLOCK, threads, [&](int64_t begin, int64_t end) {
        float points[3][BLOCK];
        for (int64_t first = begin; first < end; first += BLOCK) {
            const int count = static_cast<int>(std::min<int64_t>(BLOCK, end - first));
            rows_of_points(x + first * 3, count, points);
            encode_block<F>(g, table, points, grid ? grid + first : nullptr, count, out + first * g.levels * F);
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
        float points[3][BLOCK];
        for (int level = static_cast<int>(begin); level < end; ++level)
            for (int64_t first = 0; first < n; first += BLOCK) {
                const int count = static_cast<int>(std::min<int64_t>(BLOCK, n - first));
                rows_of_points(x + first * 3, count, points);
                find_corners(g, level, points, count, c);
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
                    const auto add = [&](int corner, float weight) {
                        float *row = base + static_cast<int64_t>(c.row[corner][s]) * F;
                        float sum[F];
                        for (int f = 0; f < F; ++f) sum[f] = row[f] + weight * go[f];
                        std::memcpy(row, sum, sizeof sum);
                    };
                    for (int edge = 0; edge < 4; ++edge) {
                        const Ends weight(c, edge, s);
                        add(2 * edge, weight.first);
                        add(2 * edge + 1, weight.second);
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
        float points[3][BLOCK];
        const int count = static_cast<int>(end - begin);
        rows_of_points(x + begin * 3, count, points);
        std::memset(grad_x + begin * 3, 0, sizeof(float) * 3 * static_cast<size_t>(count));
        for (int level = 0; level < g.levels; ++level) {
            find_corners(g, level, points, count, c);
            for (int s = 0; s < count; ++s) {
                const float *base = table + first_row<F>(g, grid, begin + s, level);
                const float *go = grad_out + (begin + s) * width + level * F;
                float dot[8];
                for (int corner = 0; corner < 8; ++corner) {
                    const float *row = base + static_cast<int64_t>(c.row[corner][s]) * F;
                    dot[corner] = 0;
                    for (int f = 0; f < F; ++f) dot[corner] += go[f] * row[f];
                }
                float gx[3] = {}, at[4];
                for (int edge = 0; edge < 4; ++edge) {
                    const float rise = dot[2 * edge + 1] - dot[2 * edge];
                    gx[0] += c.weight[edge][s] * rise;
                    at[edge] = dot[2 * edge] + c.along[s] * rise;
                }
                gx[1] = (c.weight[0][s] + c.weight[1][s]) * (at[1] - at[0]) +
                        (c.weight[2][s] + c.weight[3][s]) * (at[3] - at[2]);
                gx[2] = (c.weight[0][s] + c.weight[2][s]) * (at[2] - at[0]) +
                        (c.weight[1][s] + c.weight[3][s]) * (at[3] - at[1]);
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
