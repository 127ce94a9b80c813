// Blocks of an image that is traced adaptively (block.h). This file is compiled without fused multiply-add, so the bits
// are numpy's.
#include "block.h"
#include "variant.h"

namespace {

// The block whose first pixel is in this row and column.
Block block_at(const int64_t *at, int64_t width, int32_t size) { return {at[0] * width + at[1], width, size}; }

} // namespace

// verdict (n) of blocks (n, 2) whose corners are known: 1 where these differ, 2 where the middle decides, else 0.
extern "C" int UNISIM_NAME(unisim_blocks_differ)(const unisim_plane *planes, int32_t count, const int64_t *blocks,
                                                 int64_t n, int64_t width, int32_t size,
                                                 const unisim_block_tolerance *tolerance, uint8_t *verdict,
                                                 int threads) {
    parallel_blocks(n, 4096, threads, [&](int64_t begin, int64_t end) {
        for (int64_t i = begin; i < end; ++i) {
            float range = 0;
            const bool different = differ(planes, count, block_at(blocks + 2 * i, width, size), *tolerance, range);
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
            alike[i] = predicted(planes, count, block_at(blocks + 2 * i, width, size), *tolerance);
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
            for (int64_t n = begin; n < end; ++n) {
                const Block block = block_at(blocks + 2 * n, width, size);
                const BlockValues from(planes[k], block, known);
                for (int32_t i = 0; i < size; ++i)
                    for (int32_t j = 0; j < size; ++j)
                        if (!known[block.corner[0] + i * width + j]) fill(planes[k], block, from, width, size, i, j);
            }
    });
    return 0;
}
