// Boxes in which the static scene is masked out: those of active actors, where they are at a ray's time, and removed
// boxes.
#pragma once
#include "../surface_march.h"
#include "tile.h"

namespace {

class StaticMask {
  public:
    explicit StaticMask(const Tile &tile) : tile_(tile) {}

    // Finds the intervals of the tile's rays in masked boxes; the tile has its actor segments already.
    void find() {
        for (int r = 0; r < tile_.rays.count; ++r) intervals_[r].clear();
        for (const ActorSegments &b : tile_.actor_segments)
            for (int p = 0; p < b.count; ++p) intervals_[b.ray[p]].push_back({b.t_near[p], b.t_far[p]});
        const unisim_active_actors &active = tile_.task.active;
        for (int k = 0; k < active.removed_boxes; ++k) {
            const double *m = active.removed_box_from_world + 12 * k;
            const float *size = active.removed_box_sizes + 3 * k;
            const float half[3] = {size[0] / 2, size[1] / 2, size[2] / 2}, minus[3] = {-half[0], -half[1], -half[2]};
            for (int r = 0; r < tile_.rays.count; ++r) {
                float o[3], d[3], near, far;
                transform(m, tile_.rays.origin[r], o);
                turn(m, tile_.rays.direction[r], d);
                if (intersect_box(o, d, minus, half, 0.0f, near, far)) intervals_[r].push_back({near, far});
            }
        }
    }

    // Whether ray r at t is in a masked box or at most `margin` from one.
    bool contains(int r, float t, float margin) const {
        for (const Run &interval : intervals_[r])
            if (t >= interval.begin - margin && t <= interval.end + margin) return true;
        return false;
    }

    // Masks the distance s at t on segment p: inside a box nothing is left but the ground, so its height bounds the
    // distance.
    void apply(const StaticSegments &b, int p, float t, float &s) const {
        if (!contains(b.ray[p], t, 0.0f)) return;
        const float x = b.o[3 * p] + t * b.d[3 * p], y = b.o[3 * p + 1] + t * b.d[3 * p + 1],
                    z = b.o[3 * p + 2] + t * b.d[3 * p + 2];
        const float height = z - ground_at(tile_.scene, x, y);
        if (height > tile_.scene.ground_clearance_m) s = std::max(s, height);
    }

  private:
    const Tile &tile_;
    std::vector<Run> intervals_[TILE];
};

} // namespace
