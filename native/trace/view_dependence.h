// Features of scenes without decoders, whose head takes the view direction at every sample: collected, then computed
// together.
#pragma once
#include "tile.h"

namespace {

class ViewDependentFeatures {
  public:
    explicit ViewDependentFeatures(const Tile &tile) : tile_(tile) {}

    void clear() {
        for (auto *v : {&inputs_, &directions_, &weights_}) v->clear();
        rows_.clear();
    }

    // Adds a sample with hidden units h on ray r, of a weight, to a row of sums. `light`: scales and shifts of its
    // features, or null.
    void add(const Field &field, const float *h, int r, const float *light, float weight, size_t row) {
        const int wide = field.outputs - 1;
        for (int f = 0; f < wide; ++f) {
            float value = field.bias[static_cast<size_t>(f + 1)];
            for (int j = 0; j < field.hidden; ++j)
                value += h[j] * field.feature[static_cast<size_t>(j * field.wide_out + f)];
            inputs_.push_back(light ? value * (1 + light[f]) + light[wide + f] : value);
        }
        for (int a = 0; a < 3; ++a) directions_.push_back(static_cast<float>(tile_.rays.direction[r][a]));
        weights_.push_back(weight);
        rows_.push_back(row);
    }

    // Adds the head's outputs, by weight, to their rows of sums (rows, wide_out).
    void sum(const unisim_head &head, const Field &field, float *sums) {
        const size_t count = rows_.size(), wide = static_cast<size_t>(field.outputs - 1);
        features_.resize(inputs_.size());
        UNISIM_NAME(unisim_head_forward)
        (&head, inputs_.data(), directions_.data(), nullptr, static_cast<int64_t>(count), features_.data(), 1);
        for (size_t i = 0; i < count; ++i) {
            float *out = sums + rows_[i] * static_cast<size_t>(field.wide_out);
            for (size_t f = 0; f < wide; ++f) out[f] += weights_[i] * features_[i * wide + f];
        }
    }

  private:
    const Tile &tile_;
    std::vector<float> inputs_, directions_, weights_, features_;
    std::vector<size_t> rows_; // of sums
};

} // namespace
