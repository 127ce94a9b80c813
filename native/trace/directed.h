// Features that the direction enters at every sample, for scenes without a decoder: noted one by one, then worked out together.
#pragma once
#include "tile.h"

namespace {

class Directed {
  public:
    std::vector<float> features; // (noted, wide), after `run`

    explicit Directed(const Tile &tile) : tile_(tile) {}

    // Room for `count` of them.
    void begin(int count, int wide) {
        undirected_.clear();
        along_.clear();
        features.resize(static_cast<size_t>(count) * wide);
    }

    // Those of hidden units h on ray r, in the light of an actor's scales and shifts where there is one.
    void add(const Field &field, const float *h, int r, const float *light) {
        const int wide = field.outputs - 1;
        for (int f = 0; f < wide; ++f) {
            float value = field.bias[static_cast<size_t>(f + 1)];
            for (int j = 0; j < field.hidden; ++j) value += h[j] * field.feature[static_cast<size_t>(j * field.wide_out + f)];
            undirected_.push_back(light ? value * (1 + light[f]) + light[wide + f] : value);
        }
        for (int a = 0; a < 3; ++a) along_.push_back(static_cast<float>(tile_.rays.direction[r][a]));
    }

    void run(const unisim_head &head) {
        const int64_t count = static_cast<int64_t>(along_.size() / 3);
        UNISIM_NAME(unisim_head_forward)(&head, undirected_.data(), along_.data(), nullptr, count, features.data(), 1);
    }

  private:
    const Tile &tile_;
    std::vector<float> undirected_, along_;
};

} // namespace
