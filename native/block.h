// Blocks of an image that is traced adaptively: which have different corners, whose middles are as predicted, and
// interpolation. The CPU's kernels and the GPU's (cuda/) share them.
//
// The specification is plain numpy, in core/render/lattice.py. Operations and their order are the same.
#pragma once
#include "one_ray.h"

namespace {

enum PlaneKind : int32_t { COLOUR, DISPARITY, UNIT, PLAIN, LABEL, NEAR_BOX, COPIED };

// NaN stays NaN, as in numpy's max and min.
UNISIM_DEVICE inline float larger(float a, float b) { return a != a || a > b ? a : b; }
UNISIM_DEVICE inline float smaller(float a, float b) { return a != a || a < b ? a : b; }

// One block: the numbers of the pixels at its corners and in its middle.
struct Block {
    int64_t corner[4], middle;

    UNISIM_DEVICE Block(int64_t first, int64_t width, int32_t size) {
        corner[0] = first;
        corner[1] = first + size;
        corner[2] = first + size * width;
        corner[3] = first + size * width + size;
        middle = first + size / 2 * (width + 1);
    }
};

UNISIM_DEVICE inline const float *floats_of(const unisim_plane &plane, int64_t pixel) {
    return static_cast<const float *>(plane.values) + pixel * plane.channels;
}
UNISIM_DEVICE inline char *label_of(const unisim_plane &plane, int64_t pixel) {
    return static_cast<char *>(plane.values) + pixel * plane.bytes;
}
UNISIM_DEVICE inline bool same_label(const unisim_plane &plane, int64_t a, int64_t b) {
    const char *first = label_of(plane, a), *second = label_of(plane, b);
    for (int32_t i = 0; i < plane.bytes; ++i)
        if (first[i] != second[i]) return false;
    return true;
}

// The values at the corners of a block that are interpolated: disparities in place of depths.
UNISIM_DEVICE inline void at_corners(const unisim_plane &plane, const Block &block, int channel, float *at) {
    for (int i = 0; i < 4; ++i) {
        const float x = floats_of(plane, block.corner[i])[channel];
        at[i] = plane.kind == DISPARITY ? 1.0f / x : x;
    }
}

UNISIM_DEVICE inline float mean_of(const float *at) { return (((at[0] + at[1]) + at[2]) + at[3]) / 4.0f; }

UNISIM_DEVICE inline bool differ(const unisim_plane *planes, int32_t count, const Block &block, const unisim_block_tolerance &tolerance,
            float &range) {
    bool different = false;
    for (int32_t n = 0; n < count; ++n) {
        const unisim_plane &plane = planes[n];
        float at[4];
        if (plane.kind == COLOUR) {
            for (int c = 0; c < plane.channels; ++c) {
                at_corners(plane, block, c, at);
                const float range_of_channel = larger(larger(larger(at[0], at[1]), at[2]), at[3]) -
                                               smaller(smaller(smaller(at[0], at[1]), at[2]), at[3]);
                range = c ? larger(range, range_of_channel) : range_of_channel;
            }
            different |= range > tolerance.contrast;
        } else if (plane.kind == DISPARITY) {
            at_corners(plane, block, 0, at);
            const float largest = larger(larger(larger(at[0], at[1]), at[2]), at[3]),
                        smallest = smaller(smaller(smaller(at[0], at[1]), at[2]), at[3]);
            const float twist = std::fabs(((at[0] + at[3]) - at[1]) - at[2]);
            different |= largest - smallest > tolerance.range * largest || twist > tolerance.twist * largest;
        } else if (plane.kind == LABEL || plane.kind == NEAR_BOX) {
            for (int i = plane.kind == LABEL; i < 4; ++i)
                different |= plane.kind == LABEL ? !same_label(plane, block.corner[0], block.corner[i])
                                                 : *label_of(plane, block.corner[i]) != 0;
        }
    }
    return different;
}

UNISIM_DEVICE inline bool predicted(const unisim_plane *planes, int32_t count, const Block &block, const unisim_block_tolerance &tolerance) {
    bool alike = true;
    for (int32_t n = 0; n < count; ++n) {
        const unisim_plane &plane = planes[n];
        float at[4];
        if (plane.kind == COLOUR) {
            float off = 0;
            for (int c = 0; c < plane.channels; ++c) {
                at_corners(plane, block, c, at);
                const float here = std::fabs(floats_of(plane, block.middle)[c] - mean_of(at));
                off = c ? larger(off, here) : here;
            }
            alike &= off <= tolerance.prediction;
        } else if (plane.kind == DISPARITY) {
            at_corners(plane, block, 0, at);
            const float largest = larger(larger(larger(at[0], at[1]), at[2]), at[3]);
            alike &= std::fabs(1.0f / *floats_of(plane, block.middle) - mean_of(at)) <= tolerance.twist * largest;
        } else if (plane.kind == LABEL)
            alike &= same_label(plane, block.middle, block.corner[0]);
    }
    return alike;
}

constexpr int MAX_CHANNELS = 4;

// What the pixels of one block are interpolated from.
struct BlockValues {
    float at[MAX_CHANNELS][4], off[MAX_CHANNELS] = {};
    bool traced; // whether its middle was: then the interpolation is bent to it

    UNISIM_DEVICE BlockValues(const unisim_plane &plane, const Block &block, const uint8_t *known)
        : traced(known[block.middle]) {
        if (plane.kind >= LABEL) return;
        for (int c = 0; c < plane.channels; ++c) {
            at_corners(plane, block, c, at[c]);
            if (!traced) continue;
            const float value = floats_of(plane, block.middle)[c];
            off[c] = (plane.kind == DISPARITY ? 1.0f / value : value) - mean_of(at[c]);
        }
    }
};

// Interpolates the pixel in row i and column j of a block.
UNISIM_DEVICE inline void fill(const unisim_plane &plane, const Block &block, const BlockValues &from, int64_t width,
                               int32_t size, int32_t i, int32_t j) {
    const int64_t pixel = block.corner[0] + i * width + j;
    if (plane.kind >= LABEL) {
        for (int32_t k = 0; k < plane.bytes; ++k) label_of(plane, pixel)[k] = label_of(plane, block.corner[0])[k];
        return;
    }
    const float v = static_cast<float>(i) / static_cast<float>(size),
                u = static_cast<float>(j) / static_cast<float>(size);
    const float weight[4] = {(1 - v) * (1 - u), (1 - v) * u, v * (1 - u), v * u};
    const float tent = (1 - std::fabs(2 * v - 1)) * (1 - std::fabs(2 * u - 1));
    float mixed[MAX_CHANNELS];
    for (int c = 0; c < plane.channels; ++c) {
        const float *at = from.at[c];
        mixed[c] = ((weight[0] * at[0] + weight[1] * at[1]) + weight[2] * at[2]) + weight[3] * at[3];
        if (from.traced) mixed[c] += tent * from.off[c];
    }
    if (plane.kind == UNIT) {
        const float square = (mixed[0] * mixed[0] + mixed[1] * mixed[1]) + mixed[2] * mixed[2];
        const float length = larger(std::sqrt(square), 1e-12f);
        for (int c = 0; c < 3; ++c) mixed[c] /= length;
    }
    float *out = static_cast<float *>(plane.values) + pixel * plane.channels;
    for (int c = 0; c < plane.channels; ++c) out[c] = plane.kind == DISPARITY ? 1.0f / mixed[c] : mixed[c];
}

} // namespace
