// Builds the ray segments of a tile: which fields and meshes each ray hits, and where the static field is worth
// evaluating.
#pragma once
#include "../sample_placement.h"
#include "static_mask.h"

namespace {

class SegmentBuilder {
  public:
    std::vector<OccupiedSteps> occupied; // by static segment, where samples are placed by quantiles
    std::vector<std::vector<Run>> runs;  // by static segment, where they are marched: the first runs

    SegmentBuilder(Tile &tile, StaticMask &mask) : occupied(TILE), runs(TILE), tile_(tile), mask_(mask) {}

    void build() {
        build_actors();
        mask_.find();
        build_static();
        build_copies();
        build_meshes();
    }

    // Replaces the runs of static segment p by the next ones.
    void continue_runs(const StaticSegments &b, size_t p, std::vector<Run> &out) {
        const int r = b.ray[p];
        const auto cleared = [&](float t) { return mask_.contains(r, t, tile_.scene.voxel_m); };
        find_runs(tile_.scene, tile_.o[r], tile_.d[r], b.t_near[p], b.t_far[p], cleared, steps_[p], out);
    }

  private:
    void build_actors() {
        for (int i = 0; i < tile_.task.active.actor_set_count; ++i) {
            const unisim_actor_set &set = tile_.task.active.actor_sets[i];
            ActorSegments &b = tile_.actor_segments[static_cast<size_t>(i)];
            b.begin(set, i);
            hits_.clear();
            intersect_boxes(set, tile_.rays, tile_.task.sampling.near_m, hits_);
            for (const BoxHit &hit : hits_) b.add(hit);
        }
    }

    void build_static() {
        const unisim_scene &scene = tile_.scene;
        const float zero[3] = {};
        StaticSegments &b = tile_.static_segments;
        b.begin();
        for (int r = 0; r < tile_.rays.count; ++r) {
            const float *o = tile_.o[r], *d = tile_.d[r];
            float near = 0, far = 0;
            if (!intersect_box(o, d, zero, scene.size, tile_.task.sampling.near_m, near, far)) far = near;
            tile_.far[r] = far;
            near = std::min(std::max(near, tile_.near[r]), far);
            const size_t p = static_cast<size_t>(b.count);
            if (tile_.marches(scene)) {
                // added first: `continue_runs` takes the segment's ray and interval from it
                steps_[p] = 0;
                b.add(r, o, d, near, far);
                continue_runs(b, p, runs[p]);
                if (runs[p].empty()) b.remove_last();
                continue;
            }
            find_occupied(scene, o, d, near, far, occupied[p]);
            // a ray through free space only gets no segment and no samples
            if (occupied[p].total() > 0) b.add(r, o, d, near, far);
        }
    }

    void build_copies() {
        CopySegments &b = tile_.copy_segments;
        b.begin();
        if (!tile_.task.active.copies) return;
        hits_.clear();
        intersect_boxes(*tile_.task.active.copies, tile_.rays, tile_.task.sampling.near_m, hits_);
        for (BoxHit &hit : hits_) { // a segment inside a copied box is evaluated at the source of the copy
            move_to_source(tile_.scene, tile_.task.active.world_from_source + 12 * hit.box, hit);
            b.add(hit.ray, hit.o, hit.d, hit.t_near, hit.t_far, hit.rotation);
        }
    }

    void build_meshes() {
        MeshSegments &b = tile_.mesh_segments;
        b.begin();
        const unisim_mesh_hits *hits = tile_.task.meshes;
        if (!hits) return;
        hit_numbers_.clear();
        for (int r = 0; r < tile_.rays.count; ++r)
            for (int64_t i = std::lower_bound(hits->ray, hits->ray + hits->count, tile_.number[r]) - hits->ray;
                 i < hits->count && hits->ray[i] == tile_.number[r]; ++i) {
                b.add(r, hits->actor[i], hits->normals + 3 * i);
                hit_numbers_.push_back(i);
            }
        b.allocate(1);
        for (int p = 0; p < b.count; ++p) {
            b.t[p] = hits->t[hit_numbers_[static_cast<size_t>(p)]];
            b.tau[p] = hits->tau[hit_numbers_[static_cast<size_t>(p)]];
        }
    }

    Tile &tile_;
    StaticMask &mask_;
    std::vector<BoxHit> hits_;
    std::vector<int64_t> hit_numbers_; // of the tile's mesh segments
    int32_t steps_[TILE];              // by static segment: the next step of `find_runs`
};

} // namespace
