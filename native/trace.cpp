// Traces rays through a scene, a tile at a time: builds ray segments, places and evaluates samples, composites in
// depth order.
//
// `core/render/tracers/torch/trace.py` is the specification, in plain torch. What is skipped here is not visible:
// samples behind a transmittance below `opaque`, and segments that lie wholly behind it. A ray's results do not
// depend on the others of its tile.
#include "trace/passes.h"
#include "trace/ray_marcher.h"

#include <memory>

namespace {

struct Tracer {
    Tile tile;
    StaticMask mask{tile};
    SegmentBuilder builder{tile, mask};
    FieldEvaluator evaluator{tile, mask};
    RayMarcher marcher{tile, evaluator, builder};
    Compositor compositor{tile};
    Background background{tile, compositor.sums};
    Passes passes{tile, compositor.sums, background};

    explicit Tracer(const Task &task) : tile(task) {}

    void trace(int64_t begin, int64_t end) {
        tile.start(begin, end);
        builder.build();
        tile.each_field([&](auto &segments) { marcher.sample(segments); });
        compositor.composite();
        background.composite();
        passes.write();
    }
};

} // namespace

extern "C" int UNISIM_NAME(unisim_trace)(const unisim_scene *scene, const unisim_active_actors *active,
                                         const unisim_rays *rays, const unisim_mesh_hits *meshes,
                                         const unisim_sampling *sampling, const unisim_trace_result *result,
                                         int threads) {
    Task task{*scene, *active, *rays, meshes, *sampling, *result, {}, {}};
    int first = 0;
    for (int i = 0; i < active->actor_set_count; ++i) {
        task.fields.emplace_back(active->actor_sets[i].scene);
        task.first_instance.push_back(first);
        first += active->actor_sets[i].count;
    }
    task.first_instance.push_back(first);
    std::atomic<int64_t> samples{0};
    parallel_bodies(rays->n, 4 * TILE, threads, [&] {
        return [&, tracer = std::make_unique<Tracer>(task)](int64_t begin, int64_t end) {
            tracer->tile.samples = 0;
            for (int64_t at = begin; at < end; at += TILE) tracer->trace(at, std::min(at + TILE, end));
            samples += tracer->tile.samples;
        };
    });
    *result->samples = samples;
    return 0;
}
