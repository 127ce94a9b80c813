// Writes the results of a tile: features, opacities, mean distances, and the passes that the caller wants.
#pragma once
#include "background.h"

namespace {

constexpr float NORMAL_STEP_M = 0.03f;

class Passes {
  public:
    Passes(Tile &tile, const RaySums &sums, const Background &background)
        : tile_(tile), sums_(sums), background_(background) {}

    void write() {
        const unisim_trace_result &result = tile_.task.result;
        const int width = tile_.task.fields[0].static_field.outputs - 1;
        for (int r = 0; r < tile_.rays.count; ++r) {
            const int64_t i = tile_.number[r];
            const float opacity = 1 - sums_.transmittance[r], before = background_.transmittance_before[r];
            const float inside = sums_.weighted_t[r] / std::fmax(sums_.weight[r], 1e-6f);
            const float mean = inside * (1 - before) + before * background_.weighted_t[r];
            std::copy_n(&sums_.feature[static_cast<size_t>(r) * width], width, result.feature + i * width);
            if (result.feature_without_foreign)
                std::copy_n(&sums_.feature_without_foreign[static_cast<size_t>(r) * width], width,
                            result.feature_without_foreign + i * width);
            result.opacity[i] = opacity;
            result.depth[i] = mean / std::fmax(opacity, 1e-6f);
        }
        if (result.median) find_medians();
        if (result.instance) find_instances();
        if (result.normal) find_normals();
    }

  private:
    // Median distances; `core/render/tracers/torch/ray_passes.py`.
    void find_medians() {
        float depth[TILE] = {}, last[TILE] = {}, least[TILE];
        std::fill_n(least, TILE, 2.0f);
        tile_.each([&](const auto &b) {
            for (int p = 0; p < b.count; ++p) {
                const int r = b.ray[p];
                const float wanted = (1 + sums_.transmittance[r]) / 2;
                for (int k = 0; k < b.samples; ++k) {
                    const size_t i = b.number(k, p);
                    const float before = b.transmittance_before[i];
                    if (!(before > wanted)) continue;
                    if (before * exp_of(-b.tau[i]) <= wanted) depth[r] = crossing(b, p, k, wanted);
                    if (before > least[r] || (before == least[r] && b.t[i] < last[r])) continue;
                    least[r] = before;
                    last[r] = b.t[i];
                }
            }
        });
        // between two intervals the transmittance may fall to `wanted` by rounding alone: the crossing is their border
        for (int r = 0; r < tile_.rays.count; ++r)
            tile_.task.result.median[tile_.number[r]] = depth[r] > 0 ? depth[r] : last[r];
        for (size_t i = 0; i < background_.rays.size(); ++i) {
            const int r = background_.rays[i];
            const float wanted = (1 + sums_.transmittance[r]) / 2;
            float before = background_.transmittance_before[r];
            for (size_t k = i * background_.count; k < (i + 1) * background_.count; ++k) {
                const float after = before * std::exp(-background_.tau[k]);
                if (before > wanted && after <= wanted) tile_.task.result.median[tile_.number[r]] = background_.t[k];
                before = after;
            }
        }
    }

    // Where in interval k of segment p the transmittance falls to `wanted`.
    static float crossing(const MeshSegments &b, int p, int k, float) { return b.t[b.number(k, p)]; }
    template <class Segments> float crossing(const Segments &b, int p, int k, float wanted) const {
        const unisim_scene &scene = *tile_.scene_fields_of(b).scene;
        return crossing_of(b, p, k, wanted, scene.beta, scene.unisim_density != 0);
    }

    // 1 + the number of the actor with the largest weight on a ray, 0 where everything else has more.
    void find_instances() {
        float best[TILE] = {}, rest[TILE];
        int32_t number[TILE] = {};
        std::copy_n(sums_.transmittance, tile_.rays.count, rest);
        tile_.each([&](const auto &b) {
            for (int p = 0; p < b.count; ++p) {
                const int r = b.ray[p];
                const float weight = weight_of(b, p);
                const int32_t instance = instance_of(b, p);
                if (!instance)
                    rest[r] += weight;
                else if (weight > best[r]) {
                    best[r] = weight;
                    number[r] = instance;
                }
            }
        });
        for (int r = 0; r < tile_.rays.count; ++r)
            tile_.task.result.instance[tile_.number[r]] = best[r] > rest[r] ? number[r] : 0;
    }

    // 1 + the number of a segment's actor, 0 for static space.
    static int32_t instance_of(const FieldSegments &, int) { return 0; }
    int32_t instance_of(const ActorSegments &b, int p) const {
        return tile_.task.first_instance[static_cast<size_t>(b.set)] + b.box[p] + 1;
    }
    int32_t instance_of(const MeshSegments &b, int p) const {
        return tile_.task.first_instance.back() + b.actor[p] + 1;
    }

    // Unit normals: the sum over a ray's segments, by weight, of their unit normals.
    void find_normals() {
        float sum[TILE][3] = {};
        tile_.each([&](const auto &b) {
            heavy_.clear();
            for (int p = 0; p < b.count; ++p)
                if (weight_of(b, p) > MIN_WEIGHT) heavy_.push_back(p);
            add_normals(b, sum);
        });
        for (int r = 0; r < tile_.rays.count; ++r) {
            const float *v = sum[r];
            const float length = std::fmax(std::sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]), 1e-12f);
            const bool solid = 1 - sums_.transmittance[r] > 0.5f;
            for (int a = 0; a < 3; ++a)
                tile_.task.result.normal[3 * tile_.number[r] + a] = solid ? v[a] / length : 0.0f;
        }
    }

    void add_normals(const MeshSegments &b, float (*sum)[3]) {
        for (const int p : heavy_)
            for (int a = 0; a < 3; ++a) sum[b.ray[p]][a] += weight_of(b, p) * b.normal[static_cast<size_t>(3 * p + a)];
    }

    // The normal of a segment inside a field is the gradient of the distance at its heaviest sample, by differences
    // on a tetrahedron.
    template <class Segments> void add_normals(const Segments &b, float (*sum)[3]) {
        constexpr float CORNER[4][3] = {{1, -1, -1}, {-1, -1, 1}, {-1, 1, -1}, {1, 1, 1}};
        constexpr int PLACES = BLOCK / 4;
        const Field &field = tile_.field_of(b);
        for (size_t first = 0; first < heavy_.size(); first += PLACES) {
            const int n = static_cast<int>(std::min<size_t>(PLACES, heavy_.size() - first));
            for (int i = 0; i < filled(4 * n); ++i) {
                const int p = heavy_[first + std::min(i / 4, n - 1)];
                const float t = b.t[b.number(heaviest_sample(b, p), p)];
                for (int a = 0; a < 3; ++a)
                    tile_.x[a][i] = (b.o[3 * p + a] + t * b.d[3 * p + a] + NORMAL_STEP_M * CORNER[i % 4][a]) /
                                        tile_.size_of(b, static_cast<size_t>(p))[a] +
                                    Tile::offset_of(b);
                tile_.row[i] = Tile::row_of(b, static_cast<size_t>(p));
            }
            field.units(tile_.x, tile_.rows_of(b), 4 * n, tile_.code.data(), tile_.block.data());
            tile_.samples += 4 * n;
            for (int i = 0; i < n; ++i) {
                const int p = heavy_[first + i];
                float gradient[3] = {}, world[3] = {}, length = 0;
                for (int c = 0; c < 4; ++c) {
                    const float value = field.first_output(&tile_.block[static_cast<size_t>((4 * i + c) * field.wide)]);
                    for (int a = 0; a < 3; ++a) gradient[a] += value * CORNER[c][a];
                }
                turn_to_world(b, p, gradient, world);
                for (const float x : world) length += x * x;
                length = std::fmax(std::sqrt(length), 1e-12f);
                for (int a = 0; a < 3; ++a) sum[b.ray[p]][a] += weight_of(b, p) * world[a] / length;
            }
        }
    }

    // A gradient g in the axes of a segment's field, along the world's axes.
    void turn_to_world(const StaticSegments &, int, const float *g, float *world) const {
        turn_volume_to_world(g, world);
    }
    void turn_to_world(const CopySegments &b, int p, const float *g, float *world) const {
        float at_source[3];
        turn_volume_to_world(g, at_source);
        rotate(&b.rotation[static_cast<size_t>(9 * p)], at_source, world);
    }
    void turn_to_world(const ActorSegments &b, int p, const float *g, float *world) const {
        rotate(&b.rotation[static_cast<size_t>(9 * p)], g, world);
    }

    void turn_volume_to_world(const float *g, float *world) const {
        const double *m = tile_.scene.volume_from_world;
        for (int a = 0; a < 3; ++a) world[a] = static_cast<float>(m[a] * g[0] + m[4 + a] * g[1] + m[8 + a] * g[2]);
    }

    static void rotate(const float *rotation, const float *g, float *out) {
        for (int a = 0; a < 3; ++a)
            out[a] = rotation[3 * a] * g[0] + rotation[3 * a + 1] * g[1] + rotation[3 * a + 2] * g[2];
    }

    Tile &tile_;
    const RaySums &sums_;
    const Background &background_;
    std::vector<int> heavy_; // of the segments at hand, those of at least MIN_WEIGHT
};

} // namespace
