// Composites the segments of each ray in depth order: transmittances, weights, and sums of features and distances by
// weight.
#pragma once
#include "light.h"
#include "view_dependence.h"

namespace {

// Sums along each ray of the tile.
struct RaySums {
    // after all segments, and after all but foreign ones
    float transmittance[TILE], transmittance_without_foreign[TILE];
    // of the samples: weight, and weight times distance
    float weight[TILE], weighted_t[TILE];
    // (TILE, features) of all segments that are not foreign: with the weights that foreign ones leave, and without.
    std::vector<float> feature, feature_without_foreign;
};

class Compositor {
  public:
    RaySums sums;

    explicit Compositor(Tile &tile) : tile_(tile), light_(tile), view_dependent_(tile) {}

    void composite() {
        for (int r = 0; r < tile_.rays.count; ++r) {
            tile_.segments[r].clear();
            has_foreign_[r] = false;
            sums.transmittance[r] = sums.transmittance_without_foreign[r] = 1;
        }
        tile_.each([&](auto &b) {
            find_transmittances_alone(b);
            for (int p = 0; p < b.count; ++p) {
                // what absorbs less than float32 resolves changes nothing behind it
                if (b.total_depth[static_cast<size_t>(p)] < 1e-8f) continue;
                tile_.segments[b.ray[p]].push_back({&b, p});
                has_foreign_[b.ray[p]] |= b.foreign;
            }
        });
        const bool separate = tile_.task.result.feature_without_foreign != nullptr;
        bool any_foreign = false;
        for (int r = 0; r < tile_.rays.count; ++r) {
            const std::vector<SegmentRef> &all = tile_.segments[r];
            if (all.empty()) continue;
            if (has_foreign_[r] && separate) {
                own_.clear();
                for (const SegmentRef &s : all)
                    if (!s.segments->foreign) own_.push_back(s);
                sums.transmittance_without_foreign[r] =
                    own_.empty() ? 1.0f : std::exp(-merge_by_depth(own_, next_, stops_));
                any_foreign = true;
                continue;
            }
            const float depth = all.size() > 1 ? merge_by_depth(all, next_, stops_)
                                               : all[0].segments->total_depth[static_cast<size_t>(all[0].p)];
            sums.transmittance[r] = sums.transmittance_without_foreign[r] = std::exp(-depth);
        }
        clear_sums();
        tile_.each([](auto &b) { find_weights(b); });
        // what the scene's own decoder sees: everything but foreign segments
        if (separate)
            tile_.each([&](auto &b) {
                if (!b.foreign) add_without_foreign(b);
            });
        if (any_foreign) {
            for (int r = 0; r < tile_.rays.count; ++r)
                if (has_foreign_[r])
                    sums.transmittance[r] = std::exp(-merge_by_depth(tile_.segments[r], next_, stops_));
            tile_.each([](auto &b) { find_weights(b); });
        }
        tile_.each([&](auto &b) { add(b); });
    }

  private:
    void clear_sums() {
        const unisim_trace_result &result = tile_.task.result;
        const size_t width = static_cast<size_t>(tile_.task.fields[0].static_field.outputs - 1);
        sums.feature.assign(TILE * width, 0.0f);
        sums.feature_without_foreign.assign(TILE * width, 0.0f);
        for (int r = 0; r < TILE; ++r) sums.weight[r] = sums.weighted_t[r] = 0;
        for (int i = 0; i < tile_.task.active.actor_set_count - 1; ++i) {
            const int wide = tile_.task.fields[static_cast<size_t>(i + 1)].static_field.outputs - 1;
            for (int r = 0; r < tile_.rays.count; ++r) {
                std::fill_n(result.foreign_feature[i] + tile_.number[r] * wide, wide, 0.0f);
                result.foreign_opacity[i][tile_.number[r]] = 0;
            }
        }
        if (result.mesh_opacity)
            for (int r = 0; r < tile_.rays.count; ++r) result.mesh_opacity[tile_.number[r]] = 0;
    }

    // Adds the segments of one kind to their rays.
    void add(MeshSegments &b) {
        find_segment_weights(b);
        for (int p = 0; p < b.count; ++p) {
            tile_.task.result.mesh_opacity[tile_.number[b.ray[p]]] += segment_weight_[p];
            add_distance(b, p);
        }
    }

    template <class Segments> void add(Segments &b) {
        find_segment_weights(b);
        project(b);
        for (int p = 0; p < b.count; ++p) {
            add_distance(b, p);
            add_feature(b, p);
        }
    }

    // Adds the features of segments that are not foreign, with the weights that they have without foreign segments.
    template <class Segments> void add_without_foreign(Segments &b) {
        find_segment_weights(b);
        project(b);
        for (int p = 0; p < b.count; ++p) add_feature_to(sums.feature_without_foreign, b, p);
    }
    void add_without_foreign(MeshSegments &) {}

    void find_segment_weights(const Samples &b) {
        segment_weight_.assign(static_cast<size_t>(b.count), 0.0f);
        for (int k = 0; k < b.samples; ++k)
            for (int p = 0; p < b.count; ++p) segment_weight_[p] += b.weight[b.number(k, p)];
    }

    void add_distance(const Samples &b, int p) {
        const int r = b.ray[p];
        sums.weight[r] += segment_weight_[p];
        for (int k = 0; k < b.samples; ++k) sums.weighted_t[r] += b.weight[b.number(k, p)] * b.t[b.number(k, p)];
    }

    void add_feature(const FieldSegments &b, int p) { add_feature_to(sums.feature, b, p); }

    // Features of a foreign scene are decoded by that scene's decoder: they have sums of their own.
    void add_feature(const ActorSegments &b, int p) {
        if (!b.foreign) return add_feature_to(sums.feature, b, p);
        const Field &field = tile_.field_of(b);
        const int set = b.set - 1, wide = field.outputs - 1;
        const int64_t number = tile_.number[b.ray[p]];
        const float *feature = &projected_[static_cast<size_t>(p) * field.wide_out];
        float *out = tile_.task.result.foreign_feature[set] + number * wide;
        for (int f = 0; f < wide; ++f) out[f] += feature[f];
        tile_.task.result.foreign_opacity[set][number] += segment_weight_[p];
    }

    template <class Segments> void add_feature_to(std::vector<float> &to, const Segments &b, int p) {
        const int width = tile_.task.fields[0].static_field.outputs - 1;
        const float *feature = &projected_[static_cast<size_t>(p) * tile_.field_of(b).wide_out];
        float *out = to.data() + static_cast<int64_t>(b.ray[p]) * width;
        for (int f = 0; f < width; ++f) out[f] += feature[f];
    }

    // Evaluates the light of segments whose appearance it changes; returns whether it changes this kind.
    bool find_light(const FieldSegments &) { return false; }
    bool find_light(const ActorSegments &b) {
        if (!tile_.task.sampling.sky || !tile_.scene_fields_of(b).scene->light) return false;
        light_.evaluate(b, segment_weight_);
        return true;
    }

    // projected_ (count, wide_out): the segments' features, summed by weight, as the light changes them.
    template <class Segments> void project(Segments &b) {
        const Field &field = tile_.field_of(b);
        const bool lit = find_light(b);
        if (const unisim_head *head = tile_.scene_fields_of(b).scene->sample_head)
            return project_view_dependent(b, *head, lit);
        const int rows = (b.count + ROWS - 1) / ROWS * ROWS;
        summed_.assign(static_cast<size_t>(rows) * field.wide, 0.0f);
        for (int p = 0; p < b.count; ++p) {
            float *sum = &summed_[static_cast<size_t>(p) * field.wide];
            for (int k = 0; k < b.samples; ++k) {
                const size_t i = b.number(k, p);
                if (b.slot[i] < 0 || b.weight[i] <= NEGLIGIBLE_WEIGHT) continue;
                const float *h = &b.units[static_cast<size_t>(b.slot[i]) * field.wide];
                const simd_float w = broadcast(b.weight[i]);
                for (int j = 0; j < field.wide; j += LANES) store(sum + j, load(sum + j) + w * load(h + j));
            }
        }
        projected_.resize(static_cast<size_t>(rows) * field.wide_out);
        layer<false>(rows, field.wide_out, field.hidden, summed_.data(), field.wide, field.feature.data(),
                     projected_.data());
        for (int p = 0; p < b.count; ++p) {
            float *out = &projected_[static_cast<size_t>(p * field.wide_out)];
            for (int f = 0; f + 1 < field.outputs; ++f)
                out[f] += segment_weight_[p] * field.bias[static_cast<size_t>(f + 1)];
            if (!lit) continue;
            const float *scale = &light_.scales[static_cast<size_t>(2 * p * (field.outputs - 1))],
                        *shift = scale + field.outputs - 1;
            for (int f = 0; f + 1 < field.outputs; ++f)
                out[f] = out[f] * (1 + scale[f]) + shift[f] * segment_weight_[p];
        }
    }

    // The same for a scene whose head takes the view direction at every sample.
    template <class Segments> void project_view_dependent(const Segments &b, const unisim_head &head, bool lit) {
        const Field &field = tile_.field_of(b);
        const int features = field.outputs - 1;
        projected_.assign(static_cast<size_t>(b.count) * field.wide_out, 0.0f);
        view_dependent_.clear();
        for (int i = 0; i < b.samples * b.stride; ++i) {
            const int slot = b.slot[static_cast<size_t>(i)], p = i % b.stride;
            const float weight = b.weight[static_cast<size_t>(i)];
            if (slot < 0 || !(weight > MIN_WEIGHT)) continue;
            const float *scale = lit ? &light_.scales[static_cast<size_t>(2 * p * features)] : nullptr;
            view_dependent_.add(field, &b.units[static_cast<size_t>(slot) * field.wide], b.ray[p], scale, weight,
                                static_cast<size_t>(p));
        }
        view_dependent_.sum(head, field, projected_.data());
    }

    Tile &tile_;
    Light light_;
    ViewDependentFeatures view_dependent_;
    bool has_foreign_[TILE];
    std::vector<SegmentRef> own_;
    std::vector<int> next_;
    std::vector<float> stops_, segment_weight_, summed_, projected_;
};

} // namespace
