// Boxes on their ways: where each stands at a ray's time, and which rays go through it. Positions are differences in float64 before
// they become float32, so that a drive may lie anywhere.
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
    double dot = 0, chord = 0, norm = 0;
    for (int i = 0; i < 4; ++i) dot += a[i] * b[i];
    const double sign = dot < 0 ? -1.0 : 1.0;
    for (int i = 0; i < 4; ++i) chord += (a[i] - sign * b[i]) * (a[i] - sign * b[i]);
    // the angle from the chord: acos loses half its digits near 1
    const double angle = 2 * std::asin(std::fmin(std::sqrt(chord) / 2, 0.7071067811865476));
    // over a small angle the chord's point, put back onto the sphere, is the arc's to a millionth of the angle
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

// The two keys about a time, and how far it is between them.
struct Between {
    int lower, upper;
    double u;
};

inline Between keys_about(const unisim_troupe &troupe, int actor, double time) {
    const double *times = troupe.times + static_cast<int64_t>(actor) * troupe.keys;
    const int length = troupe.lengths[actor];
    int upper = static_cast<int>(std::upper_bound(times, times + length, time) - times);
    upper = length == 1 ? 0 : std::max(1, std::min(upper, length - 1));
    const int lower = std::max(upper - 1, 0);
    return {lower, upper, length == 1 ? 0.0 : (time - times[lower]) / (times[upper] - times[lower])};
}

inline void position_at(const unisim_troupe &troupe, int actor, const Between &at, double *position) {
    const double *positions = troupe.positions + static_cast<int64_t>(actor) * troupe.keys * 3;
    for (int i = 0; i < 3; ++i)
        position[i] = positions[3 * at.lower + i] + at.u * (positions[3 * at.upper + i] - positions[3 * at.lower + i]);
}

inline void position_at(const unisim_troupe &troupe, int actor, double time, double *position) {
    position_at(troupe, actor, keys_about(troupe, actor, time), position);
}

inline Pose pose_at(const unisim_troupe &troupe, int actor, double time) {
    const Between at = keys_about(troupe, actor, time);
    const double *quaternions = troupe.quaternions + static_cast<int64_t>(actor) * troupe.keys * 4;
    Pose pose;
    position_at(troupe, actor, at, pose.position);
    double q[4];
    slerp(quaternions + 4 * at.lower, quaternions + 4 * at.upper, at.u, q);
    const double w = q[0], x = q[1], y = q[2], z = q[3];
    const double r[9] = {1 - 2 * (y * y + z * z), 2 * (x * y - w * z),     2 * (x * z + w * y),
                         2 * (x * y + w * z),     1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
                         2 * (x * z - w * y),     2 * (y * z + w * x),     1 - 2 * (x * x + y * y)};
    for (int i = 0; i < 9; ++i) pose.rotation[i] = static_cast<float>(r[i]);
    return pose;
}

// Where a ray is inside a box about the origin; false where it misses it.
inline bool span_of_box(const float *o, const float *d, const float *low, const float *high, float near, float &t_near, float &t_far) {
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

// A ray in one box: its number in the tile, the box's in the troupe, the ray along the box's axes in the metres of the field, from
// t_near to t_far metres in the world. The scale of a box is taken out here, and nowhere else: `d` of a scaled one is not unit,
// `stretch` is its length, field metres for each metre along the ray, and `rotation`, which takes gradients to the world, is the
// box's after the inverse of the scale.
struct Hit {
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

// The cone that holds a tile's rays, and the span of their times.
struct Bundle {
    double origin[3] = {}, axis[3] = {}, spread = 0, half_angle = 3.2, first, last;

    explicit Bundle(const TileRays &rays) : first(rays.time[0]), last(rays.time[0]) {
        double length = 0, least = 1;
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
            // anything that is no number ends up below, and holds nothing off
            dot /= length * std::sqrt(norm);
            least = dot >= least ? least : dot;
            spread = std::max(spread, std::sqrt(apart));
            first = std::min(first, rays.time[r]);
            last = std::max(last, rays.time[r]);
        }
        for (double &x : axis) x /= length;
        if (least > 0) half_angle = std::acos(std::min(least, 1.0)) + 1e-4;
    }

    // Whether a box can be met: by the sphere that holds it where it is from the first time to the last.
    bool reaches(const unisim_troupe &troupe, int actor, double radius) const {
        if (last < troupe.start[actor] || first > troupe.end[actor]) return false;
        // over a longer span a way may bend
        if (half_angle > 1.5 || last - first > 0.04) return true;
        double from[3], to[3], moved = 0, distance = 0, along = 0;
        position_at(troupe, actor, first, from);
        position_at(troupe, actor, last, to);
        for (int a = 0; a < 3; ++a) {
            moved += (to[a] - from[a]) * (to[a] - from[a]);
            const double x = (from[a] + to[a]) / 2 - origin[a];
            distance += x * x;
            along += x * axis[a];
        }
        distance = std::sqrt(distance);
        const double reach = radius + std::sqrt(moved) / 2 + spread + 0.01;
        if (!(distance > reach)) return true;
        return std::acos(std::max(-1.0, std::min(1.0, along / distance))) <= half_angle + std::asin(reach / distance);
    }
};

inline void meet_boxes(const unisim_troupe &troupe, const TileRays &rays, float near, std::vector<Hit> &hits) {
    if (!troupe.candidates) return;
    const Bundle bundle(rays);
    for (int c = 0; c < troupe.candidates; ++c) {
        const int actor = troupe.among[c];
        const float *size = troupe.sizes + 3 * actor, *scale = troupe.scales + 3 * actor;
        const float half[3] = {size[0] / 2, size[1] / 2, size[2] / 2}, minus[3] = {-half[0], -half[1], -half[2]};
        const float world[3] = {half[0] * scale[0], half[1] * scale[1], half[2] * scale[2]};
        const double radius = std::sqrt(static_cast<double>(world[0]) * world[0] + world[1] * world[1] + world[2] * world[2]) + 1e-3;
        const bool scaled = scale[0] != 1.0f || scale[1] != 1.0f || scale[2] != 1.0f;
        if (!bundle.reaches(troupe, actor, radius)) continue;
        Pose pose{};
        double posed = NAN;
        for (int r = 0; r < rays.count; ++r) {
            const double time = rays.time[r], *o = rays.origin[r], *d = rays.direction[r];
            if (!(time >= troupe.start[actor] && time <= troupe.end[actor])) continue;
            // rays of one row or column share their time
            if (time != posed) pose = pose_at(troupe, actor, posed = time);
            double to[3], along = 0, squared = 0;
            for (int a = 0; a < 3; ++a) {
                to[a] = pose.position[a] - o[a];
                along += to[a] * d[a];
                squared += to[a] * to[a];
            }
            along = std::max(along, 0.0);
            if (squared - along * along > radius * radius) continue;
            Hit hit{r, actor, 0, 0, {}, {}, {}, 1.0f};
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
            if (!span_of_box(hit.o, hit.d, minus, half, near, hit.t_near, hit.t_far)) continue;
            hits.push_back(hit);
        }
    }
}

} // namespace
