// The march alone, along rays whose distances a callback returns: compared with `tests/reference/surface_march.py` by
// tests.
#include "surface_march.h"

// Samples t, s (n, capacity) and their counts (n), of rays in the volume's coordinates or, where `in_box` is set,
// through the first of the scene's box cells, in a box of the scene's size. spans, cleared (n, 2): intervals of the
// rays, and intervals on them in which solid cells count; depth_before (n): the optical depths before the rays.
extern "C" int UNISIM_NAME(unisim_march)(const unisim_scene *scene, int32_t in_box, const float *origins,
                                         const float *directions, const float *spans, const float *cleared,
                                         const float *depth_before, int64_t n, const unisim_sampling *sampling,
                                         unisim_distance distance, int32_t capacity, float *t, float *s,
                                         int32_t *counts) {
    SurfaceMarch march;
    std::vector<int32_t> steps(static_cast<size_t>(n), 0);
    const auto continue_runs = [&](size_t p, std::vector<Run> &runs) {
        const float *interval = cleared + 2 * p;
        const auto is_cleared = [&](float at) {
            return at >= interval[0] - scene->voxel_m && at <= interval[1] + scene->voxel_m;
        };
        find_runs(*scene, origins + 3 * p, directions + 3 * p, spans[2 * p], spans[2 * p + 1], is_cleared, steps[p],
                  runs);
    };
    march.runs.resize(static_cast<size_t>(n));
    for (size_t p = 0; p < march.runs.size(); ++p) {
        if (in_box)
            find_box_runs(scene->box_cells, origins + 3 * p, directions + 3 * p, scene->size, spans[2 * p],
                          spans[2 * p + 1], march.runs[p]);
        else
            continue_runs(p, march.runs[p]);
    }
    const auto evaluate = [&] {
        for (const int p : march.queries) march.query_s[p] = distance(p, march.query_t[p]);
    };
    const auto more = [&](size_t p, std::vector<Run> &runs) {
        if (!in_box) return continue_runs(p, runs);
        runs.clear();
    };
    const auto face = [&](int p, int &before, float &at) {
        return !in_box && find_face(*scene, origins + 3 * p, directions + 3 * p, spans[2 * p], &march.t[p],
                                    &march.depth[p], march.counts[p], march.stride, before, at);
    };
    march.march(static_cast<int>(n), depth_before, scene->beta, *sampling, evaluate, more, face, scene->voxel_m);
    for (int64_t p = 0; p < n; ++p) {
        counts[p] = march.counts[p];
        for (int64_t k = 0; k < std::min(counts[p], capacity); ++k) {
            t[p * capacity + k] = march.t[k * march.stride + p];
            s[p * capacity + k] = march.s[k * march.stride + p];
        }
    }
    return 0;
}
