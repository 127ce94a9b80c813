// Which media each ray of a tile runs through: its strands, and of what stands still where it is worth asking.
#pragma once
#include "../placing.h"
#include "clearing.h"

namespace {

class Gathering {
  public:
    std::vector<Occupied> occupied;     // of the strands of what stands still, where quantiles are placed
    std::vector<std::vector<Run>> runs; // of the same, where they are marched: the first ones

    Gathering(Tile &tile, Clearing &clearing) : occupied(TILE), runs(TILE), tile_(tile), clearing_(clearing) {}

    void gather() {
        gather_actors();
        clearing_.find();
        gather_still();
        gather_copies();
        gather_meshes();
    }

    // The next runs of strand p of what stands still.
    void continue_runs(const Batch &b, size_t p, std::vector<Run> &out) {
        const int r = b.ray[p];
        const auto opened = [&](float t) { return clearing_.holds(r, t, tile_.scene.voxel_m); };
        find_runs(tile_.scene, tile_.o[r], tile_.d[r], b.t_near[p], b.t_far[p], opened, steps_[p], out);
    }

  private:
    void gather_actors() {
        for (int i = 0; i < tile_.task.cast.troupe_count; ++i) {
            const unisim_troupe &troupe = tile_.task.cast.troupes[i];
            Batch &b = tile_.batches[static_cast<size_t>(1 + i)];
            b.begin(Medium::actor, i);
            hits_.clear();
            meet_boxes(troupe, tile_.rays, tile_.task.sampling.near_m, hits_);
            for (const Hit &hit : hits_) b.add(hit.ray, hit.box, hit.o, hit.d, hit.t_near, hit.t_far, troupe.sizes + 3 * hit.box, hit.rotation, hit.stretch);
        }
    }

    void gather_still() {
        const unisim_scene &scene = tile_.scene;
        const float zero[3] = {}, none[9] = {};
        Batch &still = tile_.fixed();
        still.begin(Medium::fixed, 0);
        for (int r = 0; r < tile_.rays.count; ++r) {
            const float *o = tile_.o[r], *d = tile_.d[r];
            float near = 0, far = 0;
            if (!span_of_box(o, d, zero, scene.size, tile_.task.sampling.near_m, near, far)) far = near;
            tile_.far[r] = far;
            near = std::min(std::max(near, tile_.near[r]), far);
            const size_t p = static_cast<size_t>(still.count);
            if (tile_.marches(scene)) {
                // added first, to be looked for like what follows
                steps_[p] = 0;
                still.add(r, 0, o, d, near, far, scene.size, none);
                continue_runs(still, p, runs[p]);
                if (runs[p].empty()) still.drop();
                continue;
            }
            find_occupied(scene, o, d, near, far, occupied[p]);
            // free space: a ray that meets nothing that could stop it takes no sample
            if (occupied[p].total() > 0) still.add(r, 0, o, d, near, far, scene.size, none);
        }
    }

    void gather_copies() {
        Batch &copies = tile_.batches[tile_.batches.size() - 2];
        copies.begin(Medium::copy, 0);
        if (!tile_.task.cast.copies) return;
        hits_.clear();
        meet_boxes(*tile_.task.cast.copies, tile_.rays, tile_.task.sampling.near_m, hits_);
        for (const Hit &hit : hits_) add_copy(copies, hit);
    }

    // A copied box is the place it was copied from, seen where the copy stands.
    void add_copy(Batch &b, const Hit &hit) {
        const double *source = tile_.task.cast.world_from_source + 12 * hit.box;
        double world[3], along[3];
        for (int a = 0; a < 3; ++a) {
            world[a] = source[4 * a + 3];
            along[a] = 0;
            for (int c = 0; c < 3; ++c) {
                world[a] += source[4 * a + c] * hit.o[c];
                along[a] += source[4 * a + c] * hit.d[c];
            }
        }
        float o[3], d[3], rotation[9] = {};
        transform(tile_.scene.volume_from_world, world, o);
        turn(tile_.scene.volume_from_world, along, d);
        // the world's axes at the source, to the copy's box, to the world's there
        for (int a = 0; a < 3; ++a)
            for (int c = 0; c < 3; ++c)
                for (int e = 0; e < 3; ++e) rotation[3 * a + c] += hit.rotation[3 * a + e] * static_cast<float>(source[4 * c + e]);
        b.add(hit.ray, hit.box, o, d, hit.t_near, hit.t_far, tile_.scene.size, rotation);
    }

    void gather_meshes() {
        Batch &b = tile_.batches.back();
        b.begin(Medium::mesh, tile_.task.cast.troupe_count);
        const unisim_mesh_hits *met = tile_.task.meshes;
        if (!met) return;
        const float none[9] = {};
        std::vector<int64_t> at;
        for (int r = 0; r < tile_.rays.count; ++r)
            for (int64_t i = std::lower_bound(met->ray, met->ray + met->count, tile_.number[r]) - met->ray;
                 i < met->count && met->ray[i] == tile_.number[r]; ++i) {
                b.add(r, met->number[i], tile_.o[r], tile_.d[r], met->t[i], met->t[i], met->normals + 3 * i, none);
                at.push_back(i);
            }
        b.sample(1);
        for (int p = 0; p < b.count; ++p) {
            b.t[p] = met->t[at[static_cast<size_t>(p)]];
            b.tau[p] = met->tau[at[static_cast<size_t>(p)]];
        }
    }

    Tile &tile_;
    Clearing &clearing_;
    std::vector<Hit> hits_;
    int32_t steps_[TILE]; // through the cells, of the strands of what stands still
};

} // namespace
