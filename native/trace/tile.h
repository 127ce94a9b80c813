// A tile of neighbouring rays: where they begin and go, the strands they have, and memory that its stages lend each other.
#pragma once
#include "../strands.h"
#include "task.h"

namespace {

constexpr int TILE = 64;

// Points of a block that are filled: those that are asked for, up to the end of a vector.
constexpr int filled(int count) { return (count + LANES - 1) / LANES * LANES; }

struct Tile {
    const Task &task;
    const unisim_scene &scene;
    TileRays rays;
    int64_t number[TILE];              // of a ray, among all that are traced
    float o[TILE][3], d[TILE][3];      // in the volume's coordinates, metres
    float near[TILE];                  // from where on a ray meets the static field
    float far[TILE];                   // where a ray leaves the volume
    std::vector<Batch> batches;        // what stands still, the troupes, copies, meshes
    std::vector<Strand> strands[TILE]; // of all batches, by ray
    int64_t samples = 0;               // points at which a field was asked
    // a block of points in a field's unit cube, their actors' grids, what the grid says there, hidden units
    float x[3][BLOCK];
    int32_t row[BLOCK];
    std::vector<float> code, block;

    explicit Tile(const Task &of) : task(of), scene(of.scene), batches(of.cast.troupe_count + 3) {
        int inputs = 0, wide = 0;
        for (const Fields &fields : task.fields)
            for (const Field *field : {&fields.fixed, &fields.far, &fields.actors}) {
                inputs = std::max(inputs, field->inputs);
                wide = std::max(wide, field->wide);
            }
        code.resize(static_cast<size_t>(BLOCK) * inputs);
        block.resize(static_cast<size_t>(BLOCK) * wide);
    }

    const Fields &fields_of(const Batch &b) const { return task.fields[b.medium == Medium::actor ? b.troupe : 0]; }
    const Field &field_of(const Batch &b) const { return b.medium == Medium::actor ? fields_of(b).actors : fields_of(b).fixed; }
    Batch &fixed() { return batches[0]; }
    bool guest(const Batch &b) const { return b.medium == Medium::mesh || (b.medium == Medium::actor && b.troupe > 0); }

    // Whether a scene's strands are followed from cell to cell; the paper's density depends on the steps, and takes even ones.
    bool marches(const unisim_scene &of) const { return task.sampling.stride_m > 0 && of.cells && !of.paper_density; }

    // Rays `begin` to before `end`, in the order in which they are traced.
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
