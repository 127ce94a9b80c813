// Computes the cells of `cells.h` for a scene's volume and for its actors' boxes.
#include "cells.h"

namespace {

// Evaluates the distance at `count` points, BLOCK at a time. place(i, x) fills point i's coordinates in the unit
// cube, take(i, s) receives its distance.
template <class Place, class Take> void evaluate(const Field &field, const int32_t *rows, int count, const Place &place,
                                                 const Take &take) {
    std::vector<float> code(static_cast<size_t>(BLOCK) * field.inputs), h(static_cast<size_t>(BLOCK) * field.wide);
    float x[3][BLOCK];
    for (int first = 0; first < count; first += BLOCK) {
        const int n = std::min(BLOCK, count - first);
        for (int i = 0; i < BLOCK; ++i) {
            float at[3];
            place(first + std::min(i, n - 1), at);
            for (int a = 0; a < 3; ++a) x[a][i] = at[a];
        }
        field.units(x, rows, n, code.data(), h.data());
        for (int i = 0; i < n; ++i) take(first + i, field.first_output(&h[static_cast<size_t>(i) * field.wide]));
    }
}

} // namespace

// Writes kinds (X, Y, Z), two bits for each of a voxel's cells with the lowest bits for the first, of the `n` voxels
// with these numbers. Other voxels stay 0, which is open.
extern "C" int UNISIM_NAME(unisim_cells)(const unisim_scene *scene, const int64_t *voxels, int64_t n, uint16_t *kinds,
                                         int threads) {
    static_assert(CELLS == 2, "two bits each fill sixteen");
    const Field field(scene->static_field);
    const int32_t *shape = scene->voxel_shape;
    const float gap = scene->voxel_m / (CELLS * POINTS);
    parallel_blocks(n, 256, threads, [&](int64_t begin, int64_t end) {
        constexpr int SIDE = CELLS * POINTS, COUNT = SIDE * SIDE * SIDE;
        for (int64_t v = begin; v < end; ++v) {
            const int64_t number = voxels[v];
            const int64_t corner[3] = {number / shape[2] / shape[1], number / shape[2] % shape[1], number % shape[2]};
            float minima[8], maxima[8];
            std::fill_n(minima, 8, 3e38f);
            std::fill_n(maxima, 8, -3e38f);
            evaluate(
                field, nullptr, COUNT,
                [&](int i, float *at) {
                    const int step[3] = {i / SIDE / SIDE, i / SIDE % SIDE, i % SIDE};
                    for (int a = 0; a < 3; ++a)
                        at[a] = (static_cast<float>(corner[a]) * scene->voxel_m +
                                 (static_cast<float>(step[a]) + 0.5f) * gap) /
                                scene->size[a];
                },
                [&](int i, float s) {
                    const int cell =
                        (i / SIDE / SIDE / POINTS * CELLS + i / SIDE % SIDE / POINTS) * CELLS + i % SIDE / POINTS;
                    minima[cell] = std::min(minima[cell], s);
                    maxima[cell] = std::max(maxima[cell], s);
                });
            uint32_t word = 0;
            for (int c = 0; c < 8; ++c) word |= static_cast<uint32_t>(kind_of(minima[c], maxima[c], gap)) << 2 * c;
            kinds[number] = static_cast<uint16_t>(word);
        }
    });
    const auto at = [&](int i, int j, int k) -> uint8_t {
        if (i < 0 || j < 0 || k < 0 || i >= CELLS * shape[0] || j >= CELLS * shape[1] || k >= CELLS * shape[2])
            return OPEN;
        const int64_t number = (static_cast<int64_t>(i / CELLS) * shape[1] + j / CELLS) * shape[2] + k / CELLS;
        return kinds[number] >> 2 * ((i % CELLS * CELLS + j % CELLS) * CELLS + k % CELLS) & 3;
    };
    // open cells never change, so one pass is enough
    std::vector<uint16_t> after(static_cast<size_t>(n));
    parallel_blocks(n, 4096, threads, [&](int64_t begin, int64_t end) {
        for (int64_t v = begin; v < end; ++v) {
            const int64_t number = voxels[v];
            const int i = static_cast<int>(number / shape[2] / shape[1]),
                      j = static_cast<int>(number / shape[2] % shape[1]);
            const int k = static_cast<int>(number % shape[2]);
            uint32_t word = 0;
            for (int c = 0; c < 8; ++c)
                word |=
                    static_cast<uint32_t>(kind_in_grid(at, CELLS * i + c / 4, CELLS * j + c / 2 % 2, CELLS * k + c % 2))
                    << 2 * c;
            after[static_cast<size_t>(v)] = static_cast<uint16_t>(word);
        }
    });
    for (int64_t v = 0; v < n; ++v) kinds[voxels[v]] = after[static_cast<size_t>(v)];
    return 0;
}

// Writes kinds (actors, BOX_CELLS, BOX_CELLS, BOX_CELLS) of the scene's actors, whose boxes have sizes (actors, 3).
extern "C" int UNISIM_NAME(unisim_box_cells)(const unisim_scene *scene, const float *sizes, int32_t actors,
                                             uint8_t *kinds, int threads) {
    const Field field(scene->actor_fields);
    constexpr int SIDE = BOX_CELLS * POINTS, COUNT = SIDE * SIDE * SIDE;
    parallel_blocks(actors, 1, threads, [&](int64_t begin, int64_t end) {
        std::vector<float> minima(BOX_CELLS * BOX_CELLS * BOX_CELLS), maxima(minima.size());
        std::vector<uint8_t> before(minima.size());
        for (int64_t actor = begin; actor < end; ++actor) {
            std::fill(minima.begin(), minima.end(), 3e38f);
            std::fill(maxima.begin(), maxima.end(), -3e38f);
            int32_t rows[BLOCK];
            std::fill_n(rows, BLOCK, static_cast<int32_t>(actor));
            evaluate(
                field, rows, COUNT,
                [&](int i, float *x) {
                    const int step[3] = {i / SIDE / SIDE, i / SIDE % SIDE, i % SIDE};
                    for (int a = 0; a < 3; ++a) x[a] = (static_cast<float>(step[a]) + 0.5f) / SIDE;
                },
                [&](int i, float s) {
                    const size_t cell = static_cast<size_t>(
                        (i / SIDE / SIDE / POINTS * BOX_CELLS + i / SIDE % SIDE / POINTS) * BOX_CELLS +
                        i % SIDE / POINTS);
                    minima[cell] = std::min(minima[cell], s);
                    maxima[cell] = std::max(maxima[cell], s);
                });
            const float *size = sizes + 3 * actor;
            const float gap = std::max(size[0], std::max(size[1], size[2])) / SIDE;
            for (size_t c = 0; c < before.size(); ++c) before[c] = kind_of(minima[c], maxima[c], gap);
            const auto at = [&](int i, int j, int k) -> uint8_t {
                if (i < 0 || j < 0 || k < 0 || i >= BOX_CELLS || j >= BOX_CELLS || k >= BOX_CELLS) return OPEN;
                return before[static_cast<size_t>((i * BOX_CELLS + j) * BOX_CELLS + k)];
            };
            uint8_t *out = kinds + actor * BOX_CELLS * BOX_CELLS * BOX_CELLS;
            for (int i = 0; i < BOX_CELLS; ++i)
                for (int j = 0; j < BOX_CELLS; ++j)
                    for (int k = 0; k < BOX_CELLS; ++k) *out++ = kind_in_grid(at, i, j, k);
        }
    });
    return 0;
}
