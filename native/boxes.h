// Boxes on trajectories: the pose of each at a ray's time, and which rays intersect it. Positions are subtracted in
// float64 and then converted to float32, so that a drive may lie anywhere in the world.
#pragma once
#include "one_ray.h"
#include "variant.h"

#include <cstring>

namespace {

struct TileRays {
    int count;
    const double *origin[64], *direction[64];
    double time[64];
};

// A cone that contains the rays of a tile, and the interval of their times.
struct RayBundle {
    double origin[3] = {}, axis[3] = {}, radius = 0, half_angle = 3.2, first, last;

    explicit RayBundle(const TileRays &rays) : first(rays.time[0]), last(rays.time[0]) {
        double length = 0, min_dot = 1;
        for (int r = 0; r < rays.count; ++r)
            for (int a = 0; a < 3; ++a) {
                origin[a] += rays.origin[r][a] / rays.count;
                axis[a] += rays.direction[r][a];
            }
        for (const double x : axis) length += x * x;
        length = std::sqrt(length);
        for (int r = 0; r < rays.count; ++r) {
            double dot = 0, apart = 0, norm = 0;
            for (int a = 0; a < 3; ++a) {
                dot += rays.direction[r][a] * axis[a];
                norm += rays.direction[r][a] * rays.direction[r][a];
                apart += (rays.origin[r][a] - origin[a]) * (rays.origin[r][a] - origin[a]);
            }
            // a NaN becomes the minimum: half_angle then stays above pi, and no box is excluded
            dot /= length * std::sqrt(norm);
            min_dot = dot >= min_dot ? min_dot : dot;
            radius = std::max(radius, std::sqrt(apart));
            first = std::min(first, rays.time[r]);
            last = std::max(last, rays.time[r]);
        }
        for (double &x : axis) x /= length;
        if (min_dot > 0) half_angle = std::acos(std::min(min_dot, 1.0)) + 1e-4;
    }

    // Whether a ray may hit a box: tests the bounding sphere of the box over all positions from the first time to the
    // last.
    bool may_hit(const unisim_actor_set &set, int actor, double sphere_radius) const {
        if (last < set.start[actor] || first > set.end[actor]) return false;
        // over a longer interval the trajectory may bend
        if (half_angle > 1.5 || last - first > 0.04) return true;
        double from[3], to[3], moved = 0, distance = 0, along = 0;
        position_at(set, actor, first, from);
        position_at(set, actor, last, to);
        for (int a = 0; a < 3; ++a) {
            moved += (to[a] - from[a]) * (to[a] - from[a]);
            const double x = (from[a] + to[a]) / 2 - origin[a];
            distance += x * x;
            along += x * axis[a];
        }
        distance = std::sqrt(distance);
        const double reach = sphere_radius + std::sqrt(moved) / 2 + radius + 0.01;
        if (!(distance > reach)) return true;
        return std::acos(std::max(-1.0, std::min(1.0, along / distance))) <= half_angle + std::asin(reach / distance);
    }
};

// Appends the intersections of a tile's rays with the boxes of a set.
inline void intersect_boxes(const unisim_actor_set &set, const TileRays &rays, float near, std::vector<BoxHit> &hits) {
    if (!set.candidate_count) return;
    const RayBundle bundle(rays);
    for (int c = 0; c < set.candidate_count; ++c) {
        const int actor = set.candidates[c];
        const double radius = sphere_radius(set, actor);
        if (!bundle.may_hit(set, actor, radius)) continue;
        Pose pose{};
        double posed = NAN;
        for (int r = 0; r < rays.count; ++r) {
            const double time = rays.time[r], *o = rays.origin[r], *d = rays.direction[r];
            if (!(time >= set.start[actor] && time <= set.end[actor])) continue;
            // rays of one row or column have the same time
            if (time != posed) pose = pose_at(set, actor, posed = time);
            double to[3];
            if (!reaches_sphere(pose.position, o, d, radius, to)) continue;
            BoxHit hit{r, actor, 0, 0, {}, {}, {}, 1.0f, 0};
            if (!enter_box(set, actor, pose, to, d, near, hit)) continue;
            hits.push_back(hit);
        }
    }
}

} // namespace
