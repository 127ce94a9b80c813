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
    const double angle = 2 * std::asin(std::fmin(std::sqrt(chord) / 2, 0.7071067811865476)), sine = std::sin(angle);
    const double wa = sine < 1e-4 ? 1 - u : std::sin((1 - u) * angle) / sine, wb = sine < 1e-4 ? u : std::sin(u * angle) / sine;
    for (int i = 0; i < 4; ++i) {
        q[i] = wa * a[i] + sign * wb * b[i];
        norm += q[i] * q[i];
    }
    norm = std::sqrt(norm);
    for (int i = 0; i < 4; ++i) q[i] /= norm;
}

inline Pose pose_at(const unisim_troupe &troupe, int actor, double time) {
    const double *times = troupe.times + static_cast<int64_t>(actor) * troupe.keys;
    const double *positions = troupe.positions + static_cast<int64_t>(actor) * troupe.keys * 3;
    const double *quaternions = troupe.quaternions + static_cast<int64_t>(actor) * troupe.keys * 4;
    const int length = troupe.lengths[actor];
    int upper = static_cast<int>(std::upper_bound(times, times + length, time) - times);
    upper = length == 1 ? 0 : std::max(1, std::min(upper, length - 1));
    const int lower = std::max(upper - 1, 0);
    const double u = length == 1 ? 0.0 : (time - times[lower]) / (times[upper] - times[lower]);
    Pose pose;
    for (int i = 0; i < 3; ++i) pose.position[i] = positions[3 * lower + i] + u * (positions[3 * upper + i] - positions[3 * lower + i]);
    double q[4];
    slerp(quaternions + 4 * lower, quaternions + 4 * upper, u, q);
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

// A ray in one box: its number in the tile, the box's in the troupe, the ray in the box's axes, metres.
struct Hit {
    int ray, box;
    float t_near, t_far, o[3], d[3];
    float rotation[9];
};

struct TileRays {
    int count;
    const double *origin[64], *direction[64];
    double time[64];
};

inline void meet_boxes(const unisim_troupe &troupe, const TileRays &rays, float near, std::vector<Hit> &hits) {
    for (int c = 0; c < troupe.candidates; ++c) {
        const int actor = troupe.among[c];
        const float *size = troupe.sizes + 3 * actor;
        const float half[3] = {size[0] / 2, size[1] / 2, size[2] / 2}, minus[3] = {-half[0], -half[1], -half[2]};
        const double radius = std::sqrt(static_cast<double>(half[0]) * half[0] + half[1] * half[1] + half[2] * half[2]) + 1e-3;
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
            Hit hit{r, actor, 0, 0, {}, {}, {}};
            for (int a = 0; a < 3; ++a)
                for (int b = 0; b < 3; ++b) {
                    hit.o[a] -= pose.rotation[3 * b + a] * static_cast<float>(to[b]);
                    hit.d[a] += pose.rotation[3 * b + a] * static_cast<float>(d[b]);
                }
            if (!span_of_box(hit.o, hit.d, minus, half, near, hit.t_near, hit.t_far)) continue;
            std::memcpy(hit.rotation, pose.rotation, sizeof hit.rotation);
            hits.push_back(hit);
        }
    }
}

} // namespace
