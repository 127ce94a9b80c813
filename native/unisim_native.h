// The plain C interface of the kernels. Every array is contiguous and belongs to the caller; nothing here keeps a pointer.
#pragma once
#include <cstdint>

// A multiresolution grid: `levels` tables one behind the other, `grids` such grids `grid_stride` rows apart.
// Level l: vertex (i, j, k) is row offset[l] + (i + j * stride_y[l] + k * stride_z[l]) where stride_y[l] != 0,
// else row offset[l] + (hash(i, j, k) & (size[l] - 1)), the hash of Mueller et al., "Instant Neural Graphics Primitives", 2022.
struct unisim_grid {
    int32_t levels;
    int32_t features;
    int64_t grid_stride;
    const float *scale;        // (levels, 3): vertices along each axis of the unit cube, less one
    const int64_t *offset;     // (levels)
    const uint32_t *size;      // (levels)
    const uint32_t *stride_y;  // (levels)
    const uint32_t *stride_z;  // (levels)
};

// A perceptron of two layers: out = w2 relu(w1 x) + bias.
struct unisim_mlp {
    int32_t inputs;
    int32_t hidden;
    int32_t outputs;
    const float *w1;   // (hidden, inputs)
    const float *w2;   // (outputs, hidden)
    const float *bias; // (outputs)
};

// A box over triangles. `faces` > 0: a leaf that holds order[first .. first + faces); 0: its children are nodes first and first + 1.
struct unisim_bvh_node {
    float low[3];
    int32_t first;
    float high[3];
    int32_t faces;
};

// Strands of one medium: ray (n); samples t, optical depths tau of intervals and shares of where they stop (n, width).
struct unisim_strands {
    int64_t n;
    int32_t width;
    const int64_t *ray;
    const float *t;
    const float *tau;
    const float *share;
};
