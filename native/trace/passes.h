// What is written of a tile: features, opacities and mean distances, and the passes that were asked for.
#pragma once
#include "beyond.h"

namespace {

constexpr float NORMAL_STEP_M = 0.03f;

class Passes {
  public:
    Passes(Tile &tile, const Sums &sums, const Beyond &beyond) : tile_(tile), sums_(sums), beyond_(beyond) {}

    void write() {
        const unisim_found &found = tile_.task.found;
        const int width = tile_.task.fields[0].fixed.outputs - 1;
        for (int r = 0; r < tile_.rays.count; ++r) {
            const int64_t i = tile_.number[r];
            const float opacity = 1 - sums_.behind[r], in_front = beyond_.in_front[r];
            const float mean = sums_.stopped[r] / std::fmax(sums_.total[r], 1e-6f) * (1 - in_front) + in_front * beyond_.depth[r];
            std::copy_n(&sums_.feature[static_cast<size_t>(r) * width], width, found.feature + i * width);
            if (found.own_feature) std::copy_n(&sums_.own_feature[static_cast<size_t>(r) * width], width, found.own_feature + i * width);
            found.opacity[i] = opacity;
            found.depth[i] = mean / std::fmax(opacity, 1e-6f);
        }
        if (found.median) find_medians();
        if (found.instance) find_instances();
        if (found.normal) find_normals();
    }

  private:
    // Median distances; `core/render/tracers/torch/median.py`.
    void find_medians() {
        for (int r = 0; r < tile_.rays.count; ++r) {
            const float wanted = (1 + sums_.behind[r]) / 2;
            float depth = 0;
            for (const Strand &s : tile_.strands[r]) {
                const Batch &b = *s.batch;
                const unisim_scene &scene = *tile_.fields_of(b).scene;
                for (int k = 0; k < b.samples; ++k) {
                    const size_t i = static_cast<size_t>(k * b.stride + s.p);
                    if (b.front[i] > wanted && b.front[i] * std::exp(-b.tau[i]) <= wanted)
                        depth = b.medium == Medium::mesh ? b.t[i] : place_of(b, s.p, k, wanted, scene.beta, scene.paper_density != 0);
                }
            }
            tile_.task.found.median[tile_.number[r]] = depth;
        }
        for (size_t i = 0; i < beyond_.rays.size(); ++i) {
            const int r = beyond_.rays[i];
            const float wanted = (1 + sums_.behind[r]) / 2;
            float front = beyond_.in_front[r];
            for (size_t k = i * beyond_.count; k < (i + 1) * beyond_.count; ++k) {
                const float after = front * std::exp(-beyond_.tau[k]);
                if (front > wanted && after <= wanted) tile_.task.found.median[tile_.number[r]] = beyond_.t[k];
                front = after;
            }
        }
    }

    // 1 + the number of the actor with the largest weight on a ray, 0 where the rest outweighs it.
    void find_instances() {
        for (int r = 0; r < tile_.rays.count; ++r) {
            float best = 0, rest = sums_.behind[r];
            int32_t number = 0;
            for (const Strand &s : tile_.strands[r]) {
                const float weight = weight_of(*s.batch, s.p);
                if (s.batch->medium == Medium::fixed || s.batch->medium == Medium::copy)
                    rest += weight;
                else if (weight > best) {
                    best = weight;
                    number = tile_.task.first[static_cast<size_t>(s.batch->troupe)] + s.batch->box[s.p] + 1;
                }
            }
            tile_.task.found.instance[tile_.number[r]] = best > rest ? number : 0;
        }
    }

    // Unit normals: each strand's gradient of the distance at its heaviest sample, by differences on a tetrahedron, by weight.
    void find_normals() {
        constexpr float CORNER[4][3] = {{1, -1, -1}, {-1, -1, 1}, {-1, 1, -1}, {1, 1, 1}};
        std::vector<float> sum(3 * TILE, 0.0f);
        for (Batch &b : tile_.batches) {
            if (!b.count) continue;
            heavy_.clear();
            for (int p = 0; p < b.count; ++p)
                if (weight_of(b, p) > LEAST_WEIGHT) heavy_.push_back(p);
            if (b.medium == Medium::mesh) {
                // a mesh's strands have its normals for sizes
                for (const int p : heavy_)
                    for (int a = 0; a < 3; ++a) sum[3 * b.ray[p] + a] += weight_of(b, p) * b.size[3 * p + a];
                continue;
            }
            const Field &field = tile_.field_of(b);
            const unisim_troupe *troupe = b.medium == Medium::actor ? &tile_.task.cast.troupes[b.troupe] : nullptr;
            constexpr int PLACES = BLOCK / 4;
            for (size_t first = 0; first < heavy_.size(); first += PLACES) {
                const int n = static_cast<int>(std::min<size_t>(PLACES, heavy_.size() - first));
                for (int i = 0; i < filled(4 * n); ++i) {
                    const int p = heavy_[first + std::min(i / 4, n - 1)];
                    const float t = b.t[static_cast<size_t>(heaviest(b, p) * b.stride + p)];
                    for (int a = 0; a < 3; ++a)
                        tile_.x[a][i] =
                            (b.o[3 * p + a] + t * b.d[3 * p + a] + NORMAL_STEP_M * CORNER[i % 4][a]) / b.size[3 * p + a] + (troupe ? 0.5f : 0.0f);
                    tile_.row[i] = troupe ? troupe->rows[b.box[p]] : 0;
                }
                field.units(tile_.x, troupe ? tile_.row : nullptr, 4 * n, tile_.code.data(), tile_.block.data());
                tile_.samples += 4 * n;
                for (int i = 0; i < n; ++i) {
                    const int p = heavy_[first + i];
                    float gradient[3] = {}, world[3] = {}, length = 0;
                    for (int c = 0; c < 4; ++c) {
                        const float value = field.first_output(&tile_.block[static_cast<size_t>((4 * i + c) * field.wide)]);
                        for (int a = 0; a < 3; ++a) gradient[a] += value * CORNER[c][a];
                    }
                    turn_normal(b, p, gradient, world);
                    for (const float x : world) length += x * x;
                    length = std::fmax(std::sqrt(length), 1e-12f);
                    for (int a = 0; a < 3; ++a) sum[3 * b.ray[p] + a] += weight_of(b, p) * world[a] / length;
                }
            }
        }
        for (int r = 0; r < tile_.rays.count; ++r) {
            const float *v = &sum[3 * r];
            const float length = std::fmax(std::sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]), 1e-12f);
            for (int a = 0; a < 3; ++a) tile_.task.found.normal[3 * tile_.number[r] + a] = 1 - sums_.behind[r] > 0.5f ? v[a] / length : 0.0f;
        }
    }

    // A gradient in a strand's own axes along the world's.
    void turn_normal(const Batch &b, int p, const float *g, float *world) const {
        const double *m = tile_.scene.volume_from_world;
        float local[3] = {g[0], g[1], g[2]};
        if (b.medium != Medium::actor)
            for (int a = 0; a < 3; ++a) local[a] = static_cast<float>(m[a] * g[0] + m[4 + a] * g[1] + m[8 + a] * g[2]);
        if (b.medium == Medium::fixed) {
            std::copy_n(local, 3, world);
            return;
        }
        const float *rotation = &b.rotation[static_cast<size_t>(9 * p)];
        for (int a = 0; a < 3; ++a) world[a] = rotation[3 * a] * local[0] + rotation[3 * a + 1] * local[1] + rotation[3 * a + 2] * local[2];
    }

    Tile &tile_;
    const Sums &sums_;
    const Beyond &beyond_;
    std::vector<int> heavy_;
};

} // namespace
