// The march alone, of rays whose distances the caller tells: what `tests/reference/surface_march.py` is held against.
#include "marching.h"

// Answers t, s (n, most) and how many there are, counts (n), of rays in the volume's coordinates, or, `in_box`, through the first
// of the scene's box cells in a box of the scene's size. spans, opened (n, 2): from where to where each ray goes, and where solid
// cells count on it; passed (n): the optical depth before it.
extern "C" int UNISIM_NAME(unisim_march)(const unisim_scene *scene, int32_t in_box, const float *origins, const float *directions,
                                         const float *spans, const float *opened, const float *passed, int64_t n,
                                         const unisim_sampling *sampling, unisim_distance distance, int32_t most, float *t,
                                         float *s, int32_t *counts) {
    March march;
    std::vector<int32_t> steps(static_cast<size_t>(n), 0);
    const auto continue_runs = [&](size_t p, std::vector<Run> &runs) {
        const float *open = opened + 2 * p;
        const auto behind = [&](float at) { return at >= open[0] - scene->voxel_m && at <= open[1] + scene->voxel_m; };
        find_runs(*scene, origins + 3 * p, directions + 3 * p, spans[2 * p], spans[2 * p + 1], behind, steps[p], runs);
    };
    march.runs.resize(static_cast<size_t>(n));
    for (size_t p = 0; p < march.runs.size(); ++p) {
        if (in_box)
            find_box_runs(scene->box_cells, origins + 3 * p, directions + 3 * p, scene->size, spans[2 * p], spans[2 * p + 1], march.runs[p]);
        else
            continue_runs(p, march.runs[p]);
    }
    const auto ask = [&] {
        for (const int p : march.asked) march.told[p] = distance(p, march.next[p]);
    };
    const auto more = [&](size_t p, std::vector<Run> &runs) {
        if (!in_box) return continue_runs(p, runs);
        runs.clear();
    };
    const auto face = [&](int p, int &at, float &t) {
        return !in_box && find_face(*scene, origins + 3 * p, directions + 3 * p, spans[2 * p], &march.t[p], &march.stopped[p], march.counts[p],
                                    march.stride, at, t);
    };
    march.follow(static_cast<int>(n), passed, scene->beta, *sampling, ask, more, face, scene->voxel_m);
    for (int64_t p = 0; p < n; ++p) {
        counts[p] = march.counts[p];
        for (int64_t k = 0; k < std::min(counts[p], most); ++k) {
            t[p * most + k] = march.t[k * march.stride + p];
            s[p * most + k] = march.s[k * march.stride + p];
        }
    }
    return 0;
}
