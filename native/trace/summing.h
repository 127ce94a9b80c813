// Everything on a ray in depth order, and what its strands give to it, by weight.
#pragma once
#include "directed.h"
#include "light.h"

namespace {

// What rays have so far.
struct Sums {
    float behind[TILE], behind_own[TILE];    // of a ray what comes through everything, and through everything but guests
    float total[TILE], stopped[TILE];        // its samples' weights, and their distances by weight
    std::vector<float> feature, own_feature; // (TILE, features) of all but guests: with these in front, and as if there were none
};

class Summing {
  public:
    Sums sums;

    explicit Summing(Tile &tile) : tile_(tile), light_(tile), directed_(tile) {}

    void composite() {
        for (int r = 0; r < tile_.rays.count; ++r) {
            tile_.strands[r].clear();
            guests_[r] = false;
            sums.behind[r] = sums.behind_own[r] = 1;
        }
        for (Batch &b : tile_.batches) {
            if (!b.count) continue;
            find_fronts(b);
            for (int p = 0; p < b.count; ++p) {
                tile_.strands[b.ray[p]].push_back({&b, p});
                guests_[b.ray[p]] |= tile_.guest(b);
            }
        }
        const bool apart = tile_.task.found.own_feature != nullptr;
        bool some = false;
        for (int r = 0; r < tile_.rays.count; ++r) {
            std::vector<Strand> &all = tile_.strands[r];
            if (all.empty()) continue;
            if (guests_[r] && apart) {
                own_.clear();
                for (const Strand &s : all)
                    if (!tile_.guest(*s.batch)) own_.push_back(s);
                sums.behind_own[r] = own_.empty() ? 1.0f : std::exp(-merge_fronts(own_, next_, stops_));
                some = true;
                continue;
            }
            const Batch &b = *all[0].batch;
            float depth = 0;
            if (all.size() > 1)
                depth = merge_fronts(all, next_, stops_);
            else
                for (int k = 0; k < b.samples; ++k) depth += b.tau[static_cast<size_t>(k * b.stride + all[0].p)];
            sums.behind[r] = sums.behind_own[r] = std::exp(-depth);
        }
        clear_sums();
        for (Batch &b : tile_.batches)
            if (b.count) find_weights(b);
        // what the scene's own decoder is to see: everything but the guests
        if (apart) sum_features(true);
        if (some) {
            for (int r = 0; r < tile_.rays.count; ++r)
                if (guests_[r]) sums.behind[r] = std::exp(-merge_fronts(tile_.strands[r], next_, stops_));
            for (Batch &b : tile_.batches)
                if (b.count) find_weights(b);
        }
        sum_features(false);
    }

  private:
    void clear_sums() {
        const unisim_found &found = tile_.task.found;
        const size_t width = static_cast<size_t>(tile_.task.fields[0].fixed.outputs - 1);
        sums.feature.assign(TILE * width, 0.0f);
        sums.own_feature.assign(TILE * width, 0.0f);
        for (int r = 0; r < TILE; ++r) sums.total[r] = sums.stopped[r] = 0;
        for (int i = 0; i < tile_.task.cast.troupe_count - 1; ++i) {
            const int wide = tile_.task.fields[static_cast<size_t>(i + 1)].fixed.outputs - 1;
            for (int r = 0; r < tile_.rays.count; ++r) {
                std::fill_n(found.guest_feature[i] + tile_.number[r] * wide, wide, 0.0f);
                found.guest_opacity[i][tile_.number[r]] = 0;
            }
        }
        if (found.mesh_opacity)
            for (int r = 0; r < tile_.rays.count; ++r) found.mesh_opacity[tile_.number[r]] = 0;
    }

    // Sums of what strands give to their rays. `own`: as if there were no guests, and features alone.
    void sum_features(bool own) {
        const unisim_found &found = tile_.task.found;
        const int width = tile_.task.fields[0].fixed.outputs - 1;
        for (Batch &b : tile_.batches) {
            if (!b.count || (own && tile_.guest(b))) continue;
            strand_weight_.assign(static_cast<size_t>(b.count), 0.0f);
            for (int k = 0; k < b.samples; ++k)
                for (int p = 0; p < b.count; ++p) strand_weight_[p] += b.weight[static_cast<size_t>(k * b.stride + p)];
            if (b.medium == Medium::mesh) {
                for (int p = 0; p < b.count; ++p) {
                    found.mesh_opacity[tile_.number[b.ray[p]]] += strand_weight_[p];
                    add_depth(b, p);
                }
                continue;
            }
            project(b);
            const int wide_out = tile_.field_of(b).wide_out;
            for (int p = 0; p < b.count; ++p) {
                const int r = b.ray[p];
                if (!own) add_depth(b, p);
                const float *feature = &projected_[static_cast<size_t>(p) * wide_out];
                if (!own && tile_.guest(b)) {
                    const int i = b.troupe - 1, wide = tile_.field_of(b).outputs - 1;
                    float *out = found.guest_feature[i] + tile_.number[r] * wide;
                    for (int f = 0; f < wide; ++f) out[f] += feature[f];
                    found.guest_opacity[i][tile_.number[r]] += strand_weight_[p];
                } else {
                    float *out = (own ? sums.own_feature.data() : sums.feature.data()) + static_cast<int64_t>(r) * width;
                    for (int f = 0; f < width; ++f) out[f] += feature[f];
                }
            }
        }
    }

    void add_depth(const Batch &b, int p) {
        const int r = b.ray[p];
        sums.total[r] += strand_weight_[p];
        for (int k = 0; k < b.samples; ++k) {
            const size_t i = static_cast<size_t>(k * b.stride + p);
            sums.stopped[r] += b.weight[i] * b.t[i];
        }
    }

    // projected_ (count, wide_out): the strands' features, by weight, as the light has them.
    void project(Batch &b) {
        const Field &field = tile_.field_of(b);
        const bool lit = b.medium == Medium::actor && tile_.task.sampling.sky && tile_.fields_of(b).scene->light;
        if (lit) light_.find(b, strand_weight_);
        if (const unisim_head *head = tile_.fields_of(b).scene->sample_head) return project_directed(b, *head, lit);
        const int rows = (b.count + ROWS - 1) / ROWS * ROWS;
        summed_.assign(static_cast<size_t>(rows) * field.wide, 0.0f);
        for (int p = 0; p < b.count; ++p) {
            float *sum = &summed_[static_cast<size_t>(p) * field.wide];
            for (int k = 0; k < b.samples; ++k) {
                const size_t i = static_cast<size_t>(k * b.stride + p);
                if (b.slot[i] < 0 || b.weight[i] <= NO_WEIGHT) continue;
                const float *h = &b.units[static_cast<size_t>(b.slot[i]) * field.wide];
                const lanes w = spread(b.weight[i]);
                for (int j = 0; j < field.wide; j += LANES) store(sum + j, load(sum + j) + w * load(h + j));
            }
        }
        projected_.resize(static_cast<size_t>(rows) * field.wide_out);
        layer<false>(rows, field.wide_out, field.hidden, summed_.data(), field.wide, field.feature.data(), projected_.data());
        for (int p = 0; p < b.count; ++p) {
            float *out = &projected_[static_cast<size_t>(p * field.wide_out)];
            for (int f = 0; f + 1 < field.outputs; ++f) out[f] += strand_weight_[p] * field.bias[static_cast<size_t>(f + 1)];
            if (!lit) continue;
            const float *scale = &light_.scales[static_cast<size_t>(2 * p * (field.outputs - 1))], *shift = scale + field.outputs - 1;
            for (int f = 0; f + 1 < field.outputs; ++f) out[f] = out[f] * (1 + scale[f]) + shift[f] * strand_weight_[p];
        }
    }

    // The same where the direction enters at every sample.
    void project_directed(Batch &b, const unisim_head &head, bool lit) {
        const Field &field = tile_.field_of(b);
        const int features = field.outputs - 1;
        projected_.assign(static_cast<size_t>(b.count) * field.wide_out, 0.0f);
        directed_.begin();
        for (int i = 0; i < b.samples * b.stride; ++i) {
            const int slot = b.slot[static_cast<size_t>(i)], p = i % b.stride;
            const float weight = b.weight[static_cast<size_t>(i)];
            if (slot < 0 || !(weight > LEAST_WEIGHT)) continue;
            const float *scale = lit ? &light_.scales[static_cast<size_t>(2 * p * features)] : nullptr;
            directed_.add(field, &b.units[static_cast<size_t>(slot) * field.wide], b.ray[p], scale, weight, static_cast<size_t>(p));
        }
        directed_.sum(head, field, projected_.data());
    }

    Tile &tile_;
    Light light_;
    Directed directed_;
    bool guests_[TILE];
    std::vector<Strand> own_;
    std::vector<int> next_;
    std::vector<float> stops_, strand_weight_, summed_, projected_;
};

} // namespace
