// Evaluates a field at a block of points, for rendering: grid and first layer in one pass, then the needed rows of
// the last layer.
//
// The distance is one row of the last layer. The other rows are linear in the hidden units, so they are applied once
// per ray after compositing, not at every point. Tables may be half precision; halves are converted to float32
// exactly.
#pragma once
#include "simd.h"
#include "variant.h"

#include <cmath>
#if defined(__F16C__)
#include <immintrin.h>
#endif

namespace {

constexpr int BLOCK = 64;
// Layers are computed two vectors of outputs at a time, for ROWS points.
constexpr int PANEL = 2 * LANES;
#if defined(__AVX512F__)
constexpr int ROWS = 8;
#else
constexpr int ROWS = 4;
#endif

constexpr int padded(int n) { return (n + PANEL - 1) / PANEL * PANEL; }

inline float float_of(float x) { return x; }

// Any half except infinities and NaN: scenes with these are not opened.
inline float float_of(uint16_t h) {
    const uint32_t magnitude = static_cast<uint32_t>(h & 0x7fff) << 13;
    float x;
    std::memcpy(&x, &magnitude, sizeof x);
    x *= 0x1p112f;
    return h & 0x8000 ? -x : x;
}

// Adds weight * row to sum, F numbers.
template <int F, class T> inline void add_row(const T *row, float weight, float *sum) {
    for (int f = 0; f < F; ++f) sum[f] += weight * float_of(row[f]);
}

#if defined(__F16C__)
// The rows, of four numbers, of two corners.
inline __m256 two_rows(const float *a, const float *b) {
    return _mm256_insertf128_ps(_mm256_castps128_ps256(_mm_loadu_ps(a)), _mm_loadu_ps(b), 1);
}
inline __m256 two_rows(const uint16_t *a, const uint16_t *b) {
    const __m128 low = _mm_castsi128_ps(_mm_loadl_epi64(reinterpret_cast<const __m128i *>(a)));
    return _mm256_cvtph_ps(_mm_castps_si128(_mm_loadh_pi(low, reinterpret_cast<const __m64 *>(b))));
}
#endif

// The cell corners of a block's points in one level: their rows, the weights of the four edges along x, whose ends are
// corners 2 e and 2 e + 1, and the fraction of the way along these.
struct Corners {
    int32_t row[8][BLOCK];
    float weight[4][BLOCK];
    float along[BLOCK];
};

// Points x (count, 3) as three rows, filled up to whole vectors with the last one.
inline void rows_of_points(const float *x, int count, float (*rows)[BLOCK]) {
    const int end = (count + LANES - 1) / LANES * LANES;
    for (int a = 0; a < 3; ++a) {
        for (int s = 0; s < count; ++s) rows[a][s] = x[s * 3 + a];
        for (int s = count; s < end; ++s) rows[a][s] = rows[a][count - 1];
    }
}

// x: three rows of coordinates in the unit cube, of `count` points, filled up to whole vectors.
inline void find_corners(const unisim_grid &g, int level, const float (*x)[BLOCK], int count, Corners &c) {
    // whole vectors: no remainder loop
    const int end = (count + LANES - 1) / LANES * LANES;
    int32_t lower[3][BLOCK];
    float across[2][BLOCK];
    for (int a = 0; a < 3; ++a) {
        const float scale = g.scale[level * 3 + a];
        const float last = std::fmax(std::ceil(scale) - 1.0f, 0.0f);
        float *fraction = a ? across[a - 1] : c.along;
        for (int s = 0; s < end; ++s) {
            // NaN and points outside the cube are clamped to its nearest face
            float p = x[a][s] * scale;
            p = p > 0.0f ? p : 0.0f;
            p = p < scale ? p : scale;
            float cell = static_cast<float>(static_cast<int32_t>(p));
            cell = cell < last ? cell : last;
            lower[a][s] = static_cast<int32_t>(cell);
            fraction[s] = p - cell;
        }
    }
    const uint32_t sy = g.stride_y[level], sz = g.stride_z[level], mask = g.size[level] - 1;
    for (int edge = 0; edge < 4; ++edge) {
        const uint32_t by = edge & 1, bz = edge >> 1;
        int32_t *first = c.row[2 * edge], *second = c.row[2 * edge + 1];
        if (sy)
            for (int s = 0; s < end; ++s) {
                first[s] = static_cast<int32_t>(lower[0][s] + (lower[1][s] + by) * sy + (lower[2][s] + bz) * sz);
                second[s] = first[s] + 1;
            }
        else
            for (int s = 0; s < end; ++s) {
                const uint32_t yz = (lower[1][s] + by) * 2654435761u ^ (lower[2][s] + bz) * 805459861u;
                first[s] = static_cast<int32_t>((lower[0][s] ^ yz) & mask);
                second[s] = static_cast<int32_t>(((lower[0][s] + 1) ^ yz) & mask);
            }
        for (int s = 0; s < end; ++s)
            c.weight[edge][s] = (by ? across[0][s] : 1 - across[0][s]) * (bz ? across[1][s] : 1 - across[1][s]);
    }
}

template <int F, class T>
inline void gather_level(const unisim_grid &g, int level, const T *table, const int32_t *grid, int count,
                         const Corners &c, const Corners *next, float *code, int width) {
    for (int s = 0; s < count; ++s) {
        const T *base = table + ((grid ? grid[s] * g.grid_stride : 0) + g.offset[level]) * F;
        if (next) {
            const T *after = table + ((grid ? grid[s] * g.grid_stride : 0) + g.offset[level + 1]) * F;
            for (int edge = 0; edge < 4; ++edge)
                __builtin_prefetch(after + static_cast<int64_t>(next->row[2 * edge][s]) * F);
        }
        const auto row = [&](int corner) { return base + static_cast<int64_t>(c.row[corner][s]) * F; };
        float *out = code + s * width + level * F;
#if defined(__F16C__)
        if constexpr (F == 4) {
            __m256 ends = _mm256_setzero_ps();
            for (int edge = 0; edge < 4; ++edge)
                ends = _mm256_fmadd_ps(_mm256_set1_ps(c.weight[edge][s]), two_rows(row(2 * edge), row(2 * edge + 1)),
                                       ends);
            const __m128 first = _mm256_castps256_ps128(ends), second = _mm256_extractf128_ps(ends, 1);
            _mm_storeu_ps(out, _mm_fmadd_ps(_mm_set1_ps(c.along[s]), _mm_sub_ps(second, first), first));
            continue;
        }
#endif
        float first[F] = {}, second[F] = {};
        for (int edge = 0; edge < 4; ++edge) {
            add_row<F>(row(2 * edge), c.weight[edge][s], first);
            add_row<F>(row(2 * edge + 1), c.weight[edge][s], second);
        }
        for (int f = 0; f < F; ++f) out[f] = first[f] + c.along[s] * (second[f] - first[f]);
    }
}

template <int F, class T>
void encode_block(const unisim_grid &g, const T *table, const float (*x)[BLOCK], const int32_t *grid, int count,
                  float *code) {
    const int width = g.levels * F;
    // while one level's rows are summed, the next one's are fetched
    Corners corners[2];
    find_corners(g, 0, x, count, corners[0]);
    for (int level = 0; level < g.levels; ++level) {
        const Corners &here = corners[level % 2];
        Corners *next = level + 1 < g.levels ? &corners[(level + 1) % 2] : nullptr;
        if (next) find_corners(g, level + 1, x, count, *next);
        gather_level<F>(g, level, table, grid, count, here, next, code, width);
    }
}

// c (R, PANEL) = relu of a (R, k) b (k, PANEL), or without relu.
template <int R, bool RELU>
inline void layer_panel(int k, const float *a, int a_row, const float *b, int b_row, float *c, int c_row) {
    simd_float sum[R][2];
    for (int r = 0; r < R; ++r) sum[r][0] = sum[r][1] = simd_float{};
    for (int i = 0; i < k; ++i) {
        const simd_float b0 = load(b + i * b_row), b1 = load(b + i * b_row + LANES);
        for (int r = 0; r < R; ++r) {
            const simd_float x = broadcast(a[r * a_row + i]);
            sum[r][0] += x * b0;
            sum[r][1] += x * b1;
        }
    }
    for (int r = 0; r < R; ++r)
        for (int j = 0; j < 2; ++j)
            store(c + r * c_row + j * LANES, RELU ? max_of(sum[r][j], simd_float{}) : sum[r][j]);
}

// c (rows, n) of a (rows, k) and b (k, n); rows a multiple of ROWS, n of PANEL.
template <bool RELU> inline void layer(int rows, int n, int k, const float *a, int a_row, const float *b, float *c) {
    for (int j = 0; j < n; j += PANEL)
        for (int i = 0; i < rows; i += ROWS)
            layer_panel<ROWS, RELU>(k, a + i * a_row, a_row, b + j, n, c + i * n + j, n);
}

// A field with its weights in the layout of the loops above.
struct Field {
    const unisim_grid *grid;
    const void *table;
    bool half;
    int inputs, hidden, outputs, wide, wide_out;
    std::vector<float> first;     // (inputs, wide), transposed
    std::vector<float> distance;  // (wide): the last layer's first row
    std::vector<float> feature;   // (hidden, wide_out): its other rows, transposed
    std::vector<float> bias;      // (outputs)

    explicit Field(const unisim_field &f)
        : grid(&f.grid), table(f.table), half(f.half != 0), inputs(f.net.inputs), hidden(f.net.hidden),
          outputs(f.net.outputs), wide(padded(hidden)), wide_out(padded(outputs - 1)),
          first(static_cast<size_t>(inputs) * wide), distance(wide), feature(static_cast<size_t>(hidden) * wide_out),
          bias(f.net.bias, f.net.bias + outputs) {
        for (int h = 0; h < hidden; ++h) {
            for (int i = 0; i < inputs; ++i) first[static_cast<size_t>(i) * wide + h] = f.net.w1[h * inputs + i];
            distance[h] = f.net.w2[h];
            for (int o = 1; o < outputs; ++o)
                feature[static_cast<size_t>(h) * wide_out + o - 1] = f.net.w2[o * hidden + h];
        }
    }

    // Hidden units (count, wide) of up to BLOCK points; rows after `count` are undefined. x and row are filled up to
    // whole vectors.
    void units(const float (*x)[BLOCK], const int32_t *row, int count, float *code, float *h) const {
        if (half)
            encode(static_cast<const uint16_t *>(table), x, row, count, code);
        else
            encode(static_cast<const float *>(table), x, row, count, code);
        layer<true>((count + ROWS - 1) / ROWS * ROWS, wide, inputs, code, inputs, first.data(), h);
    }

    // The last layer's first output of units (wide).
    float first_output(const float *h) const {
        simd_float sum{};
        for (int j = 0; j < wide; j += LANES) sum += load(h + j) * load(&distance[static_cast<size_t>(j)]);
        return sum_of(sum) + bias[0];
    }

  private:
    template <class T> void encode(const T *rows, const float (*x)[BLOCK], const int32_t *row, int count,
                                   float *code) const {
        switch (grid->features) {
        case 1: return encode_block<1>(*grid, rows, x, row, count, code);
        case 2: return encode_block<2>(*grid, rows, x, row, count, code);
        case 4: return encode_block<4>(*grid, rows, x, row, count, code);
        case 8: return encode_block<8>(*grid, rows, x, row, count, code);
        }
    }
};

} // namespace
