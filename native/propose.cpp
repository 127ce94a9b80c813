// Ray proposals. The specification is plain torch, in core/ops/propose.py and core/ops/quantiles.py.
#include "field_tile.h"
#include "one_ray.h"
#include "sample_placement.h"

#include <memory>

namespace {

// First outputs s (n, count) of a field at places t (n, count) along rays; point(i, t, x) gives the point of ray i in the
// field's unit cube.
struct FieldAlong {
    const Field &field;
    std::vector<float> code, h;

    explicit FieldAlong(const Field &of)
        : field(of), code(static_cast<size_t>(BLOCK) * of.inputs), h(static_cast<size_t>(BLOCK) * of.wide) {}

    template <class Point> void evaluate(size_t n, size_t count, const float *t, float *s, const Point &point) {
        float x[3][BLOCK], p[3];
        int points = 0;
        for (size_t i = 0; i < n; ++i)
            for (size_t k = 0; k < count; ++k, ++t) {
                point(i, *t, p);
                for (int a = 0; a < 3; ++a) x[a][points] = p[a];
                if (++points < BLOCK && !(i + 1 == n && k + 1 == count)) continue;
                for (int rest = points; rest % LANES; ++rest)
                    for (int a = 0; a < 3; ++a) x[a][rest] = p[a];
                field.units(x, nullptr, points, code.data(), h.data());
                for (int j = 0; j < points; ++j) *s++ = field.first_output(&h[static_cast<size_t>(j) * field.wide]);
                points = 0;
            }
    }
};

// A ray that steps through the voxels.
struct VoxelRay {
    const float *o, *d;
    const uint8_t *voxels;
    const int32_t *shape;
    const float *lower;
    float inverse, near, step;

    // Values (BLOCK) of the voxels at the centres of the steps from `first` on, 0 outside the grid. Returns whether
    // one is not 0.
    bool values(int64_t first, uint8_t *value) const {
        int32_t cell[3][BLOCK], inside[BLOCK];
        for (int i = 0; i < BLOCK; ++i) inside[i] = 1;
        for (int a = 0; a < 3; ++a) {
            const float origin = o[a] - lower[a], along = d[a], end = static_cast<float>(shape[a]);
            for (int i = 0; i < BLOCK; ++i) {
                const float t = near + (static_cast<float>(static_cast<int32_t>(first) + i) + 0.5f) * step;
                const float x = (origin + t * along) * inverse;
                const int32_t in = (x >= 0.0f) & (x < end);
                cell[a][i] = static_cast<int32_t>(in ? x : 0.0f);
                inside[i] &= in;
            }
        }
        uint8_t any = 0;
        for (int i = 0; i < BLOCK; ++i) {
            const int64_t row = static_cast<int64_t>(cell[0][i]) * shape[1] + cell[1][i];
            value[i] = voxels[row * shape[2] + cell[2][i]] & static_cast<uint8_t>(-inside[i]);
            any |= value[i];
        }
        return any != 0;
    }
};

// Sums of x (4 * quarter) up to each number: four chains, so that an addition need not wait for the one before.
void prefix_sums(const float *x, size_t quarter, float *sums) {
    float sum[4] = {};
    for (size_t i = 0; i < quarter; ++i)
        for (size_t c = 0; c < 4; ++c) sums[c * quarter + i] = sum[c] += x[c * quarter + i];
    float before = sum[0];
    for (size_t c = 1; c < 4; ++c) {
        for (size_t i = c * quarter; i < (c + 1) * quarter; ++i) sums[i] += before;
        before += sum[c];
    }
}

// Finds the occupied steps of rays. A step of the value p in 0..1 has the mass p * exp(-decay * step * sum of earlier p).
struct StepFinder {
    std::vector<float> p, depth;

    void find(const VoxelRay &ray, float span, float decay, OccupiedSteps &out) {
        const int64_t steps = span > 0 ? static_cast<int64_t>(std::ceil(span / ray.step)) : 0;
        const size_t room = static_cast<size_t>(steps + 2 * BLOCK);
        if (p.size() < room) p.resize(room), depth.resize(room);
        if (out.step.size() < room) out.step.resize(room), out.mass.resize(room);
        size_t count = 0;
        uint8_t value[BLOCK];
        for (int64_t first = 0; first < steps; first += BLOCK) {
            if (!ray.values(first, value)) continue;
            const int64_t inside = std::min<int64_t>(BLOCK, steps - first);
            for (int64_t i = 0; i < inside; ++i) {
                out.step[count] = static_cast<int32_t>(first + i);
                p[count] = static_cast<float>(value[i]) * (1.0f / 255.0f);
                count += value[i] != 0;
            }
        }
        const size_t quarter = (count + 4 * LANES - 1) / (4 * LANES) * LANES;
        std::fill(&p[count], &p[0] + 4 * quarter, 0.0f);
        prefix_sums(p.data(), quarter, depth.data());
        for (size_t i = 0; i < 4 * quarter; i += LANES) {
            const simd_float mass = load(&p[i]);
            store(&p[i], mass * exp_of(-decay * ray.step * (load(&depth[i]) - mass)));
        }
        prefix_sums(p.data(), quarter, out.mass.data());
        out.count = count;
    }
};

// Quantiles near the surfaces that the distances along rays show.
struct Refiner {
    int k;
    float beta, uniform;
    std::vector<float> tau, weight, edge;
    std::vector<double> cdf; // sums in double, as torch has them: flat parts enlarge their error

    Refiner(int samples, float sharpness, float even)
        : k(samples), beta(sharpness), uniform(even), tau(static_cast<size_t>(k) + 1), weight(tau.size()),
          edge(tau.size() + 1), cdf(tau.size() + 1) {}

    void refine(const float *u, const float *t, const float *s, const float *jitter, int count, float *out) {
        tau[0] = softplus(-beta * s[0]);
        for (int i = 1; i < k; ++i) {
            const float sharp = min_of(4.0f / max_of(t[i] - t[i - 1], 1e-4f), beta);
            tau[i] = max_of(0.0f, softplus(-sharp * s[i]) - softplus(-sharp * s[i - 1]));
        }
        double depth = 0;
        for (int i = 0; i < k; ++i) {
            weight[i] = static_cast<float>(-depth);
            depth += tau[i];
        }
        for (int i = 0; i < k; ++i) weight[i] = exp_of(weight[i]) * opacity_of(tau[i]) + 1e-5f;
        weight[k] = 1e-5f;
        double total = 0;
        for (int i = 0; i <= k; ++i) total += weight[i];
        // the ends of [0, 1] belong to the first and last interval
        edge[0] = cdf[0] = 0;
        edge[k + 1] = 1;
        for (int i = 0; i < k; ++i) edge[i + 1] = u[i];
        for (int i = 0; i <= k; ++i)
            cdf[i + 1] = cdf[i] + (1.0 - uniform) * weight[i] / total + uniform * (edge[i + 1] - edge[i]);
        int j = 1;
        for (int c = 0; c < count; ++c) {
            const double target = jitter[c] * cdf[k + 1];
            while (j <= k && cdf[j] <= target) ++j;
            const double fraction = (target - cdf[j - 1]) / max_of(cdf[j] - cdf[j - 1], 1e-12);
            out[c] = edge[j - 1] + static_cast<float>(fraction) * (edge[j] - edge[j - 1]);
        }
    }
};

} // namespace

// Finds the occupied voxels along each ray, and `count` places in them by inverse CDF.
//
// A ray is divided into steps of `step` from t_near[r] on. The voxel at the centre of a step has a value p in 0..1
// (uint8 / 255). u (n, count) in 0..1, increasing along each row, are the quantiles. t (n, count); mass (n) is the sum of
// the masses, 0 where a ray hits no occupied voxel (its t are then even between near and far).
extern "C" int UNISIM_NAME(unisim_propose)(const float *origins, const float *directions, const float *t_near,
                                           const float *t_far, int64_t n, const uint8_t *voxels, const int32_t *shape,
                                           const float *lower, const float *voxel_m, float step, float decay,
                                           const float *u, int count, float *t, float *mass, int threads) {
    parallel_blocks(n, 64, threads, [&](int64_t begin, int64_t end) {
        StepFinder finder;
        OccupiedSteps occupied;
        for (int64_t r = begin; r < end; ++r) {
            const VoxelRay ray{origins + r * 3, directions + r * 3, voxels,    shape,
                               lower,           1.0f / voxel_m[0],  t_near[r], step};
            const float span = t_far[r] - t_near[r];
            finder.find(ray, span, decay, occupied);
            mass[r] = occupied.total();
            const float *ur = u + r * count;
            if (mass[r] > 0)
                place_quantiles(occupied, step, t_near[r], ur, count, 1, t + r * count);
            else
                for (int k = 0; k < count; ++k) t[r * count + k] = t_near[r] + ur[k] * std::max(span, 0.0f);
        }
    });
    return 0;
}

// Quantiles out (n, count) near the surface of signed distances s (n, k), metres, at places t (n, k), metres, and
// quantiles u (n, k), by the weights of the logistic density of sharpness beta. The fraction `uniform` of the weight is
// distributed evenly over the quantiles. jitter (n, count) in 0..1 increases along each row.
extern "C" int UNISIM_NAME(unisim_refine)(const float *u, const float *t, const float *s, int64_t n, int k, float beta,
                                          float uniform, const float *jitter, int count, float *out, int threads) {
    parallel_blocks(n, 64, threads, [&](int64_t begin, int64_t end) {
        Refiner refiner(k, beta, uniform);
        for (int64_t r = begin; r < end; ++r)
            refiner.refine(u + r * k, t + r * k, s + r * k, jitter + r * count, count, out + r * count);
    });
    return 0;
}

// Places `count` samples of each ray in the static field: `proposals` places of quantiles u (n, proposals) in occupied
// voxels (unisim_propose), the distances there, and places of quantiles near the surfaces that they show (unisim_refine),
// by jitter (n, count). Rays are in the volume's coordinates. In the intervals box_near to box_far (boxes) of rays
// box_ray (boxes), which rise, nothing but the ground is there. t (n, count), of rays with a mass (n) above 0.
extern "C" int UNISIM_NAME(unisim_place_static)(const unisim_scene *scene, const float *origins,
                                                const float *directions, const float *t_near, const float *t_far,
                                                int64_t n, const int64_t *box_ray, const float *box_near,
                                                const float *box_far, int64_t boxes, const float *u, int proposals,
                                                float uniform, const float *jitter, int count, float *t, float *mass,
                                                int threads) {
    constexpr int RAYS = 32;
    const Field field(scene->static_field);
    const float step = scene->voxel_m / 2, lower[3] = {},
                per_size[3] = {1 / scene->size[0], 1 / scene->size[1], 1 / scene->size[2]};
    const size_t k = static_cast<size_t>(proposals);
    struct Memory {
        StepFinder finder;
        Refiner refiner;
        FieldAlong along;
        OccupiedSteps occupied[RAYS];
        int64_t rays[RAYS];
        std::vector<float> at, s, quantiles;
    };
    const auto place = [&](Memory &m, int64_t begin, int64_t end) {
        auto &[finder, refiner, along, occupied, rays, at, s, quantiles] = m;
        size_t hit = 0;
        for (int64_t r = begin; r < end; ++r) {
            const float span = t_far[r] - t_near[r];
            OccupiedSteps &steps = occupied[hit];
            finder.find({origins + r * 3, directions + r * 3, scene->voxels, scene->voxel_shape, lower,
                         1.0f / scene->voxel_m, t_near[r], step},
                        span, scene->decay_per_m, steps);
            mass[r] = steps.total();
            if (!(mass[r] > 0)) continue;
            place_quantiles(steps, step, t_near[r], u + r * proposals, proposals, 1, &at[hit * k]);
            rays[hit++] = r;
        }
        along.evaluate(hit, k, at.data(), s.data(), [&](size_t i, float t_at, float *x) {
            const float *o = origins + rays[i] * 3, *d = directions + rays[i] * 3;
            for (int a = 0; a < 3; ++a) x[a] = (o[a] + t_at * d[a]) * per_size[a];
        });
        int64_t box = std::lower_bound(box_ray, box_ray + boxes, begin) - box_ray;
        for (size_t i = 0; i < hit; ++i) {
            const int64_t r = rays[i];
            const float *o = origins + r * 3, *d = directions + r * 3, *places = &at[i * k];
            while (box < boxes && box_ray[box] < r) ++box;
            for (int64_t b = box; b < boxes && box_ray[b] == r; ++b)
                for (size_t j = 0; j < k; ++j) {
                    if (!(places[j] >= box_near[b] && places[j] <= box_far[b])) continue;
                    const float x = o[0] + places[j] * d[0], y = o[1] + places[j] * d[1];
                    const float height = o[2] + places[j] * d[2] - ground_at(*scene, x, y);
                    if (height > scene->ground_clearance_m) s[i * k + j] = max_of(s[i * k + j], height);
                }
            refiner.refine(u + r * proposals, places, &s[i * k], jitter + r * count, count, quantiles.data());
            place_quantiles(occupied[i], step, t_near[r], quantiles.data(), count, 1, t + r * count);
        }
    };
    parallel_bodies(n, RAYS, threads, [&] {
        return [&, m = std::make_unique<Memory>(Memory{{}, {proposals, scene->beta, uniform}, FieldAlong(field), {}, {},
                                                       std::vector<float>(RAYS * k), std::vector<float>(RAYS * k),
                                                       std::vector<float>(static_cast<size_t>(count))})](
                   int64_t begin, int64_t end) { place(*m, begin, end); };
    });
    return 0;
}

// Places behind the volume, as fractions (n, count) of disparity from t0 (n) on, at which training queries the background
// model, and the widths (n, count) of the intervals around them: by its densities at the fractions u (n, proposals). `within`
// (n, count) are quantiles, one in each of `count` equal parts of 0..1.
extern "C" int UNISIM_NAME(unisim_place_background)(const unisim_scene *scene, const float *origins,
                                                    const float *directions, const float *t0, int64_t n,
                                                    const float *u, int proposals, const float *within, int count,
                                                    float *place, float *width, int threads) {
    constexpr int RAYS = 64;
    const Field field(scene->background);
    const size_t k = static_cast<size_t>(proposals), c = static_cast<size_t>(count);
    parallel_blocks(n, RAYS, threads, [&](int64_t begin, int64_t end) {
        const size_t rays = static_cast<size_t>(end - begin), first = static_cast<size_t>(begin);
        std::vector<float> at(rays * k), density(at.size()), cdf(k + 1), edges(c + 1);
        for (size_t i = 0; i < rays; ++i)
            for (size_t j = 0; j < k; ++j) {
                const float part = u[(first + i) * k + j];
                at[i * k + j] = 1 / ((1 - part) / t0[first + i] + part / scene->background_far_m);
            }
        FieldAlong(field).evaluate(rays, k, at.data(), density.data(), [&](size_t i, float t, float *x) {
            const float *o = origins + (first + i) * 3, *d = directions + (first + i) * 3;
            float y[3];
            for (int a = 0; a < 3; ++a) y[a] = o[a] + t * d[a];
            contract(*scene, y, x);
        });
        for (size_t i = 0; i < rays * k; ++i) density[i] = exp_of(min_of(density[i], MAX_LOG_DENSITY));
        for (size_t i = 0; i < rays; ++i) {
            find_background_edges(&density[i * k], proposals, count, cdf.data(), edges.data());
            const size_t row = (first + i) * c;
            for (size_t j = 0; j < c; ++j) {
                width[row + j] = edges[j + 1] - edges[j];
                const float inside = within[row + j] * static_cast<float>(count) - static_cast<float>(j);
                place[row + j] = edges[j] + inside * width[row + j];
            }
        }
    });
    return 0;
}
