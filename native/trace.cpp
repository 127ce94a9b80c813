// Rays through a scene, a tile at a time: samples placed, fields asked, everything on a ray put in depth order, features summed.
//
// `core/render/tracers/torch/trace.py` is the same in plain torch, and the specification. What is left out here cannot be seen: samples behind what
// lets less than `opaque` through, strands that lie wholly behind it. A ray's results do not depend on the others of its tile.
#include "trace/following.h"
#include "trace/passes.h"

#include <memory>

namespace {

struct Tracer {
    Tile tile;
    Clearing clearing{tile};
    Gathering gathering{tile, clearing};
    Asking asking{tile, clearing};
    Following following{tile, asking, gathering};
    Summing summing{tile};
    Beyond beyond{tile, summing.sums};
    Passes passes{tile, summing.sums, beyond};

    explicit Tracer(const Task &task) : tile(task) {}

    void trace(int64_t begin, int64_t end) {
        tile.start(begin, end);
        gathering.gather();
        for (Batch &b : tile.batches)
            if (b.count && b.medium != Medium::mesh) following.follow(b);
        summing.composite();
        beyond.add();
        passes.write();
    }
};

} // namespace

extern "C" int UNISIM_NAME(unisim_trace)(const unisim_scene *scene, const unisim_cast *cast, const unisim_rays *rays,
                                         const unisim_mesh_hits *meshes, const unisim_sampling *sampling,
                                         const unisim_found *found, int threads) {
    Task task{*scene, *cast, *rays, meshes, *sampling, *found, {}, {}};
    int first = 0;
    for (int i = 0; i < cast->troupe_count; ++i) {
        task.fields.emplace_back(cast->troupes[i].scene);
        task.first.push_back(first);
        first += cast->troupes[i].count;
    }
    task.first.push_back(first);
    std::atomic<int64_t> samples{0};
    parallel_bodies(rays->n, 4 * TILE, threads, [&] {
        return [&, tracer = std::make_unique<Tracer>(task)](int64_t begin, int64_t end) {
            tracer->tile.samples = 0;
            for (int64_t at = begin; at < end; at += TILE) tracer->trace(at, std::min(at + TILE, end));
            samples += tracer->tile.samples;
        };
    });
    *found->samples = samples;
    return 0;
}
