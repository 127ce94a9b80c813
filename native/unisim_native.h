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

// A convolution with edges repeated, `kernel` odd; a linear layer is one of a single tap.
struct unisim_layer {
    int32_t inputs;
    int32_t outputs;
    int32_t kernel;
    const float *weight; // (outputs, inputs, kernel, kernel)
    const float *bias;   // (outputs), or null
};

// A perceptron of `features` inputs, the 16 spherical harmonics of a direction and `extras` further inputs.
struct unisim_head {
    int32_t features;
    int32_t extras;
    int32_t count; // of layers
    const unisim_layer *layers;
};
