// A field at one point, evaluated by one thread: grid, perceptron, and sums of its hidden units.
//
// A hidden unit is recomputed from the encoding where it is needed again: it costs less than to keep it.
#pragma once
#include "../one_ray.h"

namespace {

// Largest numbers of a field's inputs, hidden units and outputs, and of a head's layer, that a thread has room for.
constexpr int MAX_INPUTS = 128, MAX_HIDDEN = 128, MAX_OUTPUTS = 64, MAX_WIDTH = 128;

UNISIM_DEVICE inline float exp_of(float x) { return std::exp(x); }
// Opacity of an optical depth: 1 - exp(-x) for x >= 0.
UNISIM_DEVICE inline float opacity_of(float x) { return -std::expm1(-x); }
UNISIM_DEVICE inline float softplus(float x) { return (x > 0 ? x : 0.0f) + std::log1p(std::exp(-std::fabs(x))); }
UNISIM_DEVICE inline float sigmoid(float x) {
    const float e = std::exp(-std::fabs(x));
    return (x >= 0 ? 1.0f : e) / (1 + e);
}
// -log Phi(s): the optical depth in front of a place where the distance is s; 0 where that is too small to be visible.
UNISIM_DEVICE inline float optical_depth_at(float s, float beta) {
    const float a = -beta * s;
    return a < -12.0f ? 0.0f : softplus(a);
}
// NaN where b is NaN.
UNISIM_DEVICE inline float greater_of(float a, float b) { return a > b ? a : b; }
UNISIM_DEVICE inline float lesser_of(float a, float b) { return a < b ? a : b; }

UNISIM_DEVICE inline float float_of(float x) { return x; }

// Any half except infinities and NaN: scenes with these are not opened.
UNISIM_DEVICE inline float float_of(uint16_t h) {
    union {
        uint32_t bits;
        float x;
    } magnitude{static_cast<uint32_t>(h & 0x7fff) << 13};
    const float x = magnitude.x * 0x1p112f;
    return h & 0x8000 ? -x : x;
}

// Four numbers; where they lie at a multiple of their size, as rows of tables do, a GPU loads them at once.
template <class T> struct alignas(4 * sizeof(T)) Four {
    T a, b, c, d;
};
template <class T> UNISIM_DEVICE inline Four<T> load_four(const T *at) {
#if defined(__CUDA_ARCH__)
    return *reinterpret_cast<const Four<T> *>(at);
#else
    return {at[0], at[1], at[2], at[3]};
#endif
}

// The cell of one level of a grid in which a point x of the unit cube lies: its lower vertex, and the fractions behind it.
struct GridCell {
    uint32_t lower[3];
    float fraction[3];

    UNISIM_DEVICE GridCell(const unisim_grid &g, int level, const float *x) {
        for (int a = 0; a < 3; ++a) {
            const float scale = g.scale[level * 3 + a], last = std::fmax(std::ceil(scale) - 1.0f, 0.0f);
            // NaN and points outside the cube are clamped to its nearest face
            float p = x[a] * scale;
            p = p > 0.0f ? p : 0.0f;
            p = p < scale ? p : scale;
            float cell = static_cast<float>(static_cast<int32_t>(p));
            cell = cell < last ? cell : last;
            lower[a] = static_cast<uint32_t>(cell);
            fraction[a] = p - cell;
        }
    }

    // The row of one of its corners in a level with strides sy and sz, or of the hash that `mask` ends.
    UNISIM_DEVICE uint32_t row(int corner, uint32_t sy, uint32_t sz, uint32_t mask) const {
        const uint32_t i = lower[0] + (corner & 1), j = lower[1] + (corner >> 1 & 1), k = lower[2] + (corner >> 2);
        return sy ? i + j * sy + k * sz : (i ^ j * 2654435761u ^ k * 805459861u) & mask;
    }

    // The weight of a corner along one axis.
    UNISIM_DEVICE float along(int corner, int axis) const {
        return corner >> axis & 1 ? fraction[axis] : 1 - fraction[axis];
    }

    UNISIM_DEVICE float weight(int corner) const { return along(corner, 0) * along(corner, 1) * along(corner, 2); }
};

// The encoding (levels, features) of a point x of the unit cube by one of a field's grids. FEATURES and LEVELS 0: as
// many as the grid has; else exactly so many, which stay in registers.
template <int FEATURES, int LEVELS, class T>
UNISIM_DEVICE inline void encode(const unisim_grid &g, const T *tables, int32_t grid, const float *x, float *code) {
    const int features = FEATURES ? FEATURES : g.features, levels = LEVELS ? LEVELS : g.levels;
    UNISIM_UNROLL
    for (int level = 0; level < levels; ++level) {
        const GridCell cell(g, level, x);
        const uint32_t sy = g.stride_y[level], sz = g.stride_z[level], mask = g.size[level] - 1;
        const T *base = tables + (grid * g.grid_stride + g.offset[level]) * features;
        float *sum = code + level * features;
        for (int f = 0; f < features; ++f) sum[f] = 0;
        for (int corner = 0; corner < 8; ++corner) {
            const float weight = cell.weight(corner);
            const T *values = base + static_cast<int64_t>(cell.row(corner, sy, sz, mask)) * features;
            if constexpr (FEATURES == 4) {
                const Four<T> row = load_four(values);
                sum[0] += weight * float_of(row.a);
                sum[1] += weight * float_of(row.b);
                sum[2] += weight * float_of(row.c);
                sum[3] += weight * float_of(row.d);
            } else
                for (int f = 0; f < features; ++f) sum[f] += weight * float_of(values[f]);
        }
    }
}

// The perceptron at one encoded point: the first output, and hidden units by weight into `units`, where that is not
// null. INPUTS 0: as many as the network has; else exactly so many, which stay in registers. ALIGNED: w1 lies at a multiple
// of 16 bytes, and INPUTS are fours.
template <int INPUTS, bool ALIGNED = false>
UNISIM_DEVICE inline float evaluate_network(const unisim_mlp &net, const float *code, float weight, float *units) {
    const int inputs = INPUTS ? INPUTS : net.inputs;
    float first = 0;
    for (int j = 0; j < net.hidden; ++j) {
        const float *w = net.w1 + j * inputs;
        float unit = 0;
        UNISIM_UNROLL
        for (int i = 0; i < inputs; i += ALIGNED ? 4 : 1) {
            if constexpr (ALIGNED) {
                const Four<float> of = load_four(w + i);
                unit += of.a * code[i];
                unit += of.b * code[i + 1];
                unit += of.c * code[i + 2];
                unit += of.d * code[i + 3];
            } else
                unit += w[i] * code[i];
        }
        unit = unit > 0 ? unit : 0.0f;
        first += net.w2[j] * unit;
        if (units) units[j] += weight * unit;
    }
    return first + net.bias[0];
}

// Evaluates a field at a point of its unit cube: returns the first output, a signed distance or the logarithm of a
// density. Adds hidden units by weight to `units`, where that is not null.
UNISIM_CALLED float evaluate_field(const unisim_field &field, int32_t grid, const float *x, float weight,
                                   float *units) {
    if (field.half && field.grid.features == 4 && field.grid.levels == 8) {
        float code[32];
        encode<4, 8>(field.grid, static_cast<const uint16_t *>(field.table), grid, x, code);
        return evaluate_network<32, true>(field.net, code, weight, units);
    }
    float code[MAX_INPUTS];
    if (field.half)
        encode<0, 0>(field.grid, static_cast<const uint16_t *>(field.table), grid, x, code);
    else
        encode<0, 0>(field.grid, static_cast<const float *>(field.table), grid, x, code);
    return evaluate_network<0>(field.net, code, weight, units);
}

// out (outputs - 1): the other outputs of hidden units, which are summed by weights of so much in all.
UNISIM_DEVICE inline void project(const unisim_mlp &net, const float *units, float weight, float *out) {
    for (int f = 0; f + 1 < net.outputs; ++f) {
        const float *w = net.w2 + (f + 1) * net.hidden;
        float sum = 0;
        for (int j = 0; j < net.hidden; ++j) sum += w[j] * units[j];
        out[f] = sum + weight * net.bias[f + 1];
    }
}

} // namespace
