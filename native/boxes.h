// Boxes on trajectories: the pose of each at a ray's time, and which rays intersect it. Positions are subtracted in
// float64 and then converted to float32, so that a drive may lie anywhere in the world.
#pragma once
#include "variant.h"

#include <cmath>
#include <cstring>

namespace {

struct Pose {
    double position[3];
    float rotation[9]; // world from box
};

inline void slerp(const double *a, const double *b, double u, double *q) {
    // what stands has the same bits at all times
    if (a[0] == b[0] && a[1] == b[1] && a[2] == b[2] && a[3] == b[3]) {
        for (int i = 0; i < 4; ++i) q[i] = a[i];
        return;
    }
    double dot = 0, chord = 0, norm = 0;
    for (int i = 0; i < 4; ++i) dot += a[i] * b[i];
    const double sign = dot < 0 ? -1.0 : 1.0;
    for (int i = 0; i < 4; ++i) chord += (a[i] - sign * b[i]) * (a[i] - sign * b[i]);
    // the angle from the chord: acos loses half of its digits near 1
    const double angle = 2 * std::asin(std::fmin(std::sqrt(chord) / 2, 0.7071067811865476));
    // for small angles, linear interpolation followed by normalization is within a millionth of the angle
    const bool small = angle < 2e-3;
    const double sine = small ? 1.0 : std::sin(angle);
    const double wa = small ? 1 - u : std::sin((1 - u) * angle) / sine, wb = small ? u : std::sin(u * angle) / sine;
    for (int i = 0; i < 4; ++i) {
        q[i] = wa * a[i] + sign * wb * b[i];
        norm += q[i] * q[i];
    }
    norm = std::sqrt(norm);
    for (int i = 0; i < 4; ++i) q[i] /= norm;
}

// The two keys around a time, and the fraction of the interval before it.
struct KeyInterval {
    int lower, upper;
    double u;
};

inline KeyInterval key_interval(const unisim_actor_set &set, int actor, double time) {
    const double *times = set.times + static_cast<int64_t>(actor) * set.keys;
    const int length = set.lengths[actor];
    int upper = static_cast<int>(std::upper_bound(times, times + length, time) - times);
    upper = length == 1 ? 0 : std::max(1, std::min(upper, length - 1));
    const int lower = std::max(upper - 1, 0);
    return {lower, upper, length == 1 ? 0.0 : (time - times[lower]) / (times[upper] - times[lower])};
}

inline void position_at(const unisim_actor_set &set, int actor, const KeyInterval &at, double *position) {
    const double *positions = set.positions + static_cast<int64_t>(actor) * set.keys * 3;
    for (int i = 0; i < 3; ++i)
        position[i] = positions[3 * at.lower + i] + at.u * (positions[3 * at.upper + i] - positions[3 * at.lower + i]);
}

inline void position_at(const unisim_actor_set &set, int actor, double time, double *position) {
    position_at(set, actor, key_interval(set, actor, time), position);
}

inline Pose pose_at(const unisim_actor_set &set, int actor, double time) {
    const KeyInterval at = key_interval(set, actor, time);
    const double *quaternions = set.quaternions + static_cast<int64_t>(actor) * set.keys * 4;
    Pose pose;
    position_at(set, actor, at, pose.position);
    double q[4];
    slerp(quaternions + 4 * at.lower, quaternions + 4 * at.upper, at.u, q);
    const double w = q[0], x = q[1], y = q[2], z = q[3];
    const double r[9] = {1 - 2 * (y * y + z * z), 2 * (x * y - w * z),     2 * (x * z + w * y),
                         2 * (x * y + w * z),     1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
                         2 * (x * z - w * y),     2 * (y * z + w * x),     1 - 2 * (x * x + y * y)};
    for (int i = 0; i < 9; ++i) pose.rotation[i] = static_cast<float>(r[i]);
    return pose;
}

// Where a ray is inside an axis-aligned box; false where it misses the box.
inline bool intersect_box(const float *o, const float *d, const float *low, const float *high, float near,
                          float &t_near, float &t_far) {
    t_near = near;
    t_far = 3.4e38f;
    for (int a = 0; a < 3; ++a) {
        const float along = std::fabs(d[a]) < 1e-9f ? 1e-9f : d[a];
        const float first = (low[a] - o[a]) / along, second = (high[a] - o[a]) / along;
        t_near = std::fmax(t_near, std::fmin(first, second));
        t_far = std::fmin(t_far, std::fmax(first, second));
    }
    return t_far > t_near;
}

// A ray inside one box: the ray's number in the tile, the box's number in its set, the ray in the box's axes and the
// metres of the field, and the interval from t_near to t_far in metres along the ray. The scale of a box is removed
// here and nowhere else: in a scaled box `d` is not a unit vector, `stretch` is its length (field metres per metre
// along the ray), and `rotation`, which takes gradients to the world, is the box's rotation after the inverse of the
// scale.
struct BoxHit {
    int ray, box;
    float t_near, t_far, o[3], d[3];
    float rotation[9];
    float stretch;
};

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
        const float *size = set.sizes + 3 * actor, *scale = set.scales + 3 * actor;
        const float half[3] = {size[0] / 2, size[1] / 2, size[2] / 2}, minus[3] = {-half[0], -half[1], -half[2]};
        const float world[3] = {half[0] * scale[0], half[1] * scale[1], half[2] * scale[2]};
        const double radius =
            std::sqrt(static_cast<double>(world[0]) * world[0] + world[1] * world[1] + world[2] * world[2]) + 1e-3;
        const bool scaled = scale[0] != 1.0f || scale[1] != 1.0f || scale[2] != 1.0f;
        if (!bundle.may_hit(set, actor, radius)) continue;
        Pose pose{};
        double posed = NAN;
        for (int r = 0; r < rays.count; ++r) {
            const double time = rays.time[r], *o = rays.origin[r], *d = rays.direction[r];
            if (!(time >= set.start[actor] && time <= set.end[actor])) continue;
            // rays of one row or column have the same time
            if (time != posed) pose = pose_at(set, actor, posed = time);
            double to[3], along = 0, squared = 0;
            for (int a = 0; a < 3; ++a) {
                to[a] = pose.position[a] - o[a];
                along += to[a] * d[a];
                squared += to[a] * to[a];
            }
            along = std::max(along, 0.0);
            if (squared - along * along > radius * radius) continue;
            BoxHit hit{r, actor, 0, 0, {}, {}, {}, 1.0f};
            for (int a = 0; a < 3; ++a)
                for (int b = 0; b < 3; ++b) {
                    hit.o[a] -= pose.rotation[3 * b + a] * static_cast<float>(to[b]);
                    hit.d[a] += pose.rotation[3 * b + a] * static_cast<float>(d[b]);
                }
            std::memcpy(hit.rotation, pose.rotation, sizeof hit.rotation);
            if (scaled) {
                for (int a = 0; a < 3; ++a) {
                    hit.o[a] /= scale[a];
                    hit.d[a] /= scale[a];
                    for (int b = 0; b < 3; ++b) hit.rotation[3 * b + a] /= scale[a];
                }
                hit.stretch = std::sqrt(hit.d[0] * hit.d[0] + hit.d[1] * hit.d[1] + hit.d[2] * hit.d[2]);
            }
            if (!intersect_box(hit.o, hit.d, minus, half, near, hit.t_near, hit.t_far)) continue;
            hits.push_back(hit);
        }
    }
}

} // namespace
