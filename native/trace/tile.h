// A tile of neighbouring rays: the rays, their segments by kind, and scratch memory that the stages share.
#pragma once
#include "../ray_segments.h"
#include "task.h"

namespace {

constexpr int TILE = 64;

// How many points of a block are filled in for `count` points: whole vectors.
constexpr int filled(int count) { return (count + LANES - 1) / LANES * LANES; }

struct Tile {
    const Task &task;
    const unisim_scene &scene;
    TileRays rays;
    int64_t number[TILE];         // of a ray, among all rays of the call
    float o[TILE][3], d[TILE][3]; // in the volume's coordinates, metres
    float near[TILE];             // from where on a ray can hit the static field
    float far[TILE];              // where a ray leaves the volume
    // segments, in the order of `each`
    StaticSegments static_segments;
    std::vector<ActorSegments> actor_segments; // one per actor set
    CopySegments copy_segments;
    MeshSegments mesh_segments;
    std::vector<SegmentRef> segments[TILE]; // of all kinds, by ray
    int64_t samples = 0;                    // points at which a field was evaluated
    // a block of points in a field's unit cube: the numbers of their actors' grids, their encodings and hidden units
    float x[3][BLOCK];
    int32_t row[BLOCK];
    std::vector<float> code, block;

    explicit Tile(const Task &of)
        : task(of), scene(of.scene), actor_segments(static_cast<size_t>(of.active.actor_set_count)) {
        int inputs = 0, wide = 0;
        for (const SceneFields &fields : task.fields)
            for (const Field *field : {&fields.static_field, &fields.background, &fields.actors}) {
                inputs = std::max(inputs, field->inputs);
                wide = std::max(wide, field->wide);
            }
        code.resize(static_cast<size_t>(BLOCK) * inputs);
        block.resize(static_cast<size_t>(BLOCK) * wide);
    }

    // Calls visit(segments) for every kind that has any, in a fixed order: sums have one order.
    template <class Visit> void each(const Visit &visit) {
        each_field(visit);
        if (mesh_segments.count) visit(mesh_segments);
    }

    // The same for segments inside a field.
    template <class Visit> void each_field(const Visit &visit) {
        if (static_segments.count) visit(static_segments);
        for (ActorSegments &b : actor_segments)
            if (b.count) visit(b);
        if (copy_segments.count) visit(copy_segments);
    }

    const SceneFields &scene_fields_of(const FieldSegments &) const { return task.fields[0]; }
    const SceneFields &scene_fields_of(const ActorSegments &b) const { return task.fields[static_cast<size_t>(b.set)]; }
    const Field &field_of(const FieldSegments &b) const { return scene_fields_of(b).static_field; }
    const Field &field_of(const ActorSegments &b) const { return scene_fields_of(b).actors; }

    // The place of a segment's point in its field's unit cube is point / size + offset.
    const float *size_of(const FieldSegments &, size_t) const { return scene.size; }
    const float *size_of(const ActorSegments &b, size_t p) const { return &b.size[3 * p]; }
    static float offset_of(const FieldSegments &) { return 0.0f; }
    static float offset_of(const ActorSegments &) { return 0.5f; }
    // The number of a segment's grid in its field's table.
    static int32_t row_of(const FieldSegments &, size_t) { return 0; }
    static int32_t row_of(const ActorSegments &b, size_t p) { return b.row[p]; }
    // The numbers of the grids of the points in `x`; null where the field has one grid.
    const int32_t *rows_of(const FieldSegments &) const { return nullptr; }
    const int32_t *rows_of(const ActorSegments &) const { return row; }

    // Whether a scene's segments are marched. The paper's density depends on the steps and needs even ones.
    bool marches(const unisim_scene &of) const { return task.sampling.stride_m > 0 && of.cells && !of.unisim_density; }

    // Starts with rays `begin` to before `end`, in the order in which they are traced.
    void start(int64_t begin, int64_t end) {
        const unisim_rays &all = task.rays;
        rays.count = static_cast<int>(end - begin);
        for (int r = 0; r < rays.count; ++r) {
            const int64_t i = number[r] = all.order ? all.order[begin + r] : begin + r;
            rays.origin[r] = all.origins + 3 * i;
            rays.direction[r] = all.directions + 3 * i;
            rays.time[r] = all.times[i];
            near[r] = all.starts ? std::max(task.sampling.near_m, all.starts[i]) : task.sampling.near_m;
            transform(scene.volume_from_world, rays.origin[r], o[r]);
            turn(scene.volume_from_world, rays.direction[r], d[r]);
        }
    }
};

} // namespace
