// The inputs of a trace: scenes with their fields ready for evaluation, and transformations into a scene's
// coordinates.
#pragma once
#include "../field_tile.h"

namespace {

// Samples and segments of a smaller weight get no normal, light or view-dependent feature.
constexpr float MIN_WEIGHT = 1e-4f;
// Samples of a smaller weight are left out of sums of features: a millionth of a feature changes none of its digits.
constexpr float NEGLIGIBLE_WEIGHT = 1e-6f;

struct SceneFields {
    const unisim_scene *scene;
    Field static_field, background, actors;
    // The light network's layers, transposed: (features, wide), (hidden, wide).
    std::vector<float> light_first, light_last;

    explicit SceneFields(const unisim_scene *s)
        : scene(s), static_field(s->static_field), background(s->background), actors(s->actor_fields) {
        if (!s->light) return;
        light_first = transposed(s->light->w1, s->light->hidden, s->light->inputs);
        light_last = transposed(s->light->w2, s->light->outputs, s->light->hidden);
    }

    // (inputs, padded(outputs)) of a matrix (outputs, inputs).
    static std::vector<float> transposed(const float *w, int outputs, int inputs) {
        std::vector<float> out(static_cast<size_t>(inputs) * padded(outputs), 0.0f);
        for (int o = 0; o < outputs; ++o)
            for (int i = 0; i < inputs; ++i) out[static_cast<size_t>(i * padded(outputs) + o)] = w[o * inputs + i];
        return out;
    }
};

struct Task {
    const unisim_scene &scene;
    const unisim_active_actors &active;
    const unisim_rays &rays;
    const unisim_mesh_hits *meshes;
    const unisim_sampling &sampling;
    const unisim_trace_result &result;
    std::vector<SceneFields> fields;   // one per actor set, the scene's own first
    std::vector<int> first_instance;   // one per actor set: the number of its first actor; then of the first mesh actor
};

inline void transform(const double *m, const double *x, float *out) {
    for (int a = 0; a < 3; ++a)
        out[a] = static_cast<float>(m[4 * a] * x[0] + m[4 * a + 1] * x[1] + m[4 * a + 2] * x[2] + m[4 * a + 3]);
}

inline void turn(const double *m, const double *x, float *out) {
    for (int a = 0; a < 3; ++a)
        out[a] = static_cast<float>(m[4 * a] * x[0] + m[4 * a + 1] * x[1] + m[4 * a + 2] * x[2]);
}

// Height of the ground at (x, y), volume coordinates: bilinear between the centres of cells.
inline float ground_at(const unisim_scene &s, float x, float y) {
    const float u = std::fmin(std::fmax(x / s.ground_m - 0.5f, 0.0f), static_cast<float>(s.ground_shape[0] - 1));
    const float v = std::fmin(std::fmax(y / s.ground_m - 0.5f, 0.0f), static_cast<float>(s.ground_shape[1] - 1));
    const int i = static_cast<int>(u), j = static_cast<int>(v), wide = s.ground_shape[1];
    const int ii = std::min(i + 1, s.ground_shape[0] - 1), jj = std::min(j + 1, wide - 1);
    const float fu = u - static_cast<float>(i), fv = v - static_cast<float>(j);
    return (1 - fu) * ((1 - fv) * s.ground[i * wide + j] + fv * s.ground[i * wide + jj]) +
           fu * ((1 - fv) * s.ground[ii * wide + j] + fv * s.ground[ii * wide + jj]);
}

} // namespace
