// Functions of one ray: poses of boxes at a time, boxes and cells along it, the ground below it. The CPU's kernels and
// the GPU's (cuda/) share them, so they take no vectors of `simd.h` and no containers.
#pragma once
#include "unisim_native.h"

#include <algorithm>
#include <cmath>

#if defined(__CUDACC__)
#define UNISIM_DEVICE __host__ __device__
#define UNISIM_UNROLL _Pragma("unroll")
#else
#define UNISIM_DEVICE
#define UNISIM_UNROLL
#endif
// A function that is called, so that its code is there once.
#define UNISIM_CALLED UNISIM_DEVICE __attribute__((noinline)) static

namespace {

// Samples and segments of a smaller weight get no normal, light or view-dependent feature.
constexpr float MIN_WEIGHT = 1e-4f;
// Samples of a smaller weight are left out of sums of features: a millionth of a feature changes none of its digits.
constexpr float NEGLIGIBLE_WEIGHT = 1e-6f;

constexpr int CELLS = 2;
// Evaluated points along each edge of a cell.
constexpr int POINTS = 2;
constexpr int BOX_CELLS = 16;
enum : uint8_t { OPEN, SOLID, SURFACE };

struct Pose {
    double position[3];
    float rotation[9]; // world from box
};

UNISIM_DEVICE inline void slerp(const double *a, const double *b, double u, double *q) {
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

UNISIM_DEVICE inline KeyInterval key_interval(const unisim_actor_set &set, int actor, double time) {
    const double *times = set.times + static_cast<int64_t>(actor) * set.keys;
    const int length = set.lengths[actor];
    int upper = 0;
    for (int end = length; upper < end;) { // the first key after the time
        const int middle = (upper + end) / 2;
        if (time < times[middle])
            end = middle;
        else
            upper = middle + 1;
    }
    upper = length == 1 ? 0 : std::max(1, std::min(upper, length - 1));
    const int lower = std::max(upper - 1, 0);
    return {lower, upper, length == 1 ? 0.0 : (time - times[lower]) / (times[upper] - times[lower])};
}

UNISIM_DEVICE inline void position_at(const unisim_actor_set &set, int actor, const KeyInterval &at, double *position) {
    const double *positions = set.positions + static_cast<int64_t>(actor) * set.keys * 3;
    for (int i = 0; i < 3; ++i)
        position[i] = positions[3 * at.lower + i] + at.u * (positions[3 * at.upper + i] - positions[3 * at.lower + i]);
}

UNISIM_DEVICE inline void position_at(const unisim_actor_set &set, int actor, double time, double *position) {
    position_at(set, actor, key_interval(set, actor, time), position);
}

// r (3, 3): world from box.
UNISIM_DEVICE inline void rotation_at(const unisim_actor_set &set, int actor, const KeyInterval &at, double *r) {
    const double *quaternions = set.quaternions + static_cast<int64_t>(actor) * set.keys * 4;
    double q[4];
    slerp(quaternions + 4 * at.lower, quaternions + 4 * at.upper, at.u, q);
    const double w = q[0], x = q[1], y = q[2], z = q[3];
    r[0] = 1 - 2 * (y * y + z * z), r[1] = 2 * (x * y - w * z), r[2] = 2 * (x * z + w * y);
    r[3] = 2 * (x * y + w * z), r[4] = 1 - 2 * (x * x + z * z), r[5] = 2 * (y * z - w * x);
    r[6] = 2 * (x * z - w * y), r[7] = 2 * (y * z + w * x), r[8] = 1 - 2 * (x * x + y * y);
}

UNISIM_DEVICE inline Pose pose_at(const unisim_actor_set &set, int actor, double time) {
    const KeyInterval at = key_interval(set, actor, time);
    Pose pose;
    double r[9];
    position_at(set, actor, at, pose.position);
    rotation_at(set, actor, at, r);
    for (int i = 0; i < 9; ++i) pose.rotation[i] = static_cast<float>(r[i]);
    return pose;
}

// Where a ray is inside an axis-aligned box; false where it misses the box.
UNISIM_DEVICE inline bool intersect_box(const float *o, const float *d, const float *low, const float *high, float near,
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

// The radius of the sphere about a box.
UNISIM_DEVICE inline double sphere_radius(const unisim_actor_set &set, int actor) {
    const float *size = set.sizes + 3 * actor, *scale = set.scales + 3 * actor;
    const float world[3] = {size[0] / 2 * scale[0], size[1] / 2 * scale[1], size[2] / 2 * scale[2]};
    return std::sqrt(static_cast<double>(world[0]) * world[0] + world[1] * world[1] + world[2] * world[2]) + 1e-3;
}

// Whether a ray comes as near as `radius` to a position; `to`: the position from the ray's origin.
UNISIM_DEVICE inline bool reaches_sphere(const double *position, const double *o, const double *d, double radius,
                                         double *to) {
    double along = 0, squared = 0;
    for (int a = 0; a < 3; ++a) {
        to[a] = position[a] - o[a];
        along += to[a] * d[a];
        squared += to[a] * to[a];
    }
    along = along > 0.0 ? along : 0.0;
    return !(squared - along * along > radius * radius);
}

// Fills in the hit of a ray with a box whose place is `to` from the ray's origin; false where the ray misses the box.
UNISIM_DEVICE inline bool enter_box(const unisim_actor_set &set, int actor, const Pose &pose, const double *to,
                                    const double *d, float near, BoxHit &hit) {
    const float *size = set.sizes + 3 * actor, *scale = set.scales + 3 * actor;
    const float half[3] = {size[0] / 2, size[1] / 2, size[2] / 2}, minus[3] = {-half[0], -half[1], -half[2]};
    for (int a = 0; a < 3; ++a) {
        hit.o[a] = hit.d[a] = 0;
        for (int b = 0; b < 3; ++b) {
            hit.o[a] -= pose.rotation[3 * b + a] * static_cast<float>(to[b]);
            hit.d[a] += pose.rotation[3 * b + a] * static_cast<float>(d[b]);
        }
    }
    for (int i = 0; i < 9; ++i) hit.rotation[i] = pose.rotation[i];
    if (scale[0] != 1.0f || scale[1] != 1.0f || scale[2] != 1.0f) {
        for (int a = 0; a < 3; ++a) {
            hit.o[a] /= scale[a];
            hit.d[a] /= scale[a];
            for (int b = 0; b < 3; ++b) hit.rotation[3 * b + a] /= scale[a];
        }
        hit.stretch = std::sqrt(hit.d[0] * hit.d[0] + hit.d[1] * hit.d[1] + hit.d[2] * hit.d[2]);
    }
    return intersect_box(hit.o, hit.d, minus, half, near, hit.t_near, hit.t_far);
}

UNISIM_DEVICE inline void transform(const double *m, const double *x, float *out) {
    for (int a = 0; a < 3; ++a)
        out[a] = static_cast<float>(m[4 * a] * x[0] + m[4 * a + 1] * x[1] + m[4 * a + 2] * x[2] + m[4 * a + 3]);
}

UNISIM_DEVICE inline void turn(const double *m, const double *x, float *out) {
    for (int a = 0; a < 3; ++a)
        out[a] = static_cast<float>(m[4 * a] * x[0] + m[4 * a + 1] * x[1] + m[4 * a + 2] * x[2]);
}

// Moves a hit of a copied box to the source (3, 4) of the copy, in the coordinates of the scene's volume. Its rotation
// then leads from the world's axes at the source to the box's axes, and on to the world's axes at the copy.
UNISIM_DEVICE inline void move_to_source(const unisim_scene &scene, const double *source, BoxHit &hit) {
    double world[3], along[3];
    for (int a = 0; a < 3; ++a) {
        world[a] = source[4 * a + 3];
        along[a] = 0;
        for (int c = 0; c < 3; ++c) {
            world[a] += source[4 * a + c] * hit.o[c];
            along[a] += source[4 * a + c] * hit.d[c];
        }
    }
    float rotation[9] = {};
    transform(scene.volume_from_world, world, hit.o);
    turn(scene.volume_from_world, along, hit.d);
    for (int a = 0; a < 3; ++a)
        for (int c = 0; c < 3; ++c)
            for (int e = 0; e < 3; ++e)
                rotation[3 * a + c] += hit.rotation[3 * a + e] * static_cast<float>(source[4 * c + e]);
    for (int i = 0; i < 9; ++i) hit.rotation[i] = rotation[i];
}

// Height of the ground at (x, y), volume coordinates: bilinear between the centres of cells.
UNISIM_DEVICE inline float ground_at(const unisim_scene &s, float x, float y) {
    const float u = std::fmin(std::fmax(x / s.ground_m - 0.5f, 0.0f), static_cast<float>(s.ground_shape[0] - 1));
    const float v = std::fmin(std::fmax(y / s.ground_m - 0.5f, 0.0f), static_cast<float>(s.ground_shape[1] - 1));
    const int i = static_cast<int>(u), j = static_cast<int>(v), wide = s.ground_shape[1];
    const int ii = std::min(i + 1, s.ground_shape[0] - 1), jj = std::min(j + 1, wide - 1);
    const float fu = u - static_cast<float>(i), fv = v - static_cast<float>(j);
    return (1 - fu) * ((1 - fv) * s.ground[i * wide + j] + fv * s.ground[i * wide + jj]) +
           fu * ((1 - fv) * s.ground[ii * wide + j] + fv * s.ground[ii * wide + jj]);
}

// An interval of a ray, metres, through consecutive cells that can stop it.
struct Run {
    float begin, end;
};

// Where a ray is inside the cell that contains its point at t. Runs begin and end exactly there: outside such cells
// the distance was not trained.
UNISIM_DEVICE inline Run cell_interval(const unisim_scene &scene, const float *o, const float *d, float t) {
    const float size = scene.voxel_m / CELLS;
    Run run{0, 3e38f};
    for (int a = 0; a < 3; ++a) {
        if (std::fabs(d[a]) < 1e-9f) continue;
        const float low = std::floor((o[a] + t * d[a]) / size) * size;
        const float first = (low - o[a]) / d[a], second = (low + size - o[a]) / d[a];
        run.begin = std::max(run.begin, std::min(first, second));
        run.end = std::min(run.end, std::max(first, second));
    }
    return run.begin < run.end ? run : Run{t, t};
}

// Bounds for any input, NaN and directions of length 0 included.
constexpr float MAX_STEPS = 1e6f, MAX_BOX_STEPS = 1e4f;

// How many steps of length `step` there are from t_near to t_far, at most `limit`; NaN gives `limit`.
UNISIM_DEVICE inline int32_t steps_between(float t_near, float t_far, float step, float limit) {
    return t_far > t_near ? static_cast<int32_t>(std::min(limit, std::ceil((t_far - t_near) / step))) : 0;
}

// Where a ray leaves free space and enters a solid, the surface lies in between: it was trained by samples on both
// sides. Looks at `count` samples at `ts` with optical depths `depths`, `stride` apart. Sets `before` to the sample
// that free space precedes and t to the nearest occupied place before that sample; returns false where there is none.
UNISIM_DEVICE inline bool find_face(const unisim_scene &scene, const float *o, const float *d, float t_near,
                                    const float *ts, const float *depths, int count, int stride, int &before,
                                    float &t) {
    const float step = scene.voxel_m / 2;
    for (int k = 0; k < count; ++k) {
        if (depths[k * stride] < 0.05f) continue;
        const float lowest = k ? ts[(k - 1) * stride] + step : t_near;
        for (t = ts[k * stride] - step; t > lowest; t -= step) {
            int64_t cell = 0;
            for (int a = 0; a < 3; ++a) {
                const float last = static_cast<float>(scene.voxel_shape[a] - 1);
                const float x = std::min(std::max((o[a] + t * d[a]) / scene.voxel_m, 0.0f), last);
                cell = cell * scene.voxel_shape[a] + static_cast<int64_t>(x);
            }
            if (!scene.voxels[cell]) continue;
            before = k;
            return true;
        }
        return false;
    }
    return false;
}

// Constants as in Sloan, "Stupid Spherical Harmonics Tricks", 2008, appendix A2.
UNISIM_DEVICE inline void spherical_harmonics(const float *direction, float *out) {
    const float x = direction[0], y = direction[1], z = direction[2];
    const float xx = x * x, yy = y * y, zz = z * z, xy = x * y, yz = y * z, xz = x * z;
    out[0] = 0.28209479177387814f;
    out[1] = -0.48860251190291987f * y;
    out[2] = 0.48860251190291987f * z;
    out[3] = -0.48860251190291987f * x;
    out[4] = 1.0925484305920792f * xy;
    out[5] = -1.0925484305920792f * yz;
    out[6] = 0.94617469575755997f * zz - 0.31539156525251999f;
    out[7] = -1.0925484305920792f * xz;
    out[8] = 0.54627421529603959f * (xx - yy);
    out[9] = 0.59004358992664352f * y * (-3.0f * xx + yy);
    out[10] = 2.8906114426405538f * xy * z;
    out[11] = 0.45704579946446572f * y * (1.0f - 5.0f * zz);
    out[12] = 0.3731763325901154f * z * (5.0f * zz - 3.0f);
    out[13] = 0.45704579946446572f * x * (1.0f - 5.0f * zz);
    out[14] = 1.4453057213202769f * z * (xx - yy);
    out[15] = 0.59004358992664352f * x * (-xx + 3.0f * yy);
}

} // namespace
