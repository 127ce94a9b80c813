// Evaluates a field in one pass: the grid's encoding and the network, over tiles of points, so that no encoding is
// written to memory.
#include "variant.h"

// out (n, outputs) at points x (n, 3) in the unit cube; grid (n) is the number of each point's grid, null where there
// is one grid.
extern "C" int UNISIM_NAME(unisim_field_forward)(const unisim_grid *g, const float *x, const int32_t *grid, int64_t n,
                                                 const float *table, const unisim_mlp *net, float *out, int threads) {
    constexpr int64_t TILE = 512;
    const int64_t width = static_cast<int64_t>(g->levels) * g->features;
    std::atomic<int> status{0};
    parallel_blocks(n, 4 * TILE, threads, [&](int64_t begin, int64_t end) {
        std::vector<float> code(static_cast<size_t>(TILE * width));
        for (int64_t first = begin; first < end; first += TILE) {
            const int64_t count = std::min(TILE, end - first);
            if (UNISIM_NAME(unisim_encode_forward)(g, x + 3 * first, grid ? grid + first : nullptr, count, table,
                                                   code.data(), 1))
                status = 1;
            UNISIM_NAME(unisim_mlp_forward)(net, code.data(), count, out + first * net->outputs, 1);
        }
    });
    return status;
}
