// The light on actors: how the ground around their places changes their features. `core/model/scene.py` is the
// specification.
#pragma once
#include "tile.h"

namespace {

class Light {
  public:
    std::vector<float> scales; // (segments, 2, features): scales and shifts of actors' features

    explicit Light(Tile &tile) : tile_(tile) {}

    // Evaluates the light of segments with weights (segments), into `scales`.
    void evaluate(const ActorSegments &b, const std::vector<float> &weight) {
        const SceneFields &fields = tile_.scene_fields_of(b);
        const unisim_scene &scene = *fields.scene;
        const Field &field = fields.static_field;
        const unisim_mlp &net = *scene.light;
        const int features = field.outputs - 1;
        scales.assign(static_cast<size_t>(b.count) * 2 * features, 0.0f);
        heavy_.clear();
        for (int p = 0; p < b.count; ++p)
            if (weight[p] > MIN_WEIGHT) heavy_.push_back(p);
        constexpr int PLACES = BLOCK / 4;
        const std::vector<float> &first_layer = fields.light_first, &last_layer = fields.light_last;
        const int wide = padded(net.hidden), wide_out = padded(2 * features);
        units_.resize(static_cast<size_t>(PLACES) * std::max(field.wide, wide));
        appearance_.resize(static_cast<size_t>(PLACES) * std::max(field.wide_out, wide_out));
        for (size_t first = 0; first < heavy_.size(); first += PLACES) {
            const int n = static_cast<int>(std::min<size_t>(PLACES, heavy_.size() - first));
            for (int i = 0; i < filled(4 * n); ++i) {
                const int p = heavy_[first + std::min(i / 4, n - 1)], r = b.ray[p];
                const int k = median_sample(b, p);
                const float t = b.t[b.number(k, p)];
                // an actor of a foreign scene has the light of the place where it was recorded
                const float *home = scene.light_home + 3 * Tile::row_of(b, static_cast<size_t>(p));
                const float reach = i & 1 ? -scene.light_reach_m : scene.light_reach_m;
                float place[3];
                for (int a = 0; a < 3; ++a) place[a] = b.foreign ? home[a] : tile_.o[r][a] + t * tile_.d[r][a];
                place[i & 2 ? 1 : 0] += reach;
                place[2] = ground_at(scene, place[0], place[1]);
                for (int a = 0; a < 3; ++a) tile_.x[a][i] = place[a] / scene.size[a];
            }
            field.units(tile_.x, nullptr, 4 * n, tile_.code.data(), tile_.block.data());
            tile_.samples += 4 * n;
            // features are linear in the hidden units: the mean of four places is taken of the units
            float *mean = units_.data();
            for (int i = 0; i < n; ++i)
                for (int j = 0; j < field.wide; j += LANES) {
                    const float *h = &tile_.block[static_cast<size_t>(4 * i * field.wide + j)];
                    store(mean + i * field.wide + j,
                          (load(h) + load(h + field.wide) + load(h + 2 * field.wide) + load(h + 3 * field.wide)) *
                              0.25f);
                }
            layer<false>(PLACES, field.wide_out, field.hidden, mean, field.wide, field.feature.data(),
                         appearance_.data());
            for (int i = 0; i < n; ++i)
                for (int f = 0; f < features; ++f)
                    appearance_[static_cast<size_t>(i * field.wide_out + f)] += field.bias[static_cast<size_t>(f + 1)];
            layer<true>(PLACES, wide, features, appearance_.data(), field.wide_out, first_layer.data(), units_.data());
            layer<false>(PLACES, wide_out, net.hidden, units_.data(), wide, last_layer.data(), appearance_.data());
            for (int i = 0; i < n; ++i) {
                float *out = &scales[static_cast<size_t>(2 * heavy_[first + i] * features)];
                for (int f = 0; f < 2 * features; ++f)
                    out[f] = appearance_[static_cast<size_t>(i * wide_out + f)] + net.bias[f];
            }
        }
    }

  private:
    // The sample by which a segment, alone on its ray, has absorbed half of what it absorbs.
    static int median_sample(const ActorSegments &b, int p) {
        float all = 0, depth = 0;
        for (int k = 0; k < b.samples; ++k) all += b.tau[b.number(k, p)];
        const float half = -0.5f * std::expm1(-all);
        for (int k = 0; k + 1 < b.samples; ++k) {
            depth += b.tau[b.number(k, p)];
            if (-std::expm1(-depth) >= half) return k;
        }
        return b.samples - 1;
    }

    Tile &tile_;
    std::vector<int> heavy_; // segments of at least MIN_WEIGHT
    std::vector<float> units_, appearance_;
};

} // namespace
