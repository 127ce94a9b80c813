// Evaluates a field in one pass: the grid's encoding and the network, over tiles of points, so that no encoding is
// written to memory.
#include "field_tile.h"

// out (n, outputs) at points x (n, 3) in the unit cube; grid (n) is the number of each point's grid, null where there
// is one grid.
extern "C" int UNISIM_NAME(unisim_field_forward)(const unisim_grid *g, const float *x, const int32_t *grid, int64_t n,
                                                 const float *table, const unisim_mlp *net, float *out, int threads) {
    if (net->outputs == 1) { // the proposals of samples, most of a training step's points: as in rendering
        if (g->features != 1 && g->features != 2 && g->features != 4 && g->features != 8) return 1;
        const Field field(unisim_field{*g, table, 0, *net});
        parallel_blocks(n, 32 * BLOCK, threads, [&](int64_t begin, int64_t end) {
            std::vector<float> code(static_cast<size_t>(BLOCK) * field.inputs);
            std::vector<float> h(static_cast<size_t>(BLOCK) * field.wide);
            float at[3][BLOCK];
            for (int64_t first = begin; first < end; first += BLOCK) {
                const int count = static_cast<int>(std::min<int64_t>(BLOCK, end - first));
                for (int s = 0; s < BLOCK; ++s)
                    for (int a = 0; a < 3; ++a) at[a][s] = x[3 * (first + std::min(s, count - 1)) + a];
                field.units(at, grid ? grid + first : nullptr, count, code.data(), h.data());
                for (int s = 0; s < count; ++s)
                    out[first + s] = field.first_output(&h[static_cast<size_t>(s) * field.wide]);
            }
        });
        return 0;
    }
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
