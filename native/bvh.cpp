// Rays against triangles: a bounding volume hierarchy (binned surface area heuristic; Wald, "On fast construction of
// SAH-based bounding volume hierarchies", 2007) and the first triangle on each ray (Moeller and Trumbore, 1997).
#include "variant.h"

#include <cmath>
#include <limits>
#include <numeric>

namespace {

constexpr int BINS = 16;
constexpr int LEAF = 4;
constexpr int MAX_DEPTH = 60; // from here on nodes are halved, so that a traversal stack of 128 always suffices

struct Box {
    float low[3], high[3];

    Box() {
        for (int k = 0; k < 3; ++k) low[k] = std::numeric_limits<float>::infinity(), high[k] = -low[k];
    }
    void add(const float *p) {
        for (int k = 0; k < 3; ++k) low[k] = std::min(low[k], p[k]), high[k] = std::max(high[k], p[k]);
    }
    void add(const Box &b) {
        for (int k = 0; k < 3; ++k) low[k] = std::min(low[k], b.low[k]), high[k] = std::max(high[k], b.high[k]);
    }
    double area() const {
        const double x = high[0] - low[0], y = high[1] - low[1], z = high[2] - low[2];
        return x < 0 ? 0.0 : x * y + y * z + z * x;
    }
};

struct Builder {
    unisim_bvh_node *nodes;
    int32_t *order;
    std::vector<Box> boxes;
    std::vector<float> centres; // (F, 3)
    int32_t count = 0;

    float centre(int32_t face, int axis) const { return centres[3 * static_cast<int64_t>(face) + axis]; }

    // Partitions the faces of [begin, end) and returns where; returns begin where no split is worth its cost.
    int32_t split(int32_t begin, int32_t end, const Box &whole, const Box &middles, int depth) {
        double best = std::numeric_limits<double>::infinity();
        int axis = -1, at = 0;
        for (int k = 0; k < 3 && depth < MAX_DEPTH; ++k) {
            const float span = middles.high[k] - middles.low[k];
            if (!(span > 0 && span <= std::numeric_limits<float>::max())) continue;
            Box bin[BINS];
            int64_t filled[BINS] = {};
            for (int32_t i = begin; i < end; ++i) {
                const int b = bin_of(centre(order[i], k), middles.low[k], span);
                bin[b].add(boxes[order[i]]);
                ++filled[b];
            }
            double right[BINS];
            Box far;
            int64_t behind = 0;
            for (int b = BINS - 1; b > 0; --b) {
                far.add(bin[b]);
                behind += filled[b];
                right[b] = behind ? far.area() * behind : 0.0;
            }
            Box near;
            int64_t before = 0;
            for (int b = 1; b < BINS; ++b) {
                near.add(bin[b - 1]);
                before += filled[b - 1];
                if (before == 0 || before == end - begin) continue;
                const double cost = near.area() * before + right[b];
                if (cost < best) best = cost, axis = k, at = b;
            }
        }
        if (axis >= 0) {
            if (end - begin <= LEAF && best >= whole.area() * (end - begin)) return begin;
            const float low = middles.low[axis], span = middles.high[axis] - low;
            const auto middle = std::stable_partition(
                order + begin, order + end, [&](int32_t f) { return bin_of(centre(f, axis), low, span) < at; });
            return static_cast<int32_t>(middle - order);
        }
        return end - begin <= LEAF ? begin : begin + (end - begin) / 2;
    }

    static int bin_of(float x, float low, float span) {
        const float place = (x - low) / span * BINS;
        return place > 0 ? static_cast<int>(std::min(place, BINS - 1.0f)) : 0; // no NaN is a number of a bin
    }

    // Builds one node for [begin, end); its children are consecutive.
    void build(int32_t node, int32_t begin, int32_t end, int depth) {
        Box whole, middles;
        for (int32_t i = begin; i < end; ++i)
            whole.add(boxes[order[i]]), middles.add(&centres[3 * static_cast<int64_t>(order[i])]);
        std::copy(whole.low, whole.low + 3, nodes[node].low);
        std::copy(whole.high, whole.high + 3, nodes[node].high);
        const int32_t middle = split(begin, end, whole, middles, depth);
        if (middle == begin) {
            nodes[node].first = begin;
            nodes[node].faces = end - begin;
            return;
        }
        const int32_t left = count;
        count += 2;
        nodes[node].first = left;
        nodes[node].faces = 0;
        build(left, begin, middle, depth + 1);
        build(left + 1, middle, end, depth + 1);
    }
};

// The distance at which a ray enters a node's box, or infinity.
float entry(const unisim_bvh_node &n, const float *o, const float *inverse, float near, float far) {
    for (int k = 0; k < 3; ++k) {
        const float a = (n.low[k] - o[k]) * inverse[k], b = (n.high[k] - o[k]) * inverse[k];
        near = std::max(near, std::min(a, b));
        // rounded up twice, so that no ray misses a box but hits what is inside
        far = std::min(far, std::max(a, b) * 1.0000005f);
    }
    return near <= far ? near : std::numeric_limits<float>::infinity();
}

struct Triangle {
    double a[3], ab[3], ac[3];

    Triangle(const float *vertices, const int32_t *face) {
        const float *p = vertices + 3 * static_cast<int64_t>(face[0]),
                    *q = vertices + 3 * static_cast<int64_t>(face[1]),
                    *r = vertices + 3 * static_cast<int64_t>(face[2]);
        for (int k = 0; k < 3; ++k) a[k] = p[k], ab[k] = double(q[k]) - p[k], ac[k] = double(r[k]) - p[k];
    }
};

double dot(const double *a, const double *b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

void cross(const double *a, const double *b, double *out) {
    out[0] = a[1] * b[2] - a[2] * b[1];
    out[1] = a[2] * b[0] - a[0] * b[2];
    out[2] = a[0] * b[1] - a[1] * b[0];
}

// Intersects a triangle in (near, far): the distance, and barycentric u (of the second corner) and v (of the third).
bool intersects(const Triangle &tri, const double *o, const double *d, double near, double far, double *t, double *u,
                double *v) {
    double p[3], q[3], s[3];
    cross(d, tri.ac, p);
    const double det = dot(tri.ab, p);
    if (det == 0.0) return false;
    for (int k = 0; k < 3; ++k) s[k] = o[k] - tri.a[k];
    *u = dot(s, p) / det;
    if (!(*u >= 0.0 && *u <= 1.0)) return false;
    cross(s, tri.ab, q);
    *v = dot(d, q) / det;
    if (!(*v >= 0.0 && *u + *v <= 1.0)) return false;
    *t = dot(tri.ac, q) / det;
    return *t > near && *t < far;
}

} // namespace

// nodes: room for 2 n - 1; order: (n). Returns the number of nodes.
extern "C" int32_t UNISIM_NAME(unisim_bvh_build)(const float *vertices, const int32_t *faces, int32_t n,
                                                 unisim_bvh_node *nodes, int32_t *order) {
    Builder builder{nodes, order, std::vector<Box>(n), std::vector<float>(3 * static_cast<int64_t>(n)), 1};
    for (int32_t f = 0; f < n; ++f) {
        for (int c = 0; c < 3; ++c)
            builder.boxes[f].add(vertices + 3 * static_cast<int64_t>(faces[3 * static_cast<int64_t>(f) + c]));
        for (int k = 0; k < 3; ++k)
            builder.centres[3 * static_cast<int64_t>(f) + k] =
                0.5f * builder.boxes[f].low[k] + 0.5f * builder.boxes[f].high[k];
    }
    std::iota(order, order + n, 0);
    builder.build(0, 0, n, 0);
    return builder.count;
}

// For each ray (n, 3), its first hit beyond `near`: t (n), infinity where there is none; face (n), -1 for none; uv
// (n, 2).
extern "C" int UNISIM_NAME(unisim_bvh_first_hits)(const unisim_bvh_node *nodes, const int32_t *order,
                                                  const float *vertices, const int32_t *faces, const double *origins,
                                                  const double *directions, int64_t n, double near, double *t,
                                                  int32_t *face, float *uv, int threads) {
    double centre[3], radius = 0;
    for (int k = 0; k < 3; ++k) {
        centre[k] = 0.5 * nodes[0].low[k] + 0.5 * nodes[0].high[k];
        radius += (nodes[0].high[k] - centre[k]) * (nodes[0].high[k] - centre[k]);
    }
    radius = std::sqrt(radius);
    parallel_blocks(n, 1024, threads, [&](int64_t begin, int64_t end) {
        int32_t stack[128];
        float reached[128];
        for (int64_t i = begin; i < end; ++i) {
            const double *d = directions + 3 * i;
            // from nearby: boxes are intersected in float32, whose precision is 1e-7 of the distance
            double o[3], before = 0;
            for (int k = 0; k < 3; ++k) before += (centre[k] - origins[3 * i + k]) * d[k];
            before = std::max(near, before - radius);
            float origin[3], inverse[3];
            for (int k = 0; k < 3; ++k) {
                o[k] = origins[3 * i + k] + before * d[k];
                origin[k] = static_cast<float>(o[k]);
                // finite, so that a ray in the plane of a box's face gives 0 there and not NaN
                inverse[k] = std::abs(d[k]) < 1e-30 ? 1e30f : static_cast<float>(1.0 / d[k]);
            }
            double closest = std::numeric_limits<double>::infinity(), best_u = 0, best_v = 0;
            int32_t hit = -1;
            int top = 0;
            const float start = entry(nodes[0], origin, inverse, 0.0f, std::numeric_limits<float>::infinity());
            if (std::isfinite(start)) stack[top] = 0, reached[top++] = start;
            while (top) {
                const unisim_bvh_node &node = nodes[stack[--top]];
                if (reached[top] > closest) continue;
                if (node.faces) {
                    for (int32_t j = node.first; j < node.first + node.faces; ++j) {
                        double at, u, v;
                        // of two at one distance the lower number wins, whatever the order of traversal
                        if (intersects(Triangle(vertices, faces + 3 * static_cast<int64_t>(order[j])), o, d, 0.0,
                                  std::nextafter(closest, std::numeric_limits<double>::infinity()), &at, &u, &v) &&
                            (at < closest || order[j] < hit))
                            closest = at, hit = order[j], best_u = u, best_v = v;
                    }
                    continue;
                }
                const float far = std::isfinite(closest) ? static_cast<float>(closest) * 1.0000005f
                                                         : std::numeric_limits<float>::infinity();
                const float a = entry(nodes[node.first], origin, inverse, 0.0f, far);
                const float b = entry(nodes[node.first + 1], origin, inverse, 0.0f, far);
                const int32_t later = a <= b ? node.first + 1 : node.first;
                if (std::isfinite(std::max(a, b))) stack[top] = later, reached[top++] = std::max(a, b);
                if (std::isfinite(std::min(a, b)))
                    stack[top] = a <= b ? node.first : node.first + 1, reached[top++] = std::min(a, b);
            }
            t[i] = before + closest, face[i] = hit;
            uv[2 * i] = static_cast<float>(best_u), uv[2 * i + 1] = static_cast<float>(best_v);
        }
    });
    return 0;
}
