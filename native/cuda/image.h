// An image traced adaptively on the device: the rays of its pixels, which of them are traced, their colours from
// composited features, and interpolation in between. Nothing is decided on the host.
//
// `core/render/lattice.py` is the specification of the blocks, `core/sensors/camera.py` of the rays, and
// `core/model/decode.py` of the colours. Every function does the work of one thread.
#pragma once
#include "../block.h"
#include "trace_ray.h"

namespace {

// What an image needs beside `TraceInputs`, whose rays and results are numbered by its pixels: row by row, `height` rows
// and `width` columns from `top` and `left` of the camera's image. Where `up` is not 1, they are cells of up x up pixels,
// with rays through their middles, and all of them are traced.
struct ImageInputs {
    int32_t height, width, top, left;
    int32_t up;
    int32_t lens_width;       // columns of `lens`
    int32_t reads_columns;    // whether the shutter reads columns: these are the lines then
    double fx, fy, cx, cy;    // of a pinhole, pixels
    const double *lens;       // (the camera's rows, lens_width, 3): unit directions, camera frame; null: a pinhole
    const double *poses;      // (lines, 3, 4): world from camera when a line is exposed
    const double *line_times; // (lines), seconds
    double axis[3];           // the optical axis at the image's time
    double *origins, *directions, *times; // the same arrays as of `TraceInputs`
    unisim_head head;                     // with the camera's code in its bias
    const unisim_layer *convolutions;     // kernels of 1: two per residual block, then the last one
    int32_t convolution_count;
    int32_t size; // of the lattice's blocks, a power of two
    const unisim_plane *planes;
    int32_t plane_count;
    unisim_block_tolerance tolerance;
    const uint8_t *observed; // (X, Y, Z) of the scene's voxels; null: `unsupported` is not wanted
    float *rgb, *along;      // (h w, 3), (h w): along the optical axis, null: not wanted
    uint8_t *unsupported;    // (h w)
    uint8_t *wanted, *known; // (h w): pixels to trace next, and those that were traced
    uint8_t *blocks;         // what becomes of the blocks of each size, the largest first
    int64_t *order;          // (h w): numbers of the pixels that are traced next
    int64_t *counts;         // (launches): how many
};

enum BlockState : uint8_t { UNUSED, UNDECIDED, DOUBTFUL, LEAF, SPLIT };

UNISIM_DEVICE inline int32_t last_line(int32_t count, int32_t size) { return (count - 1) / size * size; }

// The blocks of one size.
struct BlockGrid {
    uint8_t *states;
    int32_t rows, columns, size;

    UNISIM_DEVICE BlockGrid(const ImageInputs &image, int32_t size) : states(image.blocks), size(size) {
        const int32_t last_row = last_line(image.height, image.size), last_column = last_line(image.width, image.size);
        for (int32_t larger = image.size; larger > size; larger /= 2)
            states += static_cast<int64_t>(last_row / larger) * (last_column / larger);
        rows = last_row / size;
        columns = last_column / size;
    }
    UNISIM_DEVICE uint8_t &at(int32_t row, int32_t column) const {
        return states[static_cast<int64_t>(row) * columns + column];
    }
    UNISIM_DEVICE Block block(const ImageInputs &image, int32_t row, int32_t column) const {
        return {static_cast<int64_t>(row) * size * image.width + column * size, image.width, size};
    }
};

// The ray of a pixel, and whether it is among those that are traced first: the lattice, and the lines where no block
// begins.
UNISIM_DEVICE inline void begin_pixel(const ImageInputs &image, int64_t pixel) {
    const int32_t row = static_cast<int32_t>(pixel / image.width), column = static_cast<int32_t>(pixel % image.width);
    double local[3];
    if (image.lens) {
        const int64_t at = static_cast<int64_t>(image.top + row) * image.lens_width + image.left + column;
        for (int a = 0; a < 3; ++a) local[a] = image.lens[3 * at + a];
    } else {
        const double x = ((image.left + column + 0.5) * image.up - image.cx) / image.fx,
                     y = ((image.top + row + 0.5) * image.up - image.cy) / image.fy,
                     length = std::sqrt(x * x + (y * y + 1));
        local[0] = x / length;
        local[1] = y / length;
        local[2] = 1 / length;
    }
    const int32_t line = image.reads_columns ? column : row;
    const double *pose = image.poses + 12 * line;
    double along = 0;
    for (int a = 0; a < 3; ++a) {
        const double direction =
            pose[4 * a] * local[0] + pose[4 * a + 1] * local[1] + pose[4 * a + 2] * local[2];
        image.origins[3 * pixel + a] = pose[4 * a + 3];
        image.directions[3 * pixel + a] = direction;
        along += direction * image.axis[a];
    }
    image.times[pixel] = image.line_times[line];
    if (image.along) image.along[pixel] = static_cast<float>(along);
    const int32_t size = image.size, last_row = last_line(image.height, size), last_column = last_line(image.width, size);
    image.known[pixel] = 0;
    image.wanted[pixel] = row >= last_row || column >= last_column || (row % size == 0 && column % size == 0);
    if (size > 1 && row < last_row && column < last_column && row % size == 0 && column % size == 0)
        BlockGrid(image, size).at(row / size, column / size) = UNDECIDED;
}

// Appends the wanted pixels of a tile, 8 of `stride` apart in each direction, to the order.
UNISIM_DEVICE inline void collect_tile(const ImageInputs &image, int32_t stride, int64_t tile, int64_t *count) {
    const int32_t side = 8 * stride, across = (image.width + side - 1) / side;
    const int32_t top = static_cast<int32_t>(tile / across) * side, left = static_cast<int32_t>(tile % across) * side;
    int64_t wanted = 0, slot = 0;
    for (int pass = 0; pass < 2; ++pass) {
        if (pass) {
            if (!wanted) return;
            slot = static_cast<int64_t>(atomicAdd(reinterpret_cast<unsigned long long *>(count),
                                                  static_cast<unsigned long long>(wanted)));
        }
        for (int32_t row = top; row < top + side && row < image.height; row += stride)
            for (int32_t column = left; column < left + side && column < image.width; column += stride) {
                const int64_t pixel = static_cast<int64_t>(row) * image.width + column;
                if (!image.wanted[pixel]) continue;
                if (!pass) {
                    wanted += !image.known[pixel];
                    continue;
                }
                image.wanted[pixel] = 0;
                if (image.known[pixel]) continue;
                image.known[pixel] = 1;
                image.order[slot++] = pixel;
            }
    }
}

// out (outputs) = weight x + bias.
UNISIM_DEVICE inline void apply_layer(const unisim_layer &layer, const float *x, float *out) {
    constexpr int OUTPUTS = 4; // that are summed at the same time
    for (int first = 0; first < layer.outputs; first += OUTPUTS) {
        const int count = layer.outputs - first < OUTPUTS ? layer.outputs - first : OUTPUTS;
        float sum[OUTPUTS];
        const float *row[OUTPUTS];
        for (int o = 0; o < OUTPUTS; ++o) {
            const int output = first + (o < count ? o : 0);
            sum[o] = layer.bias ? layer.bias[output] : 0.0f;
            row[o] = layer.weight + static_cast<int64_t>(output) * layer.inputs;
        }
        for (int i = 0; i < layer.inputs; ++i)
            for (int o = 0; o < OUTPUTS; ++o) sum[o] += row[o][i] * x[i];
        for (int o = 0; o < count; ++o) out[first + o] = sum[o];
    }
}

UNISIM_DEVICE inline void apply_relu(float *x, int count, float *out) {
    for (int i = 0; i < count; ++i) out[i] = x[i] > 0 ? x[i] : 0.0f;
}

// Runs a head; x: its outputs, active: their ReLU.
UNISIM_DEVICE inline void run_head(const unisim_head &head, const float *feature, const double *direction,
                                   const float *extra, float *x, float *active) {
    const float to[3] = {static_cast<float>(direction[0]), static_cast<float>(direction[1]),
                         static_cast<float>(direction[2])};
    for (int f = 0; f < head.features; ++f) active[f] = feature[f];
    spherical_harmonics(to, active + head.features);
    for (int i = 0; i < head.extra_inputs; ++i) active[head.features + 16 + i] = extra[i];
    for (int i = 0; i < head.count; ++i) {
        apply_layer(head.layers[i], active, x);
        apply_relu(x, head.layers[i].outputs, active);
    }
}

// Decodes the feature of a pixel, or of a cell's pixels, into the image.
UNISIM_DEVICE inline void decode(const ImageInputs &image, const float *feature, const double *direction,
                                 int64_t pixel) {
    float x[MAX_WIDTH], active[MAX_WIDTH], inner[MAX_WIDTH];
    run_head(image.head, feature, direction, nullptr, x, active);
    for (int i = 0; i + 1 < image.convolution_count; i += 2) {
        const unisim_layer &second = image.convolutions[i + 1];
        apply_layer(image.convolutions[i], active, inner);
        apply_relu(inner, image.convolutions[i].outputs, active);
        apply_layer(second, active, inner);
        for (int c = 0; c < second.outputs; ++c) x[c] += inner[c];
        apply_relu(x, second.outputs, active);
    }
    apply_layer(image.convolutions[image.convolution_count - 1], active, inner);
    const int64_t row = pixel / image.width, column = pixel % image.width;
    const int line = 3 * image.up;
    for (int i = 0; i < image.up; ++i) {
        float *out = image.rgb + ((row * image.up + i) * image.width + column) * line;
        for (int j = 0; j < line; ++j) out[j] = sigmoid(inner[i * line + j]);
    }
}

// The colour of a traced pixel, and its passes as an image has them.
UNISIM_DEVICE inline void finish_pixel(const TraceInputs &in, const ImageInputs &image, int64_t pixel) {
    const double *origin = image.origins + 3 * pixel, *direction = image.directions + 3 * pixel;
    decode(image, in.result.feature + pixel * image.head.features, direction, pixel);
    if (!in.result.median) return;
    float &depth = in.result.median[pixel];
    const bool solid = in.result.opacity[pixel] > 0.5f;
    if (!solid) depth = HUGE_VALF;
    if (!image.observed) return;
    const double end_m = solid ? static_cast<double>(depth) : 1e6;
    const double end[3] = {origin[0] + direction[0] * end_m, origin[1] + direction[1] * end_m,
                           origin[2] + direction[2] * end_m};
    const double *m = in.scene.volume_from_world;
    bool outside = false;
    int64_t cell = 0;
    for (int a = 0; a < 3; ++a) {
        const double x = m[4 * a] * end[0] + m[4 * a + 1] * end[1] + m[4 * a + 2] * end[2] + m[4 * a + 3];
        const int32_t last = in.scene.voxel_shape[a] - 1;
        const double index = std::floor(x / static_cast<double>(in.scene.voxel_m));
        outside |= x < 0 || x > static_cast<double>(in.scene.size[a]);
        cell = cell * in.scene.voxel_shape[a] + (index < 0 ? 0 : index > last ? last : static_cast<int32_t>(index));
    }
    image.unsupported[pixel] = !(outside || image.observed[cell] > 0 || in.result.instance[pixel] > 0);
}

// Has a block's inner pixels traced, and its quarters decided.
UNISIM_DEVICE inline void split_block(const ImageInputs &image, const BlockGrid &grid, int32_t row, int32_t column) {
    const int32_t half = grid.size / 2;
    const Block block = grid.block(image, row, column);
    grid.at(row, column) = SPLIT;
    image.wanted[block.middle] = 1;
    image.wanted[block.corner[0] + half] = image.wanted[block.corner[2] + half] = 1;
    image.wanted[block.corner[0] + static_cast<int64_t>(half) * image.width] = 1;
    image.wanted[block.corner[1] + static_cast<int64_t>(half) * image.width] = 1;
    if (half == 1) return;
    const BlockGrid quarters(image, half);
    for (int i = 0; i < 4; ++i) quarters.at(2 * row + i / 2, 2 * column + i % 2) = UNDECIDED;
}

// Decides about a block whose corners are known: it is split, has its middle traced, or is left.
UNISIM_DEVICE inline void judge_block(const ImageInputs &image, int32_t size, int64_t number) {
    const BlockGrid grid(image, size);
    const int32_t row = static_cast<int32_t>(number / grid.columns), column = static_cast<int32_t>(number % grid.columns);
    if (grid.at(row, column) != UNDECIDED) return;
    const Block block = grid.block(image, row, column);
    float range = 0;
    if (differ(image.planes, image.plane_count, block, image.tolerance, range)) {
        split_block(image, grid, row, column);
        return;
    }
    const bool doubtful = range > image.tolerance.spread;
    grid.at(row, column) = doubtful ? DOUBTFUL : LEAF;
    if (doubtful) image.wanted[block.middle] = 1;
}

// Decides about a block by its middle, where that is needed.
UNISIM_DEVICE inline void judge_middle(const ImageInputs &image, int32_t size, int64_t number) {
    const BlockGrid grid(image, size);
    const int32_t row = static_cast<int32_t>(number / grid.columns), column = static_cast<int32_t>(number % grid.columns);
    if (grid.at(row, column) != DOUBTFUL) return;
    if (predicted(image.planes, image.plane_count, grid.block(image, row, column), image.tolerance))
        grid.at(row, column) = LEAF;
    else
        split_block(image, grid, row, column);
}

// Interpolates a pixel that was not traced, in the block that holds it.
UNISIM_DEVICE inline void fill_pixel(const ImageInputs &image, int64_t pixel) {
    if (image.known[pixel]) return;
    const int32_t row = static_cast<int32_t>(pixel / image.width), column = static_cast<int32_t>(pixel % image.width);
    for (int32_t size = image.size; size > 1; size /= 2) {
        const BlockGrid grid(image, size);
        if (grid.at(row / size, column / size) != LEAF) continue;
        const Block block = grid.block(image, row / size, column / size);
        for (int32_t k = 0; k < image.plane_count; ++k)
            fill(image.planes[k], block, BlockValues(image.planes[k], block, image.known), image.width, size,
                 row % size, column % size);
        return;
    }
}

} // namespace
