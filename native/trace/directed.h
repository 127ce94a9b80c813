// Features that the direction enters at every sample, for scenes without a decoder: noted one by one, then worked out together.
#pragma once
#include "tile.h"

namespace {

class Directed {
  public:
    explicit Directed(const Tile &tile) : tile_(tile) {}

    void begin() {
        for (auto *v : {&undirected_, &along_, &weights_}) v->clear();
        rows_.clear();
    }

    // Those of hidden units h on ray r, in the light of an actor's scales and shifts where there is one, for a row of sums.
    void add(const Field &field, const float *h, int r, const float *light, float weight, size_t row) {
        const int wide = field.outputs - 1;
        for (int f = 0; f < wide; ++f) {
            float value = field.bias[static_cast<size_t>(f + 1)];
            for (int j = 0; j < field.hidden; ++j) value += h[j] * field.feature[static_cast<size_t>(j * field.wide_out + f)];
            undirected_.push_back(light ? value * (1 + light[f]) + light[wide + f] : value);
        }
        for (int a = 0; a < 3; ++a) along_.push_back(static_cast<float>(tile_.rays.direction[r][a]));
        weights_.push_back(weight);
        rows_.push_back(row);
    }

    // What the head makes of them, by weight, to their rows of sums (rows, wide_out).
    void sum(const unisim_head &head, const Field &field, float *sums) {
        const size_t count = rows_.size(), wide = static_cast<size_t>(field.outputs - 1);
        features_.resize(undirected_.size());
        UNISIM_NAME(unisim_head_forward)
        (&head, undirected_.data(), along_.data(), nullptr, static_cast<int64_t>(count), features_.data(), 1);
        for (size_t i = 0; i < count; ++i) {
            float *out = sums + rows_[i] * static_cast<size_t>(field.wide_out);
            for (size_t f = 0; f < wide; ++f) out[f] += weights_[i] * features_[i * wide + f];
        }
    }

  private:
    const Tile &tile_;
    std::vector<float> undirected_, along_, weights_, features_;
    std::vector<size_t> rows_; // of sums
};

} // namespace
