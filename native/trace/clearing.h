// Boxes that push the static scene aside: a present actor's, where it stands, and those that an edit removes something from.
#pragma once
#include "../marching.h"
#include "tile.h"

namespace {

class Clearing {
  public:
    explicit Clearing(const Tile &tile) : tile_(tile) {}

    // Where rays are in a present actor's box, or in a removed one.
    void find() {
        for (int r = 0; r < tile_.rays.count; ++r) span_[r].clear();
        for (const Batch &boxes : tile_.batches)
            if (boxes.medium == Medium::actor)
                for (int p = 0; p < boxes.count; ++p) span_[boxes.ray[p]].push_back({boxes.t_near[p], boxes.t_far[p]});
        for (int k = 0; k < tile_.task.cast.removals; ++k) {
            const double *m = tile_.task.cast.removal_from_world + 12 * k;
            const float *size = tile_.task.cast.removal_sizes + 3 * k;
            const float half[3] = {size[0] / 2, size[1] / 2, size[2] / 2}, minus[3] = {-half[0], -half[1], -half[2]};
            for (int r = 0; r < tile_.rays.count; ++r) {
                float o[3], d[3], near, far;
                transform(m, tile_.rays.origin[r], o);
                turn(m, tile_.rays.direction[r], d);
                if (span_of_box(o, d, minus, half, 0.0f, near, far)) span_[r].push_back({near, far});
            }
        }
    }

    bool holds(int r, float t, float margin) const {
        for (const Run &span : span_[r])
            if (t >= span.begin - margin && t <= span.end + margin) return true;
        return false;
    }

    // In such a box nothing stands above the ground: the ground is then all that is near.
    void empty(const Batch &b, int p, float t, float &s) const {
        if (!holds(b.ray[p], t, 0.0f)) return;
        const float x = b.o[3 * p] + t * b.d[3 * p], y = b.o[3 * p + 1] + t * b.d[3 * p + 1], z = b.o[3 * p + 2] + t * b.d[3 * p + 2];
        const float height = z - ground_at(tile_.scene, x, y);
        if (height > tile_.scene.ground_clearance_m) s = std::max(s, height);
    }

  private:
    const Tile &tile_;
    std::vector<Run> span_[TILE];
};

} // namespace
