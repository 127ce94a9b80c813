// Blocks of an image that is traced adaptively: which have different corners, whose middles are as predicted, and
// interpolation.
//
// The specification is plain numpy, in core/render/lattice.py. Operations and their order are the same, and
// this file is compiled without fused multiply-add, so the bits are the same.
#include "variant.h"

#include <cmath>

namespace {

enum Kind : int32_t { COLOUR, DISPARITY, UNIT, PLAIN, LABEL, NEAR_BOX, COPIED };

// NaN stays NaN, as in numpy's max and min.
inline float larger(float a, float b) { return a != a || a > b ? a : b; }
inline float smaller(float a, float b) { return a != a || a < b ? a : b; }

// One block: the numbers of the pixels at its corners and in its middle.
struct Block {
    int64_t corner[4], middle;

    Block(const int64_t *at, int64_t width, int32_t size) {
        const int64_t first = at[0] * width + at[1];
        corner[0] = first;
        corner[1] = first + size;
        corner[2] = first + size * width;
        corner[3] = first + size * width + size;
        middle = first + size / 2 * (width + 1);
    }
};

inline const float *floats_of(const unisim_plane &plane, int64_t pixel) {
    return static_cast<const float *>(plane.values) + pixel * plane.channels;
}
inline char *label_of(const unisim_plane &plane, int64_t pixel) {
    return static_cast<char *>(plane.values) + pixel * plane.bytes;
}
inline bool same_label(const unisim_plane &plane, int64_t a, int64_t b) {
    return std::equal(label_of(plane, a), label_of(plane, a) + plane.bytes, label_of(plane, b));
}

// The values at the corners of a block that are interpolated: disparities in place of depths.
inline void at_corners(const unisim_plane &plane, const Block &block, int channel, float *at) {
    for (int i = 0; i < 4; ++i) {
        const float x = floats_of(plane, block.corner[i])[channel];
        at[i] = plane.kind == DISPARITY ? 1.0f / x : x;
    }
}

inline float mean_of(const float *at) { return (((at[0] + at[1]) + at[2]) + at[3]) / 4.0f; }

bool differ(const unisim_plane *planes, int32_t count, const Block &block, const unisim_block_tolerance &tolerance,
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

bool predicted(const unisim_plane *planes, int32_t count, const Block &block, const unisim_block_tolerance &tolerance) {
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

void fill(const unisim_plane &plane, const Block &block, int64_t width, int32_t size, const uint8_t *known) {
    if (plane.kind >= LABEL) {
        for (int32_t i = 0; i < size; ++i)
            for (int32_t j = 0; j < size; ++j) {
                const int64_t pixel = block.corner[0] + i * width + j;
                if (!known[pixel]) std::copy_n(label_of(plane, block.corner[0]), plane.bytes, label_of(plane, pixel));
            }
        return;
    }
    float at[MAX_CHANNELS][4], off[MAX_CHANNELS] = {};
    const bool traced = known[block.middle]; // then the interpolation is bent to it
    for (int c = 0; c < plane.channels; ++c) {
        at_corners(plane, block, c, at[c]);
        if (!traced) continue;
        const float value = floats_of(plane, block.middle)[c];
        off[c] = (plane.kind == DISPARITY ? 1.0f / value : value) - mean_of(at[c]);
    }
    for (int32_t i = 0; i < size; ++i)
        for (int32_t j = 0; j < size; ++j) {
            const int64_t pixel = block.corner[0] + i * width + j;
            if (known[pixel]) continue;
            const float v = static_cast<float>(i) / static_cast<float>(size),
                        u = static_cast<float>(j) / static_cast<float>(size);
            const float weight[4] = {(1 - v) * (1 - u), (1 - v) * u, v * (1 - u), v * u};
            const float tent = (1 - std::fabs(2 * v - 1)) * (1 - std::fabs(2 * u - 1));
            float mixed[MAX_CHANNELS];
            for (int c = 0; c < plane.channels; ++c) {
                mixed[c] =
                    ((weight[0] * at[c][0] + weight[1] * at[c][1]) + weight[2] * at[c][2]) + weight[3] * at[c][3];
                if (traced) mixed[c] += tent * off[c];
            }
            if (plane.kind == UNIT) {
                const float square = (mixed[0] * mixed[0] + mixed[1] * mixed[1]) + mixed[2] * mixed[2];
                const float length = larger(std::sqrt(square), 1e-12f);
                for (int c = 0; c < 3; ++c) mixed[c] /= length;
            }
            float *out = static_cast<float *>(plane.values) + pixel * plane.channels;
            for (int c = 0; c < plane.channels; ++c) out[c] = plane.kind == DISPARITY ? 1.0f / mixed[c] : mixed[c];
        }
}

} // namespace

// verdict (n) of blocks (n, 2) whose corners are known: 1 where these differ, 2 where the middle decides, else 0.
extern "C" int UNISIM_NAME(unisim_blocks_differ)(const unisim_plane *planes, int32_t count, const int64_t *blocks,
                                                 int64_t n, int64_t width, int32_t size,
                                                 const unisim_block_tolerance *tolerance, uint8_t *verdict,
                                                 int threads) {
    parallel_blocks(n, 4096, threads, [&](int64_t begin, int64_t end) {
        for (int64_t i = begin; i < end; ++i) {
            float range = 0;
            const bool different = differ(planes, count, Block(blocks + 2 * i, width, size), *tolerance, range);
            verdict[i] = different ? 1 : range > tolerance->spread ? 2 : 0;
        }
    });
    return 0;
}

// alike (n): whether the middles of blocks (n, 2) are as their corners predict.
extern "C" int UNISIM_NAME(unisim_blocks_predicted)(const unisim_plane *planes, int32_t count, const int64_t *blocks,
                                                    int64_t n, int64_t width, int32_t size,
                                                    const unisim_block_tolerance *tolerance, uint8_t *alike,
                                                    int threads) {
    parallel_blocks(n, 4096, threads, [&](int64_t begin, int64_t end) {
        for (int64_t i = begin; i < end; ++i)
            alike[i] = predicted(planes, count, Block(blocks + 2 * i, width, size), *tolerance);
    });
    return 0;
}

// Interpolates blocks (n, 2) at pixels that are not `known` (h w). Blocks overlap at most in their last rows and
// columns.
extern "C" int UNISIM_NAME(unisim_blocks_fill)(const unisim_plane *planes, int32_t count, const int64_t *blocks,
                                               int64_t n, int64_t width, int32_t size, const uint8_t *known,
                                               int threads) {
    parallel_blocks(n, 1024, threads, [&](int64_t begin, int64_t end) {
        for (int32_t k = 0; k < count; ++k)
            for (int64_t i = begin; i < end; ++i)
                fill(planes[k], Block(blocks + 2 * i, width, size), width, size, known);
    });
    return 0;
}
